"""Sensing: what each arm measures at a tick, the only path from plant to controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from coop_pin.arrays import Array, Mask, frozen
from coop_pin.control.interface import ArmMeasurement, ArmReference
from coop_pin.description.scenario import Scenario
from coop_pin.description.sensors import WristSensor
from coop_pin.model.arm_model import ArmKinematics, ArmModel
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.joint_limits import per_joint
from coop_pin.simulation.encoder import Encoders, EncoderState
from coop_pin.simulation.noise import generator
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.wrist import ForcePath, Wrist
from coop_pin.spatial import internal_wrenches, rotate_vector6, weight_wrench


class ArmSensor:
    """Sensors of one arm, and its payload kinematics.

    Attributes:
        encoders: of its drives; None if they are ideal.
        has_wrist: whether the arm measures its interaction wrench.
    """

    def __init__(self, scenario: Scenario, place: ArmPlace) -> None:
        """Start without a measurement.

        Args:
            scenario: for the arm, its grasp and its sensors.
            place: of the arm in the cell's model.

        Raises:
            FieldError: a row of values for each joint has another size.
        """
        cell, name = scenario.cell, place.name
        sensors, joints = scenario.sensors_of(name), len(place.drive)
        path = f"arm_sensors.{name}" if name in scenario.arm_sensors else "sensors"
        self._place, self._rows, self.has_wrist = place, cell.task_rows, sensors.wrist is not None
        X_PE, posture = cell.grasps[name].matrix, cell.arms[name].posture
        self._kinematics = ArmKinematics(cell.arms[name], X_PE, cell.task_rows)
        self._angles = np.zeros(joints) if posture is None else np.array(posture)
        self.encoders: Encoders | None = None
        if not sensors.joints_are_ideal:
            self.encoders = Encoders.of_sensors(sensors, scenario.clock.period, joints, path)
            self._noise = generator(scenario.seed, f"{name}/encoder")
            self._to_joints = np.linalg.inv(place.drive)
        self._read: EncoderState | None = None
        rng = generator(scenario.seed, f"{name}/wrist")
        self._wrist = Wrist(sensors.wrist or WristSensor(), X_PE, scenario.clock, rng)
        error = np.array(sensors.holding_torque_error)
        self._holding_factor = 1.0 + per_joint(error, joints, f"{path}.holding_torque_error")

    def restart(self) -> None:
        """Take the next measurement as the first."""
        self._wrist.restart()
        self._read = None

    def measure(
        self,
        time: float,
        q: Array,
        v: Array,
        internal_wrench: Array | None,
        internal_wrench_age: float,
        saturated: Mask,
    ) -> ArmMeasurement:
        """Return this arm's measurement from the state of the whole cell, without its interaction wrench.

        Encoders count turns: the angle of a continuous joint starts within half a turn of the posture and
        never jumps.
        """
        own, T, angles = q[self._place.q_slice], self._place.drive, self._place.angles
        self._angles = own if angles.is_vector else angles.near(own, self._angles)
        q_drive, v_drive = T.dot(self._angles), T.dot(v[self._place.v_slice])
        if self.encoders is not None:
            noise = self.encoders.noise * self._noise.standard_normal(q_drive.size)
            q_drive, v_drive, self._read = self.encoders.read(q_drive, v_drive, noise, self._read)
            own = angles.configuration(self._to_joints.dot(q_drive))
        view = self._kinematics.view(own)
        return ArmMeasurement(
            time=time,
            q=frozen(q_drive),
            v=frozen(v_drive),
            payload_pose=frozen(view.pose),
            payload_twist=frozen(view.jacobian.dot(v_drive)),
            payload_jacobian=frozen(view.jacobian),
            internal_wrench=internal_wrench,
            saturated=saturated,
            internal_wrench_age=internal_wrench_age,
        )

    def weigh(self, tick: int, seen: ArmMeasurement, F_P: Array) -> tuple[float, Array]:
        """Return tick and value of the wrist's newest sample: F_i about P in world axes, shape (6,).

        Args:
            tick: index of the tick.
            seen: the arm's measurement at this tick.
            F_P: true F_i about P in payload axes, shape (6,).
        """
        self._wrist.read(tick, seen.time, F_P, seen.payload_pose[:3, :3])
        return self._wrist.taken, self._wrist.wrench

    def holding_torque(self, torque: Array) -> Array:
        """Return what the drives report of the torques that hold the cell at rest, N m, shape (k,)."""
        return frozen(torque * self._holding_factor)


class Sensing:
    """Sensors of all arms, and the force path f_m[k] = p f_m[k-1] + (1 - p) f(t_{k-D}^-), f_m[0] = f_d.

    f(t_k^-) is the internal wrench just before tick k: it still carries the torque of tick k - 1. It is
    assembled from what the wrist sensors report, where an arm without one has an ideal one. Its age is that
    of the oldest of these readings, and it has no new sample until every one of them is new.

    Attributes:
        arms: the sensors, in the order of the arms.
    """

    def __init__(
        self,
        scenario: Scenario,
        places: Sequence[ArmPlace],
        *,
        holding_torques: Callable[[Array], Sequence[Array]],
    ) -> None:
        """Start without a measured wrench.

        Args:
            scenario: for the cell, its sensors and the force path.
            places: of the arms in the cell's model.
            holding_torques: of the drives of each arm at rest, as a function of the cell's configuration.
        """
        self._holding_torques = holding_torques
        self._cell = scenario.cell
        self.arms = [ArmSensor(scenario, place) for place in places]
        self._joints = [len(place.drive) for place in places]
        self._place = places[0]
        self._rows, self._shares = scenario.cell.task_rows, scenario.cell.shares
        path = scenario.controller.force_path
        self._path = ForcePath(path) if path.measures else None
        self._has_wrists = any(sensor.has_wrist for sensor in self.arms)
        self._tick = 0

    def start(self, q: Array, v: Array, references: Sequence[ArmReference]) -> list[ArmMeasurement]:
        """Return the measurements at t = 0, with f_m[0] = f_d if the force path measures at all.

        They alone hold the holding torques. At rest, each arm carries its load share of the payload's weight,
        ``F_i = c_i [m_0 g, 0]``, without internal wrench.
        """
        self._tick = 0
        loads = self._shares[:, None] * weight_wrench(self._cell.payload.mass, self._cell.gravity)
        measurements = []
        for sensor, joints, torque in zip(self.arms, self._joints, self._holding_torques(q), strict=True):
            sensor.restart()
            seen = sensor.measure(0.0, q, v, None, np.inf, frozen(np.zeros(joints, dtype=bool)))
            measurements.append(seen._replace(holding_torque=sensor.holding_torque(torque)))
        if self._has_wrists:
            first = ArmModel.from_cell(self._cell, self._place.name)
            X_WP = first.payload_pose(q[self._place.q_slice])
            measurements = self._with_wrenches(measurements, self._read(measurements, loads, X_WP))
        if self._path is None:
            return measurements
        self._path.start(
            [
                frozen(np.array(self._rows.turn(measurement.payload_pose, reference.internal_wrench)))
                for measurement, reference in zip(measurements, references, strict=True)
            ]
        )
        return self._with_internal(measurements, self._path)

    def measure(self, time: float, plant: Plant, saturated: Sequence[Mask]) -> list[ArmMeasurement]:
        """Return the measurements of a later tick; ``saturated`` is that of the tick before."""
        self._tick += 1
        path, age = self._path, np.inf
        internal: Sequence[Array | None] = [None] * len(self.arms)
        if path is not None and not self._has_wrists:
            self._send(path, self._tick, plant.interaction_wrenches())
            internal, age = path.wrenches, self._age(path)
        measurements = [
            sensor.measure(time, plant.q, plant.v, wrench, age, cut)
            for sensor, wrench, cut in zip(self.arms, internal, saturated, strict=True)
        ]
        if not self._has_wrists:
            return measurements
        X_WP = plant.chain.payload_pose(plant.q)
        readings = self._read(measurements, plant.interaction_wrenches(), X_WP)
        measurements = self._with_wrenches(measurements, readings)
        if path is None:
            return measurements
        self._send(path, min(taken for taken, _ in readings), np.array([wrench for _, wrench in readings]))
        return self._with_internal(measurements, path)

    def _read(
        self, measurements: Sequence[ArmMeasurement], wrenches: Array, X_WP: Array
    ) -> list[tuple[float, Array]]:
        """Return tick and value of the newest sample of each wrist, from the true wrenches, shape (m, 6)."""
        in_payload = rotate_vector6(X_WP[:3, :3].T, wrenches)
        return [
            sensor.weigh(self._tick, seen, F_P)
            for sensor, seen, F_P in zip(self.arms, measurements, in_payload, strict=True)
        ]

    def _with_wrenches(
        self, measurements: Sequence[ArmMeasurement], readings: Sequence[tuple[float, Array]]
    ) -> list[ArmMeasurement]:
        return [
            seen._replace(
                interaction_wrench=frozen(np.array(self._rows.select(wrench))),
                interaction_wrench_age=float(self._tick - taken),
            )
            if sensor.has_wrist
            else seen
            for sensor, seen, (taken, wrench) in zip(self.arms, measurements, readings, strict=True)
        ]

    def _send(self, path: ForcePath, taken: float, wrenches: Array) -> None:
        """Send the internal part of wrenches F_i of a tick, shape (m, 6), and receive what has arrived."""
        if path.is_new(taken):
            internal = internal_wrenches(wrenches, self._shares)
            path.send(self._tick, taken, [self._rows.select(wrench) for wrench in internal])
        path.receive(self._tick)

    def _age(self, path: ForcePath) -> float:
        return float(self._tick - path.taken)

    def _with_internal(self, measurements: Sequence[ArmMeasurement], path: ForcePath) -> list[ArmMeasurement]:
        return [
            seen._replace(internal_wrench=wrench, internal_wrench_age=self._age(path))
            for seen, wrench in zip(measurements, path.wrenches, strict=True)
        ]
