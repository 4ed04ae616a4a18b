"""Sensors: what each arm measures at a tick, the only path from plant to controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, frozen
from coop_pin.base.spatial import TaskRows, rotate_vector6
from coop_pin.control import ArmMeasurement, ArmReference
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import PayloadKinematics
from coop_pin.model.cell_model import ArmPlace
from coop_pin.simulation.devices.drives import Applied
from coop_pin.simulation.devices.encoder import Encoders, EncoderState
from coop_pin.simulation.devices.signals import CellSignals
from coop_pin.simulation.devices.wrist import ForcePath, ForcePathState, Wrist

View = Callable[[int, Array | None], PayloadKinematics]
"""Payload pose and Jacobian by an arm's own kinematics, at its measured joint angles; None: the true ones."""


def measured_motion(view: PayloadKinematics, q: Array, v: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return the fields of a measurement from ``q`` to ``payload_jacobian``.

    Args:
        view: Payload pose and Jacobian by the arm's own kinematics.
        q: Measured drive coordinates, rad, shape (k,).
        v: Measured drive velocities, rad/s, shape (k,).
    """
    pose, J, carried = view
    twist = J.dot(v) if carried is None else J.dot(v) + carried
    return frozen(q), frozen(v), frozen(pose), frozen(twist), frozen(J)


class Truth(NamedTuple):
    """What the sensors of a cell sense at a tick.

    Attributes:
        time: t_k, s.
        angles: joint angles of each arm, shape (k,) each.
        rates: joint rates of each arm, shape (k,) each.
        signals: errors of the sensors, and when samples arrive.
        applied: torques of the drives at the last tick; those at rest at the first.
        wrenches: F_i on each arm by the payload about P in world axes, just before the tick, shape (m, 6);
            not read unless ``CellSensors.needs_wrenches``.
        R_WP: orientation of the payload, shape (3, 3); not read without wrist sensors or joints.
    """

    time: Any
    angles: Sequence[Array]
    rates: Sequence[Array]
    signals: CellSignals
    applied: Applied
    wrenches: Array
    R_WP: Array


class ArmSensors(NamedTuple):
    """Sensors of one arm.

    Attributes:
        drive: T, shape (k, k).
        to_joints: T^-1, shape (k, k).
        encoders: encoders of the drives; None if they are ideal.
        has_wrist: whether the controller gets its readings; without, it is ideal and part of the force path.
        delays: mask of the delay of its wrist sensor among 0, 1, ... ticks; None for that of its samples.
    """

    drive: Array
    to_joints: Array
    encoders: Encoders | None
    has_wrist: bool
    delays: Array | None = None


class SensorState(NamedTuple):
    """Memory of the sensors of a cell.

    Attributes:
        encoders: memory of each arm's encoders.
        wrists: memory of each arm's wrist sensor; none if no arm has one.
        path: memory of the force path.
    """

    encoders: tuple[EncoderState | None, ...]
    wrists: tuple[Wrist, ...]
    path: ForcePathState | None


class CellSensors(NamedTuple):
    """Sensors of all arms, and the force path f_m[k] = p f_m[k-1] + (1 - p) f(t_{k-D}^-), f_m[0] = f_d.

    f(t_k^-) is the internal wrench just before tick k: it still carries the torque of tick k - 1. Its load
    part is c_i of the resultant, or that of the virtual linkage as the first arm sees the payload. It is
    assembled from what the wrist sensors report, where an arm without one has an ideal one. Its age is that
    of the oldest of these readings, and it has no new sample until every one of them is new.

    Attributes:
        arms: sensors of each arm.
        wrists: wrist sensor of each arm before its first sample; none if no arm has one.
        rows: task rows of the cell.
        shares: c_i, shape (m,).
        path: force path; None if the controllers get no internal wrenches.
        loads: L_i of ``linkage_loads`` in payload axes, shape (m, 6, 6); None for load shares.
        has_joints: Whether a grasp is a joint, beyond which an arm does not see how the payload is turned:
            load parts and wrists then turn with it as all arms together see it, without a bias.
    """

    arms: tuple[ArmSensors, ...]
    wrists: tuple[Wrist, ...]
    rows: TaskRows
    shares: Array
    path: ForcePath | None
    loads: Array | None = None
    has_joints: bool = False

    @property
    def needs_wrenches(self) -> bool:
        """Whether anything of the wrenches is measured."""
        return bool(self.wrists) or self.path is not None

    @property
    def needs_pose(self) -> bool:
        """Whether the orientation of the payload is read."""
        return bool(self.wrists) or self.has_joints

    def at_rest(self, mass: float, gravity: Array) -> Array:
        """Return F_i = c_i [m_0 g, 0], what arms carry at rest without internal wrench, shape (m, 6)."""
        return self.shares[:, None] * np.concatenate((mass * gravity, np.zeros(3)))

    def start(self, truth: Truth, view: View, references: Sequence[ArmReference]) -> SensorState:
        """Return the state before the first tick.

        Args:
            truth: Quantities that are sensed at the first tick.
            view: Kinematics of the arms.
            references: References of the first tick, for f_m[0] = f_d as the arms see the payload.
        """
        encoders = tuple(
            arm.encoders and arm.encoders.start(arm.drive.dot(angles), signals.encoder_noise)
            for arm, angles, signals in zip(self.arms, truth.angles, truth.signals.arms, strict=True)
        )
        state = SensorState(encoders, self.wrists, None)
        if self.path is None:
            return state
        joints, _ = self._joints(state, truth, view)
        desired = [
            self.rows.turn(payload.pose, reference.internal_wrench)
            for (payload, _, _), reference in zip(joints, references, strict=True)
        ]
        return state._replace(path=self.path.start(np.stack(desired)))

    def step(self, state: SensorState, truth: Truth, view: View) -> tuple[list[ArmMeasurement], SensorState]:
        """Return what the arms measure at a tick, and the state."""
        joints, encoders = self._joints(state, truth, view)
        signals, wrenches, wrists, path = truth.signals, truth.wrenches, state.wrists, state.path
        if wrists:
            seen = [truth.R_WP if self.has_joints else payload.pose[:3, :3] for payload, _, _ in joints]
            wrists = self._wrists(state, truth, seen)
            wrenches = frozen(np.stack([wrist.wrench for wrist in wrists]))
        if self.path is not None and path is not None:
            internal = self._internal(wrenches, truth.R_WP if self.has_joints else joints[0][0].pose[:3, :3])
            path = self.path.step(path, self.rows.select(internal.T).T, signals.arrived)
            frozen(path.measured)
        measured = [
            ArmMeasurement(
                truth.time,
                *measured_motion(*joint),
                None if path is None else path.measured[index],
                truth.applied.saturated[index],
                signals.age,
                frozen(self.rows.select(wrenches[index])) if arm.has_wrist else None,
                signals.arms[index].wrist_age,
                None,
                truth.applied.reported[index],
            )
            for index, (arm, joint) in enumerate(zip(self.arms, joints, strict=True))
        ]
        return measured, SensorState(encoders, wrists, path)

    def _internal(self, wrenches: Array, R_WP: Array) -> Array:
        """Return the internal wrenches, shape (m, 6), with the measured orientation of the payload."""
        resultant = wrenches.sum(axis=0)
        if self.loads is None:
            return wrenches - self.shares[:, None] * resultant
        in_payload = self.loads.dot(rotate_vector6(R_WP.T, resultant))
        return wrenches - rotate_vector6(R_WP, in_payload)

    def _joints(
        self, state: SensorState, truth: Truth, view: View
    ) -> tuple[list[tuple[PayloadKinematics, Array, Array]], tuple[EncoderState | None, ...]]:
        """Return the view of the payload and measured q and v of each arm, and the memories of encoders."""
        joints, memories = [], []
        for index, arm in enumerate(self.arms):
            q, v = arm.drive.dot(truth.angles[index]), arm.drive.dot(truth.rates[index])
            angles, memory = None, state.encoders[index]
            if arm.encoders is not None and memory is not None:
                (q, v), memory = arm.encoders.step(memory, q, v, truth.signals.arms[index].encoder_noise)
                angles = arm.to_joints.dot(q)
            joints.append((view(index, angles), q, v))
            memories.append(memory)
        return joints, tuple(memories)

    def _wrists(self, state: SensorState, truth: Truth, seen: Sequence[Array]) -> tuple[Wrist, ...]:
        """Return the wrists after a tick."""
        in_payload = rotate_vector6(truth.R_WP.T, truth.wrenches)
        return tuple(
            wrist.step(F_P, signals.wrist_error, R_WP, signals.wrist_arrived, arm.delays)
            for arm, wrist, F_P, R_WP, signals in zip(
                self.arms, state.wrists, in_payload, seen, truth.signals.arms, strict=True
            )
        )


def cell_sensors(scenario: Scenario, slots: Sequence[ArmPlace]) -> CellSensors:
    """Return the sensors of a cell.

    Args:
        scenario: Cell, sensors and force path.
        slots: Positions of the arms in the cell's model.

    Raises:
        FieldError: a row of values for each joint has another size.
    """
    sensors = [scenario.sensors_of(slot.name) for slot in slots]
    wrists, path, arms = [options.wrist for options in sensors], scenario.controller.force_path, []
    for slot, options in zip(slots, sensors, strict=True):
        encoders, k = None, len(slot.drive)
        if not options.joints_are_ideal:
            name = sensors_path(scenario, slot.name)
            encoders = Encoders.of_sensors(options, scenario.clock.period, k, name)
        arms.append(ArmSensors(slot.drive, slot.from_drive, encoders, options.wrist is not None))
    at_rest = tuple(Wrist.at_rest(wrist.delay if wrist else 0) for wrist in wrists) if any(wrists) else ()
    rows, shares, transport = scenario.cell.task_rows, scenario.cell.shares, None
    if path.by_sensors:
        transport = ForcePath(path.pole, np.zeros((path.delay, len(arms), rows.size)))
    loads, has_joints = scenario.grasp_plan_at(0.0).linkage, scenario.cell.splits_load
    return CellSensors(tuple(arms), at_rest, rows, shares, transport, loads, has_joints)


def sensors_path(scenario: Scenario, arm: str) -> str:
    """Return the place of an arm's sensors in a scenario, for error messages."""
    return f"arm_sensors.{arm}" if arm in scenario.arm_sensors else "sensors"
