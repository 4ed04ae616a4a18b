"""Which scenarios can run in a batch, and why others cannot."""

from __future__ import annotations

from typing import Any

import numpy as np

from coop_pin.batch.law_code import LawTick, require_agreement, trace_law
from coop_pin.batch.run_constants import RunConstants, run_constants, start
from coop_pin.batch.signals import RunShape
from coop_pin.build_controller import build_controller
from coop_pin.control import ArmMeasurement
from coop_pin.description.plant import PlantOptions
from coop_pin.description.scenario import Scenario
from coop_pin.errors import TracingError
from coop_pin.simulation import Simulation
from coop_pin.tracing.tree import structure

_TICKS = 3
"""At which a user's controller is compared with its traced code."""
_SPREAD = 0.1
"""Of the joint positions there about those of the start, and of their rates, rad or m and 1/s of it."""
_LARGEST_AGE = 3


def support(scenario: Scenario) -> str | None:
    """Return None if a scenario can run in a batch, otherwise the reason why it cannot.

    Raises:
        CoopPinError: the run cannot start.
    """
    if reason := plant_reason(scenario.plant):
        return reason
    try:
        run = Simulation(scenario, build_controller(scenario))
        require_traceable(scenario, run, run_constants(scenario, run))
    except TracingError as error:
        return str(error)
    return None


def plant_reason(plant: PlantOptions) -> str | None:
    """Return None if a plant can be traced, otherwise the reason why it cannot."""
    if plant.payload != "welded":
        return "its plant has a free payload; the traced one has it welded to the first arm"
    if plant.integrator != "rk4" or plant.project != "start":
        chosen = f"integrator {plant.integrator!r} and project {plant.project!r}"
        return f"its plant has {chosen}; the traced one has 'rk4' and 'start'"
    return None


def require_traceable(scenario: Scenario, run: Simulation, constants: RunConstants) -> None:
    """Refuse a law that computes with Pinocchio, and a user's whose steps its traced code does not give.

    Raises:
        TracingError: The controller cannot be traced, keeps state, or holds what cannot differ between runs.
    """
    law = scenario.controller
    if not law.user_code:
        if {"model", "regressor"} & {*law.needs}:
            raise TracingError(f"its controller {law.kind!r} computes with a model of Pinocchio")
        return
    try:
        ticks = random_ticks(scenario, run, constants)
        code = trace_law(build_controller(scenario), constants.arms, scenario.cell.task_rows, ticks[0])
        require_agreement(*code, ticks)
    except TracingError as error:
        raise TracingError(f"its controller {law.user_code[0]!r} cannot be traced: it {error}") from None
    structure(constants.controller)


def random_ticks(scenario: Scenario, run: Simulation, constants: RunConstants) -> list[list[LawTick]]:
    """Return successive ticks of all arms under a controller, at random measurements near the start."""
    rng, controller, ticks = np.random.default_rng(0), build_controller(scenario), list[list[LawTick]]()
    state: Any = None
    shape, begun = RunShape.of(scenario), start(scenario, run)
    edges = np.cumsum([len(arm.drive) for arm in constants.arms])[:-1]
    q, holding = np.split(begun.q, edges), np.split(begun.holding, edges)
    for tick in range(_TICKS):
        time = tick * scenario.clock.period
        references, measurements = run.references(time), list[ArmMeasurement]()
        for index, arm in enumerate(constants.arms):
            angles = q[index] + _SPREAD * rng.normal(size=len(q[index]))
            has_path, has_wrist = shape.delay is not None, shape.has_wrist[index]
            wrench, own = (10.0 * rng.normal(size=shape.rows.size) for _ in range(2))
            seen: dict[str, Any] = {
                "internal_wrench": wrench if has_path else None,
                "saturated": rng.random(len(angles)) < 0.2,
                "internal_wrench_age": float(rng.integers(_LARGEST_AGE)) if has_path else np.inf,
                "interaction_wrench": own if has_wrist else None,
                "interaction_wrench_age": float(rng.integers(_LARGEST_AGE)) if has_wrist else np.inf,
                "holding_torque": holding[index],
            }
            v = arm.drive @ (_SPREAD * rng.normal(size=len(angles)))
            measurements.append(arm.measurement(shape.rows, angles, arm.drive @ angles, v, time=time, **seen))
        try:
            if not tick:
                state = controller.init(measurements, references)
            later = [seen._replace(holding_torque=None) for seen in measurements]
            command = controller.step(later, references, state)
            torques, state = run.actuation.commanded(command), command.state
        except Exception as error:  # whatever a user's class raises
            raise TracingError(f"fails at random measurements: {type(error).__name__}: {error}") from error
        ticks.append([LawTick(*given) for given in zip(measurements, references, torques, strict=True)])
    return ticks
