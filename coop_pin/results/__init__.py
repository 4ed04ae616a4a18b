"""Recorded runs: labelled arrays that judge themselves, saved so that a good file is never destroyed."""

from coop_pin.results.dataset import RunSamples
from coop_pin.results.metrics import LimitTable, LimitViolation
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Observer, Snapshot, ThrottledObserver

__all__ = [
    "LimitTable",
    "LimitViolation",
    "Snapshot",
    "Observer",
    "RunResult",
    "RunSamples",
    "ThrottledObserver",
]
