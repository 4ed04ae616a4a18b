"""Numbers of a run: everything of a scenario that the traced code of its runs computes with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.batch.cell_dynamics import CellModel
from coop_pin.batch.serial_arm import Numbers, RigidInertia, SerialArm, frames, payload_jacobian
from coop_pin.control import ArmMeasurement
from coop_pin.description.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import ArmKinematics
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.joint_limits import JointLimits
from coop_pin.simulation import Simulation
from coop_pin.simulation.actuation import TorqueResponse
from coop_pin.simulation.encoder import Encoders
from coop_pin.simulation.transmission import Friction, friction
from coop_pin.spatial.task_rows import TaskRows
from coop_pin.tracing.traced_array import traced


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
        encoders: of its drives; None if they are ideal.
        carried: factor on its weight that the robot itself adds to the commands; None for nothing.
    """

    seen: SerialArm
    drive: Numbers
    to_joints: Numbers
    friction: Friction
    limit: Numbers
    share: Any
    encoders: Encoders | None
    carried: Any

    def measurement(
        self, rows: TaskRows, angles: Numbers, q: Numbers, v: Numbers, **others: Any
    ) -> ArmMeasurement:
        """Return the measurement of the arm: its own kinematics at angles, and what is given.

        Args:
            rows: task rows of the cell.
            angles: of the joints as measured, shape (n,).
            q: measured drive coordinates, shape (n,).
            v: measured drive velocities, shape (n,).
            others: the remaining fields.
        """
        seen, X_WP = frames(self.seen, angles), np.eye(4).astype(object)
        X_WP[:3, :3], X_WP[:3, 3] = seen.R_WP, seen.p_WP
        J = traced(rows.select(payload_jacobian(seen.S, seen.p_WP)).dot(self.to_joints))
        return ArmMeasurement(
            q=traced(q),
            v=traced(v),
            payload_pose=traced(X_WP),
            payload_twist=J.dot(traced(v)),
            payload_jacobian=J,
            **others,
        )


class RunConstants(NamedTuple):
    """Numbers of a run.

    Attributes:
        cell: its dynamics.
        arms: the rest of each arm.
        pole: p of the force path.
        instants: of events, in order.
        response: of all drives at the start; None if torques are held between ticks.
        period: T, s.
        controller: of all arms.
    """

    cell: CellModel
    arms: tuple[ArmConstants, ...]
    pole: Any
    instants: tuple[Instant, ...]
    response: TorqueResponse | None
    period: Any
    controller: Any


class Start(NamedTuple):
    """Start of a run.

    Attributes:
        q: joint positions of all arms, of continuous joints near the posture, shape (N,).
        holding: torques that the drives report, N m, shape (N,).
        last: commands that hold the cell at rest, N m, shape (N,).
        response: what of a TorqueResponse changes, shape (4, N).
    """

    q: Array
    holding: Array
    last: Array
    response: Array


def run_constants(scenario: Scenario, run: Simulation) -> RunConstants:
    """Return the numbers of a run.

    Args:
        scenario: what is run.
        run: of this scenario.

    Raises:
        TracingError: an arm is no serial chain.
    """
    pole = scenario.controller.force_path.pole
    return RunConstants(
        cell=CellModel.from_chain(run.plant.chain),
        arms=tuple(
            arm_constants(scenario, place)._replace(encoders=sensor.encoders, carried=drives.carried or None)
            for place, sensor, drives in zip(
                run.plant.chain.model.arms, run.sensing.arms, run.actuation.arms.values(), strict=True
            )
        ),
        pole=pole,
        instants=instants(scenario, run),
        response=run.actuation.response,
        period=scenario.clock.period,
        controller=run.controller,
    )


def arm_constants(scenario: Scenario, place: ArmPlace) -> ArmConstants:
    """Return the numbers of one arm with ideal sensors and drives.

    Args:
        scenario: for its cell.
        place: of the arm in the cell's model.

    Raises:
        TracingError: the arm is no serial chain.
    """
    cell, name = scenario.cell, place.name
    seen = ArmKinematics(cell.arms[name], cell.grasps[name].matrix, cell.task_rows).model
    X_JP = seen.frames[seen.getFrameId("payload")].placement
    return ArmConstants(
        seen=SerialArm.from_model(seen, range(1, seen.njoints), X_JP, pin.Inertia.Zero()),
        drive=place.drive,
        to_joints=np.linalg.inv(place.drive),
        friction=friction(cell.arms[name], name),
        limit=JointLimits(cell.arms[name], name).torque,
        share=float(cell.shares[list(cell.arms).index(name)]),
        encoders=None,
        carried=None,
    )


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
    last = run.actuation.holding_commands(run.plant.q)
    held, response = np.concatenate(last), run.actuation.response
    varying = np.zeros((4, len(held))) if response is None else np.array(response[3:])
    return Start(np.concatenate(q), np.concatenate(holding), held, varying)


def _inertia(payload: Payload) -> RigidInertia:
    return RigidInertia.from_model(pin.Inertia(payload.mass, np.zeros(3), payload.inertia_matrix))
