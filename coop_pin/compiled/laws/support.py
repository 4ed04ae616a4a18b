"""Which scenarios can run in a batch, and why others cannot."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.base.errors import DivergedError, TracingError
from coop_pin.compiled.constants import RunConstants, run_constants
from coop_pin.compiled.kind import law_reason, plant_reason
from coop_pin.compiled.laws.hidden_state import Contents, of_classes, of_objects, require_unchanged
from coop_pin.compiled.laws.law_code import (
    LawTick,
    RecordedLaw,
    as_tracing_errors,
    require_agreement,
    trace_law,
    traced_call,
)
from coop_pin.control import ArmMeasurement, ArmReference, CellCommand, CellController
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.tracing.tree import structure

_TICKS = 16
"""Number of ticks at which a user's controller is compared with its traced code."""
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
def require_traceable(scenario: Scenario, constants: RunConstants) -> None:
    """Refuse a law that computes with Pinocchio, and a user's whose steps its traced code does not give.

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
    if scenario.network is not None:
        raise TracingError(f"its controller {law.user_code[0]!r} is a user's, whose messages are not traced")
    try:
        ticks = shaken_ticks(scenario)
        controller, rows = build_controller(scenario), scenario.cell.task_rows
        trace = partial(traced_call, constants.arms, rows, ticks[0], True)
        code = trace_law(controller, trace)
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
        seen = [each._replace(saturated=draw(each.q.shape) < _SATURATED) for each in measurements]
        command = super().step(seen, references, state)
        velocities, positions = (
            self._shaken(part, _MOTION) for part in (command.velocities, command.positions)
        )
        return CellCommand(self._shaken(command.torques, _TORQUE), command.state, velocities, positions)

    def _shaken(self, values: Sequence[Any], size: float) -> list[Any]:
        """Return values of the arms that have some, with random ones of a size added."""
        draw = self._random.normal
        return [each if each is None else each + size * draw(size=np.shape(each)) for each in values]


def shaken_ticks(scenario: Scenario) -> list[list[LawTick]]:
    """Return the first ticks of all arms in a run that is shaken at random.

    Raises:
        TracingError: The controller fails there, or changes attributes.
    """
    controller = build_controller(scenario)
    law, before = ShakenLaw(controller), _attributes(scenario, controller)
    try:
        run = Simulation(scenario, law)
        for _ in range(min(_TICKS, run.timeline.ticks + 1)):
            run.tick()
    except DivergedError:  # the ticks before it count
        pass
    except Exception as error:  # whatever a user's class raises
        raise TracingError(f"fails at its first ticks: {type(error).__name__}: {error}") from error
    require_unchanged(before, _attributes(scenario, controller))
    return law.ticks


def _attributes(scenario: Scenario, controller: CellController) -> Contents:
    """Return the attributes of a user's law, of its classes and of their modules."""
    return of_objects(controller) | of_classes(scenario.controller.user_code)
