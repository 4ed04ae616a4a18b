"""Many runs: what varies, where it is computed, what is kept, what it says."""

from coop_pin.sweep.answers import SobolIndices
from coop_pin.sweep.axis import linspace, logspace
from coop_pin.sweep.estimate import Estimate, estimate
from coop_pin.sweep.plan import SweepPlan
from coop_pin.sweep.result import PointFailure, PointResult, SweepResult
from coop_pin.sweep.sample import Sample, Span
from coop_pin.sweep.sweeps import sweep

__all__ = [
    "Estimate",
    "PointFailure",
    "PointResult",
    "Sample",
    "SobolIndices",
    "Span",
    "SweepPlan",
    "SweepResult",
    "estimate",
    "linspace",
    "logspace",
    "sweep",
]
