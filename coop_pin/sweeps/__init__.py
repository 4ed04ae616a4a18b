"""Sweeps and tuning: plans of many runs, execution backends, the store of finished runs, and their analysis.

Names are loaded on first use: the host process of local workers lies in this package and needs none of them.
"""

from coop_pin import lazy_names

_PUBLIC = {
    "Estimate": "coop_pin.sweeps.duration",
    "PointResult": "coop_pin.sweeps.table",
    "Sample": "coop_pin.sweeps.dimensions",
    "Span": "coop_pin.sweeps.dimensions",
    "estimate": "coop_pin.sweeps.duration",
    "linspace": "coop_pin.sweeps.dimensions",
    "logspace": "coop_pin.sweeps.dimensions",
    "TuneResult": "coop_pin.sweeps.optimisation",
}

__all__ = sorted(_PUBLIC)
__getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
