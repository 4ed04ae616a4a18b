"""Traced code: batches of runs, compiled once for many scenarios, and the law of one arm as C99.

Laws are those of coop_pin.control, run on traced numbers; the plant is written once as scalar code with the
numbers of the cell's Pinocchio tree. Compiling batches needs the extra ``fast`` (llvmlite).
"""

from coop_pin.batch.c_export import CLaw, export_c
from coop_pin.batch.preparation import families
from coop_pin.batch.simulate import BatchResult, BatchSimulator, RecordMemory, simulate_batch
from coop_pin.batch.support import plant_reason, support
from coop_pin.tracing.llvm_machine import require_compiler

__all__ = [
    "BatchResult",
    "BatchSimulator",
    "CLaw",
    "RecordMemory",
    "export_c",
    "families",
    "plant_reason",
    "require_compiler",
    "simulate_batch",
    "support",
]
