"""Recorded runs: labelled arrays that judge themselves, saved so that a good file is never destroyed."""

from coop_pin.results.limits import LimitTable, LimitViolation
from coop_pin.results.moment import Moment, Observer, Viewing
from coop_pin.results.result import RunResult
from coop_pin.results.samples import RunSamples

__all__ = ["LimitTable", "LimitViolation", "Moment", "Observer", "RunResult", "RunSamples", "Viewing"]
