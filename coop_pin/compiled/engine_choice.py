"""Choice of the engine of runs: Pinocchio, compiled code of the plant or of whole runs, or MuJoCo."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Literal, NamedTuple, Self, get_args

from coop_pin.base.arrays import require_known
from coop_pin.base.errors import FieldError, ScenarioError
from coop_pin.compiled.engines import Engine, Way
from coop_pin.compiled.kind import Kind, law_reason, pinocchio_reason, plant_reason
from coop_pin.description.scenario import Scenario
from coop_pin.model.pinocchio_model import load_arm_model
from coop_pin.simulation.mujoco_plant import MujocoPlant, require_mujoco
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import PlantMaker

_HOW = {
    "pinocchio": "",
    "mujoco": "",
    "plant": ", plant under an interpreted law",
    "lanes": ", whole runs as lanes",
}
_TICKS_PER_JOINT = 250
"""Ticks of single runs that take as long as tracing and compiling does for each joint of a cell.

A tick on Pinocchio costs nearly the same in all cells; code grows with the joints (benchmarks/README.md)."""
_LANE_COST = 0.1
"""Cost of a tick of compiled code, in ticks on Pinocchio (benchmarks/README.md)."""


class EngineChoice(NamedTuple):
    """Engine of a run.

    Attributes:
        way: form in which the engine computes it.
        obstacle: kind of the reason why it is no lane; None if it is one, or Pinocchio was named.
        reason: text that says why it is this one.
    """

    way: Way
    obstacle: Literal["few runs", "plant", "scenario", "law", "live"] | None = None
    reason: str = ""

    @property
    def engine(self) -> Engine:
        """The engine that computes in this way."""
        return "compiled" if self.way == "plant" or self.way == "lanes" else self.way

    def require(self, engine: Engine) -> Self:
        """Return the choice; raises FieldError where the engine that is named has no such plant or event."""
        if engine == "compiled" and self.way == "pinocchio" and self.obstacle == "plant":
            raise FieldError(f"is {engine!r}, but {self.reason}; choose 'pinocchio' or 'auto'", "engine")
        return self

    def summary(self) -> str:
        """Return the engine, how it computes the run, and why, on one line."""
        return f"engine {self.engine}{_HOW[self.way]}{self.reason and ': '}{self.reason}"


def choose_engines(
    scenarios: Sequence[Scenario | ScenarioError],
    engine: Engine,
    runs: Sequence[int],
    *,
    traces_user_code: bool = True,
) -> list[EngineChoice]:
    """Return the engine of each scenario; it depends on scenarios and numbers of runs, and on nothing before.

    Scenarios that differ in numbers, times and events can share their code: their ticks are counted together,
    and the first of them decides for all.

    Args:
        scenarios: scenarios, or the mistakes in them.
        engine: engine that is asked for; "auto" weighs runs against compiling. Of "compiled" the choice is
            Pinocchio where there is nothing to compile.
        runs: number of runs of each.
        traces_user_code: whether a user's law is built and traced here. Otherwise it counts as one that can
            be traced, and whoever simulates it finds out.
    """
    if engine != "auto" and engine != "compiled":
        return [_named(each, engine) for each in scenarios]
    kinds = [str(each) if isinstance(each, ScenarioError) else Kind.of_scenario(each) for each in scenarios]
    ticks, choices = defaultdict[str | Kind, float](float), dict[str | Kind, EngineChoice]()
    for kind, scenario, count in zip(kinds, scenarios, runs, strict=True):
        ticks[kind] += 0.0 if isinstance(scenario, ScenarioError) else count * _ticks(scenario)
    for kind, scenario in zip(kinds, scenarios, strict=True):
        if kind not in choices:
            weighed = ticks[kind] if engine == "auto" else None
            choices[kind] = _choice(scenario, weighed, traces_user_code)
    return [choices[kind] for kind in kinds]


def _named(scenario: Scenario | ScenarioError, engine: Literal["pinocchio", "mujoco"]) -> EngineChoice:
    """Return the choice of an engine by name.

    Raises:
        FieldError: MuJoCo does not have the scenario's plant or an event.
        MissingExtraError: mujoco is not installed.
        CoopPinError: an arm cannot be loaded.
    """
    if engine == "mujoco" and isinstance(scenario, Scenario):
        require_mujoco(scenario.cell, scenario.plant, scenario.events)
    return EngineChoice(engine)


def _ticks(scenario: Scenario) -> float:
    """Return the ticks of a run, at least one."""
    return max(1.0, scenario.duration * scenario.clock.rate_hz)


def _choice(scenario: Scenario | ScenarioError, ticks: float | None, traces_user_code: bool) -> EngineChoice:
    """Return the engine of runs like a scenario, by the ticks of all of them unless that is None."""
    if isinstance(scenario, ScenarioError):
        return EngineChoice("pinocchio", "scenario", str(scenario))
    alone: Way = "plant" if ticks is None else "pinocchio"
    if (choice := _by_plant(scenario)).way != "lanes":
        return choice._replace(way=min(choice.way, alone))
    try:
        enough = runs_worth_a_batch(scenario)
        reason = f"compiling takes as long as {enough} single runs"
        if ticks is not None and (runs := math.floor(ticks / _ticks(scenario) + 1e-9)) < enough:
            return EngineChoice("pinocchio", "few runs", f"{reason}, and there are {runs}")
        text = law_reason(scenario.controller)
        if traces_user_code and scenario.controller.user_code:
            from coop_pin.compiled.laws.support import support  # slow to load

            text = support(scenario)
    except Exception as error:  # a user's class may raise anything; the run itself reports it
        return EngineChoice("pinocchio", "scenario", str(error))
    return EngineChoice(alone, "law", text) if text else EngineChoice("lanes", None, reason)


def _by_plant(scenario: Scenario) -> EngineChoice:
    """Return the best way for the plant and the events of a scenario, whatever its law."""
    if text := pinocchio_reason(scenario):
        return EngineChoice("pinocchio", "plant", text)
    text = plant_reason(scenario.plant, scenario.cell, scenario.events)
    return EngineChoice("plant", "plant", text) if text else EngineChoice("lanes")


def runs_worth_a_batch(scenario: Scenario) -> int:
    """Return from how many runs on a batch is faster than single runs, which check a user's law besides.

    Raises:
        CoopPinError: an arm cannot be loaded.
    """
    enough = math.ceil(_ticks_of_compiling(scenario) / _ticks(scenario))
    if not scenario.controller.user_code:
        return enough
    from coop_pin.compiled.laws.support import CHECKED  # slow to load

    return enough + CHECKED


def choose_engine(scenario: Scenario, engine: Engine = "auto", *, is_live: bool = False) -> EngineChoice:
    """Return the engine of one run; it depends on the scenario, and on nothing before.

    Args:
        scenario: scenario.
        engine: engine that is asked for; "auto" weighs the run against compiling.
        is_live: whether something is done at every tick: a view, pacing, or a stop at a breach.

    Raises:
        FieldError: "compiled" is asked for, and only Pinocchio has the plant or an event.
        CoopPinError: an arm cannot be loaded.
    """
    if engine != "auto" and engine != "compiled":
        return _named(scenario, engine)
    if (choice := _by_plant(scenario).require(engine)).way == "pinocchio":
        return choice
    if engine == "auto":
        needed, ticks = _ticks_of_compiling(scenario), scenario.clock.ticks(scenario.duration)
        reason = f"compiling takes as long as {needed} ticks on Pinocchio, and there are {ticks}"
        if ticks < needed:
            return EngineChoice("pinocchio", "few runs", reason)
        choice = choice._replace(reason=choice.reason or reason)
    if choice.way == "plant":
        return choice
    is_foreign = engine == "auto" and scenario.controller.user_code
    text = "a user's law is compiled only if engine 'compiled' is named" if is_foreign else None
    if text := text or law_reason(scenario.controller):
        return EngineChoice("plant", "law", text)
    if is_live:
        return EngineChoice("plant", "live", "a view, pacing or a stop at a breach needs every tick")
    return choice


def saved_by_auto(scenario: Scenario, duration: float) -> float:
    """Return about how much of the wall time of a run on Pinocchio "auto" would have saved, s.

    Args:
        scenario: scenario.
        duration: wall time of the run, s.

    Raises:
        CoopPinError: an arm cannot be loaded.
    """
    if choose_engine(scenario).way != "lanes":
        return 0.0
    ticks = scenario.clock.ticks(scenario.duration)
    return duration * (1.0 - _LANE_COST - _ticks_of_compiling(scenario) / ticks)


def _ticks_of_compiling(scenario: Scenario) -> int:
    """Return the ticks on Pinocchio that take as long as tracing and compiling."""
    return _TICKS_PER_JOINT * sum(load_arm_model(arm).nv for arm in scenario.cell.arms.values())


def plant_of(engine: str) -> PlantMaker:
    """Return the maker of the plant of a run by itself, of an engine other than "auto".

    Raises:
        NameNotFoundError: there is no such engine.
    """
    require_known("engine", engine, get_args(Engine)[1:], "single runs")
    if engine == "compiled":
        from coop_pin.compiled.plant.compiled_plant import CompiledPlant  # slow to load

        return CompiledPlant
    return PinocchioPlant if engine == "pinocchio" else MujocoPlant
