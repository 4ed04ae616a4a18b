"""Closed chains: loop closures, constrained dynamics, projection, integration and inverse kinematics."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin.chain.cell_chain import CellChain
from coop_pin.chain.closed_chain import ChainDynamics, ClosedChain
from coop_pin.chain.closure_set import ClosureError
from coop_pin.chain.inverse_kinematics import ik_branches, solve_ik
from coop_pin.chain.trajectory import ChainState, Energy, Trajectory
from coop_pin.description.closure import Closure

__all__ = [
    "CellChain",
    "ChainDynamics",
    "ChainState",
    "ClosedChain",
    "Closure",
    "ClosureError",
    "Energy",
    "Trajectory",
    "ik_branches",
    "solve_ik",
]
