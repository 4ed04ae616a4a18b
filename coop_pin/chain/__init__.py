"""Closed chains: closures, stabilisation and projection, constrained forward dynamics, motion, grasps, closing, energy."""

import coop_pin.model.require_pinocchio  # noqa: F401  first, so that a missing Pinocchio is told in words
from coop_pin.chain.cell_chain import CellChain
from coop_pin.chain.chain_dynamics import ChainDynamics, ChainState, Energy
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.chain.closure import Closure
from coop_pin.chain.closure_set import ClosureError
from coop_pin.chain.inverse_kinematics import ik_branches, solve_ik
from coop_pin.chain.trajectory import Trajectory

__all__ = [
    "CellChain",
    "ChainDynamics",
    "ChainState",
    "ClosedChain",
    "Closure",
    "Energy",
    "ClosureError",
    "Trajectory",
    "solve_ik",
    "ik_branches",
]
