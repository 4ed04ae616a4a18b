"""Numbers of a run: everything of a scenario that the traced code of its runs computes with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.batch.cell_dynamics import CellModel
from coop_pin.batch.serial_arm import Numbers, RigidInertia, SerialArm
from coop_pin.control import ArmController, DecentralisedController
from coop_pin.description.controller import NoForcePath
from coop_pin.description.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import ArmKinematics
from coop_pin.model.joint_limits import JointLimits
from coop_pin.run_scenario import build_controller
from coop_pin.simulation import Simulation
from coop_pin.simulation.transmission import Friction, friction


class Instant(NamedTuple):
    """What events make of the cell at an instant.

    Attributes:
        payload: the payload's inertia about P from then on.
        push: wrench on the payload about P in world axes from then on, shape (6,).
    """

    payload: RigidInertia
    push: Numbers


class ArmConstants(NamedTuple):
    """Numbers of one arm besides its dynamics.

    Attributes:
        seen: the arm as its own kinematics have it, calibration errors included.
        drive: T, shape (k, k).
        to_joints: T^-1, shape (k, k).
        friction: of its joints or drives.
        limit: of its drive torques, N m, shape (k,).
        share: c_i.
        law: its controller.
    """

    seen: SerialArm
    drive: Numbers
    to_joints: Numbers
    friction: Friction
    limit: Numbers
    share: Any
    law: ArmController


class RunConstants(NamedTuple):
    """Numbers of a run.

    Attributes:
        cell: its dynamics.
        arms: the rest of each arm.
        pole: p of the force path.
        instants: of events, in order.
    """

    cell: CellModel
    arms: tuple[ArmConstants, ...]
    pole: Any
    instants: tuple[Instant, ...]


class Start(NamedTuple):
    """Start of a run.

    Attributes:
        q: joint positions of all arms, of continuous joints near the posture, shape (N,).
        holding: torques that the drives report, N m, shape (N,).
    """

    q: Array
    holding: Array


def run_constants(scenario: Scenario, run: Simulation) -> RunConstants:
    """Return the numbers of a run.

    Args:
        scenario: what is run.
        run: of this scenario, or of one with another controller.

    Raises:
        TracingError: an arm is no serial chain.
    """
    controller = build_controller(scenario)
    assert isinstance(controller, DecentralisedController)
    cell, arms = scenario.cell, []
    for place, share in zip(run.plant.chain.model.arms, cell.shares.tolist(), strict=True):
        arm = cell.arms[place.name]
        seen = ArmKinematics(arm, cell.grasps[place.name].matrix, cell.task_rows)
        joints = range(1, seen.model.njoints)
        payload = seen.model.frames[seen.model.getFrameId("payload")]
        arms.append(
            ArmConstants(
                seen=SerialArm.from_model(seen.model, list(joints), payload.placement, pin.Inertia.Zero()),
                drive=place.drive,
                to_joints=np.linalg.inv(place.drive),
                friction=friction(arm, place.name),
                limit=JointLimits(arm, place.name).torque,
                share=share,
                law=controller.controllers[place.name],
            )
        )
    path = scenario.controller.force_path
    pole = 0.0 if isinstance(path, NoForcePath) else path.pole
    return RunConstants(CellModel.from_chain(run.plant.chain), tuple(arms), pole, instants(scenario, run))


def instants(scenario: Scenario, run: Simulation) -> tuple[Instant, ...]:
    """Return what events make of the cell, at each of the times of event_times."""
    payload, found = scenario.cell.payload, []
    for time in event_times(run):
        for change in run.timeline.changes_at(time):
            payload = change.apply(payload)
        found.append(Instant(_inertia(payload), run.timeline.push_at(time)))
    return tuple(found)


def event_times(run: Simulation) -> list[float]:
    """Return the times at which events act: at ticks before the controller, and between plant steps."""
    timeline, found = run.timeline, []
    for tick in range(timeline.ticks + 1):
        times = [timeline.time(tick)]
        if tick < timeline.ticks:
            times += [step.start for index, step in enumerate(timeline.steps(tick)) if index > 0]
        found += [time for time in times if timeline.happens_at(time)]
    return found


def start(scenario: Scenario, run: Simulation) -> Start:
    """Return the start of a run."""
    q, holding = [], []
    measured = run.sensing.start(run.plant.q, run.plant.v, run.references(0.0))
    for place, seen in zip(run.plant.chain.model.arms, measured, strict=True):
        posture = scenario.cell.arms[place.name].posture
        near = np.zeros(len(place.drive)) if posture is None else np.array(posture)
        q.append(place.angles.near(run.plant.q[place.q_slice], near))
        assert seen.holding_torque is not None
        holding.append(seen.holding_torque)
    return Start(np.concatenate(q), np.concatenate(holding))


def _inertia(payload: Payload) -> RigidInertia:
    return RigidInertia.from_model(pin.Inertia(payload.mass, np.zeros(3), payload.inertia_matrix))
