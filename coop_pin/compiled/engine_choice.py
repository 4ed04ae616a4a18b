"""Choice of the engine of runs: single runs on Pinocchio or its compiled twin, or many runs in a batch."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias, get_args

from coop_pin.base.errors import NameNotFoundError, ScenarioError
from coop_pin.compiled.code_family import family_of, law_reason, plant_reason
from coop_pin.compiled.engines import PREVIOUS, Engine
from coop_pin.description.scenario import Scenario
from coop_pin.model.pinocchio_model import load_arm_model
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import PlantMaker

Obstacle: TypeAlias = Literal["few runs", "plant", "scenario", "law", "live"]
"""What keeps a run from a batch."""
_TICKS_PER_JOINT = 250
"""Ticks of single runs that take as long as tracing and compiling does for each joint of a cell.

A tick on Pinocchio costs nearly the same in all cells; code grows with the joints (benchmarks/README.md)."""
_LANE_COST = 0.1
"""Cost of a tick of compiled code, in ticks on Pinocchio (benchmarks/README.md)."""


class EngineChoice(NamedTuple):
    """Engine of a run.

    Attributes:
        engine: "pinocchio" or "traced", each run alone, or "batch", by compiled code, many together or one.
        obstacle: kind of the reason why it is not "batch"; None if that was asked for.
        reason: text that says why it is this one.
    """

    engine: Literal["pinocchio", "traced", "batch"]
    obstacle: Obstacle | None = None
    reason: str = ""


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
        engine: engine that is asked for; "auto" weighs runs against compiling.
        runs: number of runs of each.
        traces_user_code: whether a user's law is built and traced here. Otherwise it counts as one that can
            be traced, and whoever simulates it finds out.
    """
    if engine == "pinocchio" or engine == "traced":
        return [EngineChoice(engine)] * len(scenarios)
    kinds = [str(each) if isinstance(each, ScenarioError) else family_of(each) for each in scenarios]
    ticks, choices = defaultdict[str, float](float), dict[str, EngineChoice]()
    for kind, scenario, count in zip(kinds, scenarios, runs, strict=True):
        ticks[kind] += count * _ticks(scenario)
    for kind, scenario in zip(kinds, scenarios, strict=True):
        if kind not in choices:
            asked = ticks[kind] if engine == "auto" else None
            choices[kind] = _choice(scenario, asked, traces_user_code)
    return [choices[kind] for kind in kinds]


def _ticks(scenario: Scenario | ScenarioError) -> float:
    """Return the ticks of a run, at least one."""
    if isinstance(scenario, ScenarioError):
        return 1.0
    return max(1.0, scenario.duration * scenario.clock.rate_hz)


def _choice(scenario: Scenario | ScenarioError, ticks: float | None, traces_user_code: bool) -> EngineChoice:
    """Return the engine of runs like a scenario, by the ticks of all of them unless that is None."""
    if isinstance(scenario, ScenarioError):
        return EngineChoice("pinocchio", "scenario", str(scenario))
    if text := plant_reason(scenario.plant, scenario.cell, scenario.events):
        return EngineChoice("pinocchio", "plant", text)
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
    return EngineChoice("pinocchio", "law", text) if text else EngineChoice("batch", None, reason)


def runs_worth_a_batch(scenario: Scenario) -> int:
    """Return from how many runs on a batch is faster than single runs, which check a user's law besides.

    Raises:
        CoopPinError: an arm cannot be loaded.
    """
    enough = math.ceil(_ticks_of_compiling(scenario) / _ticks(scenario))
    if not scenario.controller.user_code:
        return enough
    from coop_pin.compiled.single_runs import CHECKED  # slow to load

    return enough + CHECKED


def choose_engine(scenario: Scenario, *, is_live: bool = False) -> EngineChoice:
    """Return the engine of one run by "auto"; it depends on the scenario, and on nothing before.

    Args:
        scenario: scenario.
        is_live: whether something is done at every tick: a view, pacing, or a stop at a breach.

    Raises:
        CoopPinError: an arm cannot be loaded.
    """
    plant, cell, events = scenario.plant, scenario.cell, scenario.events
    if text := plant_reason(plant, cell, [event for event in events if event.needs_pinocchio(cell)]):
        return EngineChoice("pinocchio", "plant", text)
    needed, ticks = _ticks_of_compiling(scenario), scenario.clock.ticks(scenario.duration)
    reason = f"compiling takes as long as {needed} ticks on Pinocchio, and there are {ticks}"
    if ticks < needed:
        return EngineChoice("pinocchio", "few runs", reason)
    if text := plant_reason(plant, cell, events):
        return EngineChoice("traced", "plant", text)
    if scenario.controller.user_code:
        text = "a user's law is compiled only if engine 'batch' is named"
    if text := text or law_reason(scenario.controller):
        return EngineChoice("traced", "law", text)
    if is_live:
        return EngineChoice("traced", "live", "a view, pacing or a stop at a breach needs every tick")
    return EngineChoice("batch", None, reason)


def saved_by_auto(scenario: Scenario, duration: float) -> float:
    """Return about how much of the wall time of a run on Pinocchio "auto" would have saved, s.

    Args:
        scenario: scenario.
        duration: wall time of the run, s.

    Raises:
        CoopPinError: an arm cannot be loaded.
    """
    if choose_engine(scenario).engine != "batch":
        return 0.0
    ticks = scenario.clock.ticks(scenario.duration)
    return duration * (1.0 - _LANE_COST - _ticks_of_compiling(scenario) / ticks)


def _ticks_of_compiling(scenario: Scenario) -> int:
    """Return the ticks on Pinocchio that take as long as tracing and compiling."""
    return _TICKS_PER_JOINT * sum(load_arm_model(arm).nv for arm in scenario.cell.arms.values())


def plant_of(engine: str) -> PlantMaker:
    """Return the maker of the plant of a run by itself: of "pinocchio" or "traced".

    Raises:
        NameNotFoundError: there is no such engine.
    """
    engine = PREVIOUS.get(engine, engine)
    if engine not in ("pinocchio", "traced"):
        raise NameNotFoundError("engine", engine, get_args(Engine), "coop_pin.run")
    if engine == "pinocchio":
        return PinocchioPlant
    from coop_pin.compiled.plant.compiled_plant import (
        CompiledPlant,  # a run by Pinocchio does without its compiler
    )

    return CompiledPlant
