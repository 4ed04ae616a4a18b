"""Comparison: controllers on the same cells, trials and measures, in one table with intervals.

Open first: ``benchmark`` (``cp.compare``: runs and medians), ``trials`` (named changes under which all are
compared), ``controllers`` (who is compared, by which gains; ``controllers.toml``).

- ``measures`` (of a run, and the cost of a search), ``table`` (text, CSV, page).
- ``tuned_gains``: the same search for every controller.

Imports ``base``, ``compiled``, ``control``, ``description``, ``design``, ``feasibility``, ``grasps``,
``model``, ``results``, ``simulation``, ``stability`` and ``sweeps``.
"""

from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "BENCHMARK": "comparison.trials",
        "Comparison": "comparison.table",
        "Trial": "comparison.trials",
        "benchmark_scenario": "comparison.trials",
        "controller_names": "comparison.controllers",
        "controllers_for": "comparison.controllers",
        "standard_trials": "comparison.trials",
        "tick_costs": "comparison.controllers",
        "tune_controllers": "comparison.tuned_gains",
    },
)
