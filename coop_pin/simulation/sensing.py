"""Sensing: what each arm measures at a tick, the only path from plant to controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask, frozen
from coop_pin.control.interface import ArmMeasurement, ArmReference
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import ArmKinematics, ArmModel, PayloadKinematics
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.joint_limits import per_joint
from coop_pin.simulation.encoder import Encoders, EncoderState
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.signals import CellSignals, SensorSignals
from coop_pin.simulation.wrist import ForcePath, ForcePathState, Wrist
from coop_pin.spatial import rotate_vector6, weight_wrench
from coop_pin.spatial.task_rows import TaskRows

View = Callable[[Array | None], PayloadKinematics]
"""Payload pose and Jacobian by an arm's own kinematics at measured joint angles; None: the true ones."""

_NONE = np.empty(0)
"""Of the wrenches, where nothing senses them."""


def measurement(view: PayloadKinematics, q: Array, v: Array, **others: Any) -> ArmMeasurement:
    """Return the measurement of an arm.

    Args:
        view: Payload pose and Jacobian by its own kinematics.
        q: Measured drive coordinates, rad, shape (k,).
        v: Measured drive velocities, rad/s, shape (k,).
        others: Remaining fields of the measurement.
    """
    pose, J = view
    return ArmMeasurement(
        q=frozen(q),
        v=frozen(v),
        payload_pose=frozen(pose),
        payload_twist=frozen(J.dot(v)),
        payload_jacobian=frozen(J),
        **others,
    )


class Truth(NamedTuple):
    """What the sensors of a cell sense at a tick.

    Attributes:
        time: t_k, s.
        angles: joint angles of each arm, shape (k,) each.
        rates: joint rates of each arm, shape (k,) each.
        forces: T^T tau of each arm, tau its drive torques just before the tick, N m, shape (k,) each; before
            the first tick those that hold the cell.
        saturated: which drive torques were cut over the last tick, shape (k,) each.
        wrenches: F_i on each arm by the payload about P in world axes, just before the tick, shape (m, 6);
            not read unless ``CellSensors.needs_wrenches``.
        R_WP: orientation of the payload, shape (3, 3); not read without wrist sensors.
        signals: errors of the sensors, and when samples arrive.
    """

    time: Any
    angles: Sequence[Array]
    rates: Sequence[Array]
    forces: Sequence[Array]
    saturated: Sequence[Mask]
    wrenches: Array
    R_WP: Array
    signals: CellSignals


class ArmSensors(NamedTuple):
    """Sensors of one arm.

    Attributes:
        drive: T, shape (k, k).
        to_joints: T^-1, shape (k, k).
        encoders: encoders of the drives; None if they are ideal.
        has_wrist: whether the controller gets its readings; without, it is ideal and part of the force path.
    """

    drive: Array
    to_joints: Array
    encoders: Encoders | None
    has_wrist: bool

    def joints(
        self, state: EncoderState | None, angles: Array, rates: Array, noise: Array, view: View
    ) -> tuple[tuple[PayloadKinematics, Array, Array], EncoderState | None]:
        """Return the view of the payload and measured position and velocity of the drives, and the state."""
        q, v = self.drive.dot(angles), self.drive.dot(rates)
        if self.encoders is None or state is None:
            return (view(None), q, v), None
        (q, v), state = self.encoders.step(state, q, v, noise)
        return (view(self.to_joints.dot(q)), q, v), state


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

    f(t_k^-) is the internal wrench just before tick k: it still carries the torque of tick k - 1. It is
    assembled from what the wrist sensors report, where an arm without one has an ideal one. Its age is that
    of the oldest of these readings, and it has no new sample until every one of them is new.

    Attributes:
        arms: sensors of each arm.
        wrists: wrist sensor of each arm before its first sample; none if no arm has one.
        rows: task rows of the cell.
        shares: c_i, shape (m,).
        path: force path; None if the controllers get no internal wrenches.
    """

    arms: tuple[ArmSensors, ...]
    wrists: tuple[Wrist, ...]
    rows: TaskRows
    shares: Array
    path: ForcePath | None

    @property
    def needs_wrenches(self) -> bool:
        """Whether anything of the wrenches is measured."""
        return bool(self.wrists) or self.path is not None

    def start(self, truth: Truth, views: Sequence[View], references: Sequence[ArmReference]) -> SensorState:
        """Return the state before the first tick.

        Args:
            truth: What is sensed at the first tick.
            views: Kinematics of each arm.
            references: References of the first tick, for f_m[0] = f_d as the arms see the payload.
        """
        encoders = tuple(
            arm.encoders and arm.encoders.start(arm.drive.dot(angles), signals.encoder_noise)
            for arm, angles, signals in zip(self.arms, truth.angles, truth.signals.arms, strict=True)
        )
        state = SensorState(encoders, self.wrists, None)
        if self.path is None:
            return state
        seen = [view.pose for (view, _, _), _ in self._joints(state, truth, views)]
        desired = [
            self.rows.turn(pose, reference.internal_wrench)
            for pose, reference in zip(seen, references, strict=True)
        ]
        return state._replace(path=self.path.start(np.stack(desired)))

    def step(
        self, state: SensorState, truth: Truth, views: Sequence[View]
    ) -> tuple[list[ArmMeasurement], SensorState]:
        """Return what the arms measure at a tick, and the state."""
        joints, encoders = zip(*self._joints(state, truth, views), strict=True)
        signals, wrenches, wrists, path = truth.signals, truth.wrenches, state.wrists, state.path
        if wrists:
            wrists = self._wrists(state, truth, [view.pose for view, _, _ in joints])
            wrenches = frozen(np.stack([wrist.wrench for wrist in wrists]))
        if self.path is not None and path is not None:
            internal = wrenches - self.shares[:, None] * wrenches.sum(axis=0)
            path = self.path.step(path, internal.take(self.rows.indices, axis=1), signals.arrived)
            frozen(path.measured)
        readings = [
            frozen(self.rows.select(wrenches[index])) if arm.has_wrist else None
            for index, arm in enumerate(self.arms)
        ]
        seen = [
            measurement(
                *own,
                time=truth.time,
                saturated=truth.saturated[index],
                internal_wrench=None if path is None else path.measured[index],
                internal_wrench_age=signals.age,
                interaction_wrench=readings[index],
                interaction_wrench_age=signals.arms[index].wrist_age,
            )
            for index, own in enumerate(joints)
        ]
        return seen, SensorState(encoders, wrists, path)

    def _joints(self, state: SensorState, truth: Truth, views: Sequence[View]) -> list[Any]:
        """Return what ``ArmSensors.joints`` does of each arm."""
        return [
            arm.joints(memory, angles, rates, signals.encoder_noise, view)
            for arm, memory, angles, rates, signals, view in zip(
                self.arms, state.encoders, truth.angles, truth.rates, truth.signals.arms, views, strict=True
            )
        ]

    def _wrists(self, state: SensorState, truth: Truth, poses: Sequence[Array]) -> tuple[Wrist, ...]:
        """Return the wrists after a tick."""
        in_payload = rotate_vector6(truth.R_WP.T, truth.wrenches)
        return tuple(
            wrist.step(F_P, signals.wrist_error, pose[:3, :3], signals.wrist_arrived)
            for wrist, F_P, pose, signals in zip(
                state.wrists, in_payload, poses, truth.signals.arms, strict=True
            )
        )


def cell_sensors(scenario: Scenario, places: Sequence[ArmPlace]) -> CellSensors:
    """Return the sensors of a cell.

    Args:
        scenario: Cell, sensors and force path.
        places: Positions of the arms in the cell's model.

    Raises:
        FieldError: a row of values for each joint has another size.
    """
    sensors = [scenario.sensors_of(place.name) for place in places]
    wrists, path, arms = [own.wrist for own in sensors], scenario.controller.force_path, []
    for place, own in zip(places, sensors, strict=True):
        encoders, k = None, len(place.drive)
        if not own.joints_are_ideal:
            where = _path(scenario, place.name)
            encoders = Encoders.of_sensors(own, scenario.clock.period, k, where)
        to_joints = np.asarray(np.linalg.inv(place.drive), dtype=np.float64)
        arms.append(ArmSensors(place.drive, to_joints, encoders, own.wrist is not None))
    at_rest = tuple(Wrist.at_rest(wrist.delay if wrist else 0) for wrist in wrists) if any(wrists) else ()
    rows, shares, transport = scenario.cell.task_rows, scenario.cell.shares, None
    if path.measures:
        transport = ForcePath(path.pole, np.zeros((path.delay, len(arms), rows.size)))
    return CellSensors(tuple(arms), at_rest, rows, shares, transport)


def _path(scenario: Scenario, arm: str) -> str:
    """Return the place of an arm's sensors in a scenario, for error messages."""
    return f"arm_sensors.{arm}" if arm in scenario.arm_sensors else "sensors"


class Sensing:
    """Sensors of all arms in a run, with the kinematics of the arms by Pinocchio.

    Attributes:
        sensors: the sensors.
    """

    def __init__(
        self,
        scenario: Scenario,
        places: Sequence[ArmPlace],
        *,
        holding_torques: Callable[[Array], Sequence[Array]],
    ) -> None:
        """Start without a measurement.

        Args:
            scenario: Cell, sensors and force path.
            places: Positions of the arms in the cell's model.
            holding_torques: Torques of the drives of each arm at rest, as a function of the cell's
                configuration.

        Raises:
            FieldError: a row of values for each joint has another size.
        """
        self._scenario, self._places, self._holding_torques = scenario, places, holding_torques
        self._kinematics, self._angles, self._holding_factors = [], list[Array](), []
        for place in places:
            arm, grasp, k = scenario.cell.arms[place.name], scenario.cell.grasps[place.name], len(place.drive)
            self._kinematics.append(ArmKinematics(arm, grasp.matrix, scenario.cell.task_rows))
            self._angles.append(np.zeros(k) if arm.posture is None else np.array(arm.posture))
            error = np.array(scenario.sensors_of(place.name).holding_torque_error)
            path = f"{_path(scenario, place.name)}.holding_torque_error"
            self._holding_factors.append(1.0 + per_joint(error, k, path))
        self.sensors = cell_sensors(scenario, places)

    def start(self, q: Array, v: Array, references: Sequence[ArmReference]) -> list[ArmMeasurement]:
        """Return the measurements at t = 0, with f_m[0] = f_d if the force path measures at all.

        They alone hold the holding torques. At rest, each arm carries its load share of the payload's weight,
        ``F_i = c_i [m_0 g, 0]``, without internal wrench.
        """
        cell, place = self._scenario.cell, self._places[0]
        free = [frozen(np.zeros(len(place.drive), dtype=bool)) for place in self._places]
        self._signals = SensorSignals(self._scenario, [len(cut) for cut in free]).rows()
        loads = self.sensors.shares[:, None] * weight_wrench(cell.payload.mass, cell.gravity)
        holding = [
            frozen(torque * factor)
            for torque, factor in zip(self._holding_torques(q), self._holding_factors, strict=True)
        ]
        truth = self._truth(0.0, q, v, free)._replace(wrenches=loads)
        truth = truth._replace(
            forces=[arm.drive.T.dot(torque) for arm, torque in zip(self.sensors.arms, holding, strict=True)]
        )
        if self.sensors.wrists:
            X_WP = ArmModel.from_cell(cell, place.name).payload_pose(q[place.q_slice])
            truth = truth._replace(R_WP=X_WP[:3, :3])
        views = self._views(q)
        measured, self._state = self.sensors.step(self.sensors.start(truth, views, references), truth, views)
        return [seen._replace(holding_torque=torque) for seen, torque in zip(measured, holding, strict=True)]

    def measure(self, time: float, plant: Plant, saturated: Sequence[Mask]) -> list[ArmMeasurement]:
        """Return the measurements of a later tick; ``saturated`` is that of the tick before."""
        truth = self._truth(time, plant.q, plant.v, saturated)
        truth = truth._replace(forces=[plant.force[place.v_slice] for place in self._places])
        if self.sensors.needs_wrenches:
            truth = truth._replace(wrenches=plant.interaction_wrenches())
        if self.sensors.wrists:
            truth = truth._replace(R_WP=plant.chain.payload_pose(plant.q)[:3, :3])
        seen, self._state = self.sensors.step(self._state, truth, self._views(plant.q))
        return seen

    def _truth(self, time: float, q: Array, v: Array, saturated: Sequence[Mask]) -> Truth:
        """Return what the joint sensors sense.

        Encoders count turns: the angle of a continuous joint starts within half a turn of the posture and
        never jumps.
        """
        self._angles = [
            own if place.angles.is_vector else place.angles.near(own, before)
            for place, before in zip(self._places, self._angles, strict=True)
            for own in (q[place.q_slice],)
        ]
        rates = [v[place.v_slice] for place in self._places]
        return Truth(time, self._angles, rates, (), saturated, _NONE, _NONE, next(self._signals))

    def _views(self, q: Array) -> list[View]:
        """Return the view of each arm in a configuration of the cell."""
        return [partial(self._view, index, q) for index in range(len(self._places))]

    def _view(self, index: int, q: Array, angles: Array | None) -> PayloadKinematics:
        place = self._places[index]
        own = q[place.q_slice] if angles is None else place.angles.configuration(angles)
        return self._kinematics[index].view(own)
