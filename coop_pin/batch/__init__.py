"""Traced code: batches of runs, compiled once for many scenarios, and the law of one arm as C99.

Laws are those of coop_pin.control, run on traced numbers; the plant is written once as scalar code with the
numbers of the cell's Pinocchio tree. llvmlite compiles batches.
"""

from coop_pin.batch.c_export import CLaw, export_c
from coop_pin.batch.simulate import BatchResult, BatchSimulator, simulate_batch
from coop_pin.batch.support import plant_reason, support

__all__ = [
    "BatchResult",
    "BatchSimulator",
    "CLaw",
    "export_c",
    "plant_reason",
    "simulate_batch",
    "support",
]
