"""One run of a scenario: warnings before it, choice of the engine, and its result."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin.running.plausibility import gains_are_known, implausible_numbers, large_record, run_warnings
from coop_pin.running.run_scenario import run

__all__ = [
    "gains_are_known",
    "implausible_numbers",
    "large_record",
    "run",
    "run_warnings",
]
