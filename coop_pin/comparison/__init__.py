"""Controllers compared: the same cells, trials and measures for all, and a table with intervals."""

from coop_pin import lazy_names
from coop_pin.comparison.controllers import controller_names, controllers_for
from coop_pin.comparison.costs import tick_costs
from coop_pin.comparison.table import Comparison
from coop_pin.comparison.trials import BENCHMARK, Trial, benchmark_scenario, standard_trials
from coop_pin.comparison.tuned_gains import tune_controllers

__all__ = [
    "BENCHMARK",
    "Comparison",
    "Trial",
    "benchmark_scenario",
    "controller_names",
    "controllers_for",
    "standard_trials",
    "tick_costs",
    "tune_controllers",
]
__getattr__, __dir__ = lazy_names(__name__)
