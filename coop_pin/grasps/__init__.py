"""Grasps of a cell: rigid, compliant, patches, tables and partners, and the closed chain that they make."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names
from coop_pin.description.cell.cell import grasps_from_configuration
from coop_pin.grasps.cell_chain import CellChain

__all__ = [
    "CellChain",
    "grasps_from_configuration",
]
__getattr__, __dir__ = lazy_names(__name__)
