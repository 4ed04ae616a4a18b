"""Choice of the engine of runs: single runs on Pinocchio or its compiled twin, or many runs in a batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias, get_args

from coop_pin.description.scenario import Scenario
from coop_pin.errors import MissingExtraError, NameNotFoundError, ScenarioError
from coop_pin.simulation.plant import Plant

Engine: TypeAlias = Literal["pinocchio", "traced"]
"""What computes the motion of a single run. Pinocchio is the oracle; "traced" is compiled code, and needs the
extra ``fast``."""
Obstacle: TypeAlias = Literal["few runs", "compiler", "plant", "scenario", "law"]
"""What keeps a run from a batch."""
_WORTH_A_BATCH = 64
"""Runs from which "auto" compiles code for them."""


class EngineChoice(NamedTuple):
    """Engine of a run.

    Attributes:
        engine: "single", each run alone on Pinocchio, or "batch", many together by compiled code.
        obstacle: kind of the reason why it is "single"; None if that was asked for.
        reason: text of that reason.
    """

    engine: Literal["single", "batch"]
    obstacle: Obstacle | None = None
    reason: str = ""


def choose_engines(
    scenarios: Sequence[Scenario | ScenarioError],
    engine: str,
    runs: int | None = None,
    *,
    traces_user_code: bool = True,
) -> list[EngineChoice]:
    """Return the engine of each run; it depends on scenarios and number of runs, and on nothing before.

    Args:
        scenarios: scenario of each run, or the mistakes in it.
        engine: engine that is asked for: "single", "batch" or "auto".
        runs: number of runs of these kinds, which "auto" weighs against compiling; None for enough.
        traces_user_code: whether a user's law is built and traced here. Otherwise it counts as one that can
            be traced, and whoever simulates it finds out.
    """
    if engine == "single":
        return [EngineChoice("single")] * len(scenarios)
    if engine == "auto" and runs is not None and runs < (enough := _enough(scenarios)):
        few = f"{runs} runs are fewer than {enough}"
        return [EngineChoice("single", "few runs", few)] * len(scenarios)
    from coop_pin.batch import require_compiler  # slow to load

    try:
        require_compiler()
    except MissingExtraError as error:
        return [EngineChoice("single", "compiler", str(error))] * len(scenarios)
    return [_choice(scenario, traces_user_code) for scenario in scenarios]


def _enough(scenarios: Sequence[Scenario | ScenarioError]) -> int:
    """Return the number of runs worth a batch, which saves the single runs that check a user's law, too."""
    if not any(map(_is_foreign, scenarios)):
        return _WORTH_A_BATCH
    from coop_pin.batch.single_runs import CHECKED  # slow to load

    return _WORTH_A_BATCH + CHECKED


def _is_foreign(scenario: Scenario | ScenarioError) -> bool:
    """Return whether a scenario's law is a user's."""
    return isinstance(scenario, Scenario) and bool(scenario.controller.user_code)


def _choice(scenario: Scenario | ScenarioError, traces_user_code: bool) -> EngineChoice:
    """Return the engine of a run that had better be in a batch."""
    from coop_pin.batch import plant_reason, support

    if isinstance(scenario, ScenarioError):
        return EngineChoice("single", "scenario", str(scenario))
    if text := plant_reason(scenario.plant):
        return EngineChoice("single", "plant", text)
    if _is_foreign(scenario) and not traces_user_code:
        return EngineChoice("batch")
    try:
        text = support(scenario)
    except Exception as error:  # a user's class may raise anything; the run itself reports it
        return EngineChoice("single", "scenario", str(error))
    return EngineChoice("single", "law", text) if text else EngineChoice("batch")


def plant_of(engine: Engine) -> type[Plant]:
    """Return the plant of an engine.

    Raises:
        NameNotFoundError: there is no such engine.
    """
    if engine not in get_args(Engine):
        raise NameNotFoundError("engine", engine, get_args(Engine), "coop_pin.run")
    if engine == "pinocchio":
        return Plant
    from coop_pin.batch.traced_plant import TracedPlant  # a run by Pinocchio does without its compiler

    return TracedPlant
