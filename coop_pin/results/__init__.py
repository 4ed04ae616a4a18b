"""Results: the record of a run, as labelled arrays with units, its metrics, and its file.

Open first: ``quantities`` (every recorded quantity: name, dimensions, unit, source), ``metrics`` (tracking
error, settling time, internal force, energy balance), ``run_result`` (the class ``cp.RunResult``).

- ``window``: times and phases over which metrics are taken. ``running_metrics``: those of ticks not kept.
- ``trust`` (is the simulation sound), ``task`` (is the task kept), ``breaches`` (what exceeded a threshold).
- ``finding``: what is known before a run. ``friction``: margins of grasps.
- ``snapshot``: one tick, for observers. ``dataset`` and ``netcdf``: arrays and file.

Imports ``base`` and ``description``.
"""

from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Breach": "results.breaches",
        "InternalForceMetrics": "results.metrics",
        "LimitViolation": "results.breaches",
        "Observer": "results.snapshot",
        "Snapshot": "results.snapshot",
        "ThrottledObserver": "results.snapshot",
        "TaskLimits": "description.thresholds",
        "TaskVerdict": "results.task",
        "TrustThresholds": "description.thresholds",
        "Window": "results.window",
    },
)
