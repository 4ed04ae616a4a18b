"""Recorded runs: labelled arrays with their metrics, as files that are written atomically."""

from coop_pin import lazy_names
from coop_pin.description.trust import TrustThresholds
from coop_pin.results.limits import LimitViolation
from coop_pin.results.metrics import InternalForceMetrics
from coop_pin.results.snapshot import Observer, Snapshot, ThrottledObserver
from coop_pin.results.trust import Breach
from coop_pin.results.window import Window

__all__ = [
    "Breach",
    "InternalForceMetrics",
    "LimitViolation",
    "Observer",
    "Snapshot",
    "ThrottledObserver",
    "TrustThresholds",
    "Window",
]
__getattr__, __dir__ = lazy_names(__name__)
