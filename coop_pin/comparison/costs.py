"""Computing time of controllers, for each arm and tick, and what they need."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from coop_pin.batch import export_c
from coop_pin.comparison.controllers import Controllers, controllers_for
from coop_pin.comparison.trials import benchmark_scenario
from coop_pin.control import (
    ArmMeasurement,
    ArmReference,
    CellCommand,
    CellController,
    DecentralisedController,
)
from coop_pin.description.controller import NoForcePath, PayloadSpace
from coop_pin.description.scenario import Scenario
from coop_pin.errors import ArgumentError, TracingError
from coop_pin.run_scenario import build_controller
from coop_pin.simulation import simulate

_TICKS = 100


class _Timed(CellController):
    """Hands everything on, and keeps the time of each step, s."""

    def __init__(self, law: CellController) -> None:
        self._law = law
        self.steps: list[float] = []

    def init(self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]) -> Any:
        return self._law.init(measurements, references)

    def step(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> CellCommand:
        start = time.perf_counter()
        command = self._law.step(measurements, references, state)
        self.steps.append(time.perf_counter() - start)
        return command


def tick_costs(scenario: Scenario, controllers: Controllers) -> pd.DataFrame:
    """Return the cost of controllers for each arm and tick, and what they need.

    ``us`` is the least time of a hundred ticks in Python, of this machine, and ``ratio`` that to the first
    controller's. ``operations`` counts those of the law of the first arm with its kinematics, as exported to
    C; NaN for laws that cannot be. ``needs`` is what a controller uses besides kinematics.

    Args:
        scenario: the cell.
        controllers: names, or descriptions by name, as for ``compare``.

    Raises:
        CoopPinError: a run fails.
    """
    rows = {}
    base = benchmark_scenario(scenario)
    short = base.override({"duration": _TICKS * base.clock.period})
    for name, controller in controllers_for(scenario, controllers).items():
        chosen = short.override({"controller": controller})
        law = build_controller(chosen)
        timed = _Timed(law)
        simulate(chosen, timed)
        least = 1e6 * float(np.min(timed.steps)) / len(chosen.cell.arms)
        rows[name] = {
            "us": least,
            "operations": _operations(chosen),
            "needs": ", ".join(_needs(chosen, law)) or "nothing",
        }
    table = pd.DataFrame.from_dict(rows, orient="index")
    table.insert(1, "ratio", table["us"] / table["us"].iloc[0])
    return table


def _operations(scenario: Scenario) -> float:
    """Return the arithmetic operations of a tick of the first arm's law; NaN if it cannot be traced."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            return float(sum(export_c(scenario, next(iter(scenario.cell.arms)), folder).flops.values()))
    except (TracingError, ArgumentError):
        return math.nan


def _needs(scenario: Scenario, law: CellController) -> tuple[str, ...]:
    """Return what a controller uses besides kinematics."""
    first = next(iter(law.controllers.values())) if isinstance(law, DecentralisedController) else law
    stated = scenario.controller
    if stated.kind == "user":
        blind = isinstance(stated.force_path, NoForcePath)
        return tuple(need for need in first.needs if not (blind and need == "internal wrench"))
    if not isinstance(stated.force_path, NoForcePath):
        return ("internal wrench",)
    own = isinstance(stated, PayloadSpace) and stated.payload_mass is not None
    return ("own wrench",) if own else ()
