"""Many runs: what varies, where it is computed, what is kept, what it says.

Loaded on first use: the process that keeps local workers lives in this room and needs none of it.
"""

from __future__ import annotations

import importlib
from typing import Any

_PUBLIC = {
    "Estimate": "estimates",
    "PointFailure": "result",
    "PointResult": "result",
    "Sample": "sample",
    "SobolIndices": "answers",
    "Span": "sample",
    "SweepPlan": "plan",
    "SweepResult": "result",
    "estimate": "estimates",
    "linspace": "axis",
    "logspace": "axis",
    "sweep": "one_call",
    "TuneResult": "tune",
    "tune": "tune",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    """Load a public name on first use."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'coop_pin.sweeps' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"coop_pin.sweeps.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value
