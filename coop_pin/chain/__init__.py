"""Closed chains of any mechanism from URDF: loop closures, constrained dynamics, projection, integration."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.chain.closure_set import ClosureError
from coop_pin.chain.forward_dynamics import ChainDynamics
from coop_pin.chain.trajectory import ChainState, Energy, Trajectory

__all__ = [
    "ChainDynamics",
    "ChainState",
    "ClosedChain",
    "ClosureError",
    "Energy",
    "Trajectory",
]
