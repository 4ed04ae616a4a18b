"""Batches of runs: laws and plant traced to scalar code, compiled once and run for many scenarios at a time.

Laws are those of coop_pin.control, run on traced numbers; the plant is written once as scalar code with the
numbers of the cell's Pinocchio tree. Compiling needs the extra ``fast`` (llvmlite).
"""

from coop_pin.batch.simulate import BatchResult, simulate_batch
from coop_pin.batch.support import support

__all__ = ["BatchResult", "simulate_batch", "support"]
