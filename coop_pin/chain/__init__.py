"""Closed chains: closures, stabilisation and projection, constrained forward dynamics, grasps, closing, energy."""

from coop_pin.chain.cell_chain import CellChain
from coop_pin.chain.closed_chain import ChainDynamics, ClosedChain, Energy
from coop_pin.chain.closing import closing_angles
from coop_pin.chain.closure import Closure
from coop_pin.chain.closures import Gap

__all__ = ["CellChain", "ChainDynamics", "ClosedChain", "Closure", "Energy", "Gap", "closing_angles"]
