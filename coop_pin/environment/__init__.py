"""Environments of Gymnasium (extra ``gym``): a cell for agents, one at a time or as lanes of a batch."""

from coop_pin import lazy_names

_PUBLIC = {
    "CellEnv": "coop_pin.environment.cell_env",
    "Task": "coop_pin.environment.task",
    "VectorCellEnv": "coop_pin.environment.vector_cell_env",
}

__getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
