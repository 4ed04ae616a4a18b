"""Sensing: what each arm measures at a tick, the only path from plant to controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from coop_pin.arrays import Array, Mask, frozen
from coop_pin.control.interface import ArmMeasurement, ArmReference
from coop_pin.description.cell import Cell
from coop_pin.description.controller import LateForcePath, LowPassForcePath, NoForcePath
from coop_pin.model.arm_model import ArmKinematics
from coop_pin.model.cell_model import ArmPlace
from coop_pin.simulation.plant import Plant
from coop_pin.spatial import internal_wrenches


class ArmSensor:
    """Encoders of one arm, and its payload kinematics."""

    def __init__(self, cell: Cell, place: ArmPlace) -> None:
        self._place = place
        self._kinematics = ArmKinematics(
            cell.arms[place.name], cell.grasps[place.name].matrix, cell.task_rows
        )
        posture = cell.arms[place.name].posture
        self._angles = np.zeros(len(place.drive)) if posture is None else np.array(posture)

    def measure(
        self,
        time: float,
        q: Array,
        v: Array,
        internal_wrench: Array | None,
        internal_wrench_age: float,
        saturated: Mask,
    ) -> ArmMeasurement:
        """Return this arm's measurement from the state of the whole cell.

        Encoders count turns: the angle of a continuous joint starts within half a turn of the posture and
        never jumps.
        """
        own, T = q[self._place.q_slice], self._place.drive
        view = self._kinematics.view(own)
        self._angles = own if self._place.angles.is_vector else self._place.angles.near(own, self._angles)
        v_drive = T.dot(v[self._place.v_slice])
        return ArmMeasurement(
            time=time,
            q=frozen(T.dot(self._angles)),
            v=frozen(v_drive),
            payload_pose=frozen(view.pose),
            payload_twist=frozen(view.jacobian.dot(v_drive)),
            payload_jacobian=frozen(view.jacobian),
            internal_wrench=internal_wrench,
            saturated=saturated,
            internal_wrench_age=internal_wrench_age,
        )


class Sensing:
    """Sensors of all arms, and the force path f_m[k] = p f_m[k-1] + (1 - p) f(t_k^-), f_m[0] = f_d.

    f(t_k^-) is the internal wrench just before tick k: it still carries the torque of tick k - 1.

    Attributes:
        arms: the sensors, in the order of the arms.
    """

    def __init__(
        self,
        cell: Cell,
        places: Sequence[ArmPlace],
        path: NoForcePath | LateForcePath | LowPassForcePath,
        *,
        holding_torques: Callable[[Array], list[Array]],
    ) -> None:
        """Start without a measured wrench.

        Args:
            cell: for kinematics, task rows and load shares.
            places: of the arms in the cell's model.
            path: of the internal wrench.
            holding_torques: what the drives report at rest, as a function of the cell's configuration.
        """
        self._holding_torques = holding_torques
        self.arms = [ArmSensor(cell, place) for place in places]
        self._sizes = [len(place.drive) for place in places]
        self._rows, self._shares = cell.task_rows, cell.shares
        self._pole = None if isinstance(path, NoForcePath) else path.pole
        self._wrenches: list[Array] = []

    def start(self, q: Array, v: Array, references: Sequence[ArmReference]) -> list[ArmMeasurement]:
        """Return the measurements at t = 0, with f_m[0] = f_d if the force path measures at all.

        They alone hold the holding torques.
        """
        holding = self._holding_torques(q)
        measurements = [
            sensor.measure(0.0, q, v, None, np.inf, frozen(np.zeros(size, dtype=bool)))._replace(
                holding_torque=torque
            )
            for sensor, size, torque in zip(self.arms, self._sizes, holding, strict=True)
        ]
        if self._pole is None:
            return measurements
        self._wrenches = [
            frozen(np.array(self._rows.turn(measurement.payload_pose, reference.internal_wrench)))
            for measurement, reference in zip(measurements, references, strict=True)
        ]
        return [
            measurement._replace(internal_wrench=wrench)
            for measurement, wrench in zip(measurements, self._wrenches, strict=True)
        ]

    def measure(self, time: float, plant: Plant, saturated: Sequence[Mask]) -> list[ArmMeasurement]:
        """Return the measurements of a later tick; ``saturated`` is that of the tick before."""
        wrenches: Sequence[Array | None] = [None] * len(self.arms)
        age = np.inf if self._pole is None else 0.0
        if self._pole is not None:
            p, internal = self._pole, internal_wrenches(plant.interaction_wrenches(), self._shares)
            wrenches = self._wrenches = [
                frozen(p * old + (1.0 - p) * self._rows.select(new))
                for old, new in zip(self._wrenches, internal, strict=True)
            ]
        return [
            sensor.measure(time, plant.q, plant.v, wrench, age, cut)
            for sensor, wrench, cut in zip(self.arms, wrenches, saturated, strict=True)
        ]
