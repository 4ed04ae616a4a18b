"""Run of a scenario with the controller that it names."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coop_pin.analysis.plausibility import run_warnings
from coop_pin.build_controller import build_controller
from coop_pin.description.scenario import Scenario
from coop_pin.engine_choice import Engine, plant_of
from coop_pin.errors import ScenarioWarning
from coop_pin.results import Observer, RunResult
from coop_pin.simulation import simulate
from coop_pin.simulation.simulate import Progress


def run(
    scenario: Scenario | str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    progress: Progress | None = None,
    view: Observer | None = None,
    realtime_rate: float | None = None,
    stop_at_breach: bool = False,
    engine: Engine = "pinocchio",
    warn: bool = True,
) -> RunResult:
    """Return the result of a scenario with the controller that it names.

    What ``coop-pin check`` finds wrong with it is told before the run, each as a ScenarioWarning.

    Args:
        scenario: a Scenario, a name in the catalogue, or the path of a TOML file.
        overrides: fields to change, by dotted path, for example ``{"controller.gains.sign_gain": 0.0}``.
        progress: function that is called after every tick with (ticks done, ticks in all).
        view: function that is called with a snapshot after every tick, for example what
            coop_pin.viz.open_view returns.
        realtime_rate: simulated seconds in one second of wall time; inf is as fast as possible. When omitted
            1 with a view, otherwise inf.
        stop_at_breach: end the run at its first breach of the scenario's trust thresholds.
        engine: engine that computes the motion. "traced" is compiled code: faster, and equal to rounding.
        warn: whether to look for what makes the run doubtful; that takes a part of a second.

    Raises:
        ScenarioError: the scenario has mistakes.
        ArgumentError: engine "traced" does not have the scenario's plant.
        CoopPinError: the run could not start, or broke off; ``error.result`` holds what was computed.
    """
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(scenario, overrides)
    elif overrides is not None:
        scenario = scenario.override(overrides)
    controller = build_controller(scenario)
    for warning in run_warnings(scenario, controller) if warn else ():
        warnings.warn(warning, ScenarioWarning, stacklevel=2)
    return simulate(
        scenario,
        controller,
        progress=progress,
        view=view,
        realtime_rate=realtime_rate,
        stop_at_breach=stop_at_breach,
        plant=plant_of(engine),
    )
