"""Proof: monitors of the convergence proofs, every term of a law's derivation along a recorded run.

Open first: ``monitors`` (the functions), ``sliding_mode_monitor`` (law (23) of the paper; terms in
``sliding_mode_terms``), ``payload_space_monitor`` (the payload-space law).

``monitored_quantities`` declares the terms, ``recorded_run`` puts a recorded run on its plant again.

Imports ``base``, ``control``, ``description``, ``model``, ``results`` and ``simulation``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "anchor_bounded_time": "proof.monitors",
        "theorem_monitor": "proof.monitors",
    },
)
