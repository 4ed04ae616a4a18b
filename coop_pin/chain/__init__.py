"""Closed chains of any mechanism from URDF: loop closures, constrained dynamics, projection, integration."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names
from coop_pin.chain.closure_set import ClosureError
from coop_pin.chain.forward_dynamics import ChainDynamics
from coop_pin.chain.trajectory import ChainState, Energy, Trajectory

__all__ = [
    "ChainDynamics",
    "ChainState",
    "ClosureError",
    "Energy",
    "Trajectory",
]
__getattr__, __dir__ = lazy_names(__name__)
