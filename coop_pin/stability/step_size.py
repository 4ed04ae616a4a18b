"""Steps of a plant: the fewest in a tick that keep a measured error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, as_positive, require_type
from coop_pin.base.errors import DivergedError, OutOfRangeError
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import PlantMaker
from coop_pin.simulation.simulate import simulate

STEPS_FIELD, AUTO = "clock.steps_per_tick", "auto"
"""Field whose value "auto", in changes of a scenario, stands for the fewest steps that keep an error."""
AUTO_ERROR = 1e-8
"""Limit of the error of that choice, m."""
MOST_STEPS = 64
"""Largest number of steps in a tick that is proposed; a run with twice as many measures its error."""


@dataclass(frozen=True, eq=False)
class StepSize:
    """Number of plant steps in a tick, chosen by measured error.

    Attributes:
        scenario: scenario with this number of steps, ready to run.
        limit: limit of the error, m.
        errors: bound of the error of payload position and closure, m, by number of steps in a tick; numbers
            with which the run diverges are missing.
    """

    scenario: Scenario
    limit: float
    errors: dict[int, float]

    @property
    def steps(self) -> int:
        """Number of steps in a tick."""
        return self.scenario.clock.steps_per_tick

    def summary(self) -> str:
        """Return the choice and the measured errors as text."""
        clock = self.scenario.clock
        step = f"steps of {1e3 * clock.period / self.steps:.4g} ms, {self.steps} in a tick"
        measured = (f"  {steps:3d} in a tick: {error:.2g} m" for steps, error in self.errors.items())
        return "\n".join((f"{self.scenario.name}: {step}, keep an error of {self.limit:.3g} m", *measured))


def with_changes(scenario: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """Return a scenario with changes by dotted path; ``steps_per_tick = "auto"`` is chosen for 1e-8 m.

    Raises:
        ScenarioError: a path does not exist, or the result has mistakes.
        OutOfRangeError: no number of steps keeps the error; others as of fewest_steps.
    """
    require_type("changes", changes, Mapping)
    if changes.get(STEPS_FIELD) != AUTO:
        return scenario.override(changes)
    others = {field: value for field, value in changes.items() if field != STEPS_FIELD}
    return fewest_steps(scenario.override(others), error=AUTO_ERROR).scenario


def fewest_steps(scenario: Scenario, *, error: float = 1e-9, plant: PlantMaker = PinocchioPlant) -> StepSize:
    """Return the fewest integration steps in a tick, of 1, 2, 4, ... 64, whose run keeps an error.

    With x the payload's position and the closure errors of the arms at the recorded ticks, ``|.|`` the
    largest over them and N the finest run so far, ``e_n <= |x_n - x_N| + e_N`` and ``e_N <= |x_N/2 - x_N|``,
    if halving the steps at least halves the error. A method of order p divides it by 2^p, so that this bound
    is up to twice the error for n = N/2 and close to the error for smaller n. N is doubled until a bound is
    within ``error``. Rate of the controller, events and random numbers stay as they are.

    Laws with sgn: where a surface passes zero, or the edge of its dead zone, within the error, its sign flips
    a tick earlier or later, and runs part by the torque of that tick, however small their steps are. A flip
    that separates the runs is in the bound, one that none of them shows is not; with ``dead_zone = 0`` signs
    of rounding can agree in two runs by chance, and the bound is then worth nothing.

    Args:
        scenario: scenario that would be run; a shorter duration or fewer events give what suffices for these.
        error: limit of the position of the payload and of the closure errors, m.
        plant: Maker of the plant, as of Simulation.

    Raises:
        OutOfRangeError: no number of steps keeps it, with the smallest error found.
        DivergedError: the run diverges with the finest steps too; other errors are those of coop_pin.run.
    """
    require_type("scenario", scenario, Scenario)
    error = as_positive("error", error)
    runs: dict[int, Array] = {}
    errors: dict[int, float] = {}
    for steps in (2**k for k in range(MOST_STEPS.bit_length() + 1)):
        try:
            runs[steps] = _positions(scenario, steps, plant)
        except DivergedError:
            if steps >= MOST_STEPS:
                raise
        if steps in runs and steps // 2 in runs:
            rest = _distance(runs[steps // 2], runs[steps])
            errors = {n: _distance(run, runs[steps]) + rest for n, run in runs.items() if n < steps}
        fewest = next((n for n, bound in errors.items() if bound <= error), None)
        if fewest is not None:
            return StepSize(scenario.override({STEPS_FIELD: fewest}), error, errors)
    raise OutOfRangeError(
        "error", error, f"at least {min(errors.values()):.3g} m with up to {MOST_STEPS} steps in a tick"
    )


def _positions(scenario: Scenario, steps: int, plant: PlantMaker) -> Array:
    """Return the payload's position and each arm's closure error at the recorded ticks, shape (k, 3 + m)."""
    scenario = scenario.override({STEPS_FIELD: steps})
    data = simulate(scenario, build_controller(scenario), plant=plant).data
    return np.hstack([data.payload_position.values, data.closure_distance.values])


def _distance(run: Array, other: Array) -> float:
    """Return the largest distance of the payload, or difference of a closure error, of two runs, m."""
    change = run - other
    return float(max(np.linalg.norm(change[:, :3], axis=1).max(), np.abs(change[:, 3:]).max()))
