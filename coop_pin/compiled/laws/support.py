"""Checks of laws in batches: what can be traced, shaken ticks, and single runs that a batch must agree with.

The first ticks show what a user's law computes, not what it counts, draws or reads besides; a whole run shows
that, too.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.base.errors import DivergedError, TracingError
from coop_pin.compiled.constants import RunConstants, run_constants
from coop_pin.compiled.kind import law_reason, plant_reason
from coop_pin.compiled.laws.law_code import (
    LawTick,
    RecordedLaw,
    as_tracing_errors,
    require_agreement,
    trace_law,
    traced_call,
)
from coop_pin.control import ArmMeasurement, ArmReference, CellCommand, CellController
from coop_pin.control.hidden_state import (
    Contents,
    of_classes,
    of_objects,
    require_no_outside,
    require_unchanged,
)
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.tracing.tree import structure

Item = TypeVar("Item")

CHECKED = 2
"""Runs of a family that are repeated singly."""
_AGREEMENT = 1e-9
"""Largest difference of a quantity or metric, relative to its largest value or to 1, whichever is more."""
_TICKS = 16
"""Number of ticks at which a user's controller is compared with its traced code."""
_LATER_TICKS = 200
"""Number of further ticks, over the whole length, of a run that no single run is compared with."""
_TORQUE = 10.0
"""Size of what is added to torques there, N m."""
_MOTION = 0.1
"""Size of what is added to velocities and positions that servos take, rad/s and rad."""
_SATURATED = 0.2
"""Part of the torques that count as cut there."""


@typed
def support(scenario: Scenario) -> str | None:
    """Return None if a scenario can run in a batch, otherwise the reason why it cannot.

    Raises:
        CoopPinError: the run cannot start.
    """
    if reason := plant_reason(scenario.plant, scenario.cell, scenario.events):
        return reason
    try:
        run = Simulation(scenario, build_controller(scenario))
        require_traceable(scenario, run_constants(scenario, run))
    except TracingError as error:
        return str(error)
    return None


@as_tracing_errors()
def require_traceable(scenario: Scenario, constants: RunConstants, *, alone: bool = False) -> None:
    """Refuse a law that computes with Pinocchio, and a user's whose steps its traced code does not give.

    Args:
        scenario: scenario of the run.
        constants: numbers of the run.
        alone: whether no single run will be compared; then the law is looked at over the whole length, and
            may name nothing that is another each time.

    Raises:
        TracingError: The controller cannot be traced, keeps state, or holds what cannot differ between runs.
    """
    law = scenario.controller
    if scenario.feed_forward is not None:
        raise TracingError("it has feed-forward torques, which traced laws do not add")
    if not law.user_code:
        if reason := law_reason(law):
            raise TracingError(reason)
        return
    if scenario.network is not None and alone:
        detail = "is a user's, whose messages are traced in batches only"
        raise TracingError(f"its controller {law.user_code[0]!r} {detail}")
    try:
        if alone:
            require_no_outside(law.user_code)
        ticks = shaken_ticks(scenario, later=_LATER_TICKS * alone)
        controller, rows = build_controller(scenario), scenario.cell.task_rows
        before = _attributes(scenario, controller)
        require_unchanged(of_objects(build_controller(scenario)), of_objects(controller), "when it is built")
        trace = partial(traced_call, constants.arms, rows, ticks[0], True)
        code = trace_law(controller, trace)
        require_unchanged(before, _attributes(scenario, controller))
        require_agreement(*code, ticks)
    except TracingError as error:
        raise TracingError(f"its controller {law.user_code[0]!r} cannot be traced: it {error}") from None
    structure(constants.controller)


class ShakenLaw(RecordedLaw):
    """Law whose ticks are recorded far from rest: commands are shaken at random, and torques count as cut."""

    def __init__(self, law: CellController) -> None:
        super().__init__(law)
        self._random = np.random.default_rng(0)

    def step(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> CellCommand:
        """Return the law's command, shaken."""
        draw = self._random.random
        saturated = [each._replace(saturated=draw(each.q.shape) < _SATURATED) for each in measurements]
        command = super().step(saturated, references, state)
        velocities, positions = (
            self._shaken(part, _MOTION) for part in (command.velocities, command.positions)
        )
        return CellCommand(self._shaken(command.torques, _TORQUE), command.state, velocities, positions)

    def _shaken(self, values: Sequence[Any], size: float) -> list[Any]:
        """Return values of the arms that have some, with random ones of a size added."""
        draw = self._random.normal
        return [each if each is None else each + size * draw(size=np.shape(each)) for each in values]


def shaken_ticks(scenario: Scenario, *, later: int = 0) -> list[list[LawTick]]:
    """Return the first ticks of all arms in a run that is shaken at random.

    Args:
        scenario: scenario of the run.
        later: number of further ticks, which have the measurements of the first ones at times and references
            over the whole length of the run.

    Raises:
        TracingError: The controller fails there, or changes attributes.
    """
    controller = build_controller(scenario)
    law, before = ShakenLaw(controller), _attributes(scenario, controller)
    try:
        run = Simulation(scenario, law)
        for _ in range(min(_TICKS, run.timeline.ticks + 1)):
            run.tick()
        first, end = law.ticks[1:] or law.ticks, run.timeline.time(run.timeline.ticks)
        for tick, time in zip(itertools.cycle(first), np.linspace(run.time, end, later).tolist()):
            at = [arm.measurement._replace(time=time, holding_torque=None) for arm in tick]
            run.controller_state = law.step(at, run.references(time), run.controller_state).state
    except DivergedError:  # the ticks before it count
        pass
    except Exception as error:  # whatever a user's class raises
        raise TracingError(f"fails at its first ticks: {type(error).__name__}: {error}") from error
    require_unchanged(before, _attributes(scenario, controller))
    return law.ticks


def _attributes(scenario: Scenario, controller: CellController) -> Contents:
    """Return the attributes of a user's law, of its classes and of their modules."""
    return of_objects(controller) | of_classes(scenario.controller.user_code)


# ---------------------------------------------------------------- single runs


def checked(runs: Sequence[Item], options: Callable[[Item], Any] = lambda _: None) -> list[Item]:
    """Return the first of some runs and a random other one, which depends on nothing but the runs.

    Args:
        runs: Runs of a family.
        options: Function of a run: options of its law. The other run has not those of the first if any has.
    """
    first, *others = runs
    others, like = random.Random(len(others)).sample(others, len(others)), options(first)
    differing = (each for each in others if options(each) != like)
    return [first, *([next(differing, others[0])] if others else [])]


def difference(batch: Mapping[str, Any], expected: Mapping[str, Any]) -> str:
    """Return in which quantity or metric runs differ and by how much; nothing if they agree.

    Args:
        batch: Numbers of a run of the batch by name: floats or arrays.
        expected: Those of the single run.
    """
    for name, value in expected.items():
        single = np.asarray(value)
        if single.dtype.kind != "f" or name not in batch:
            continue
        scale = max(1.0, np.abs(single[np.isfinite(single)]).max(initial=0.0))
        if not np.allclose(batch[name], single, rtol=0.0, atol=_AGREEMENT * scale, equal_nan=True):
            with np.errstate(invalid="ignore"):
                errors = np.nan_to_num(np.abs(np.asarray(batch[name]) - single), nan=np.inf)
            return f"{name} differs by {errors.max():.3g}"
    return ""


def require_single_run(scenario: Scenario, samples: Mapping[str, Any]) -> None:
    """Refuse a run of a user's law as compiled code that differs from a single run.

    Args:
        scenario: Scenario of the run.
        samples: Samples of the run.

    Raises:
        TracingError: It differs, or the single run fails.
    """
    try:
        run = Simulation(scenario, build_controller(scenario))
        while not run.is_finished:
            run.tick()
        single = run.result().data
    except Exception as error:  # of a user's class, or of a run that fails
        reason = f"a single run ends with {type(error).__name__}: {error}"
    else:
        expected = {str(name): part.values for name, part in single.data_vars.items() if "time" in part.dims}
        reason = difference({name: samples[name] for name in expected}, expected)
    if reason:
        raise TracingError(disagreement(scenario, reason))


def disagreement(scenario: Scenario, reason: str) -> str:
    """Return the message for a batch that differs from a single run in a stated quantity."""
    law = scenario.controller.user_code[0]
    return (
        f"a batch of its controller {law!r} differs from a single run ({reason}):"
        " it keeps state besides that of init and step, or depends on more than its arguments"
    )
