"""Monitors of the convergence proofs: every term of the derivation of a law, along a recorded run."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names
from coop_pin.proof.monitors import anchor_bounded_time, theorem_monitor

__all__ = ["anchor_bounded_time", "theorem_monitor"]
__getattr__, __dir__ = lazy_names(__name__)
