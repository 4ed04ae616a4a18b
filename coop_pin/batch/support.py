"""Which scenarios can run in a batch, and why others cannot."""

from __future__ import annotations

from functools import partial

import numpy as np

from coop_pin.arrays import typed
from coop_pin.batch.constants import RunConstants, run_constants, start
from coop_pin.batch.hidden_state import Contents, of_classes, of_objects, require_unchanged
from coop_pin.batch.law_code import LawTick, require_agreement, trace_law
from coop_pin.build_controller import build_controller
from coop_pin.control import CellController
from coop_pin.description.code_family import law_reason, plant_reason
from coop_pin.description.scenario import Scenario
from coop_pin.errors import TracingError
from coop_pin.simulation import Simulation
from coop_pin.simulation.drives import Applied
from coop_pin.simulation.sensors import Truth
from coop_pin.simulation.signals import SensorSignals
from coop_pin.tracing.tree import structure

_TICKS = 16
"""At which a user's controller is compared with its traced code, the first and random ones."""
_SPREAD = 0.1
"""Of the joint positions there about those of the start, and of their rates, rad or m and 1/s of it."""
_WRENCH = 10.0
"""Size of the wrenches there, N and N m."""
_TORQUE = 10.0
"""Size of the torques that the drives report there, N m."""
_SATURATED = 0.2
"""Part of the torques that are cut there."""


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
        require_traceable(scenario, run, run_constants(scenario, run))
    except TracingError as error:
        return str(error)
    return None


def require_traceable(scenario: Scenario, run: Simulation, constants: RunConstants) -> None:
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
        ticks = random_ticks(scenario, run, constants)
        controller, rows = build_controller(scenario), scenario.cell.task_rows
        code = trace_law(controller, constants.arms, rows, ticks[0], exact=True)
        require_agreement(*code, ticks)
    except TracingError as error:
        raise TracingError(f"its controller {law.user_code[0]!r} cannot be traced: it {error}") from None
    structure(constants.controller)


def random_ticks(scenario: Scenario, run: Simulation, constants: RunConstants) -> list[list[LawTick]]:
    """Return ticks of all arms under a controller, the first and random ones, at states near the start.

    Raises:
        TracingError: The controller fails there, or changes attributes.
    """
    rng, controller, ticks = np.random.default_rng(0), build_controller(scenario), list[list[LawTick]]()
    before = _attributes(scenario, controller)
    begun, sensors = start(run), constants.sensors
    sizes = [len(arm.drive) for arm in constants.arms]
    joints = begun.q[: sum(sizes)]
    split = partial(np.split, indices_or_sections=np.cumsum(sizes)[:-1])
    rows, sensed, state = SensorSignals(scenario, sizes).rows(), None, None
    subset = {0, *rng.integers(run.timeline.ticks + 1, size=_TICKS - 1).tolist()}
    for tick, signals in zip(range(max(subset) + 1), rows, strict=False):
        if tick not in subset:
            continue
        time = run.timeline.time(tick)
        references, angles = run.references(time), split(joints + _SPREAD * rng.normal(size=sum(sizes)))
        truth = Truth(
            time=time,
            angles=angles,
            rates=split(_SPREAD * rng.normal(size=sum(sizes))),
            applied=Applied(*map(split, _TORQUE * rng.normal(size=(5, sum(sizes)))))._replace(
                saturated=split(rng.random(sum(sizes)) < _SATURATED)
            ),
            wrenches=_WRENCH * rng.normal(size=(len(sizes), 6)),
            R_WP=np.eye(3),
            signals=signals,
        )
        view = partial(constants.view, angles)
        sensed = sensors.start(truth, view, references) if sensed is None else sensed
        measurements, sensed = sensors.step(sensed, truth, view)
        first = [
            each._replace(holding_torque=torque)
            for each, torque in zip(measurements, split(begun.holding), strict=True)
        ]
        try:
            if not tick:
                state = controller.init(first, references)
            command = controller.step(measurements, references, state)
            torques, state = run.actuation.commanded(command), command.state
        except Exception as error:  # whatever a user's class raises
            raise TracingError(f"fails at random measurements: {type(error).__name__}: {error}") from error
        ticks.append([LawTick(*parts) for parts in zip(first, references, torques, strict=True)])
    require_unchanged(before, _attributes(scenario, controller))
    return ticks


def _attributes(scenario: Scenario, controller: CellController) -> Contents:
    """Return the attributes of a user's law, of its classes and of their modules."""
    return of_objects(controller) | of_classes(scenario.controller.user_code)
