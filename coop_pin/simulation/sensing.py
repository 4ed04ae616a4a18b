"""The one door from plant to controller: what each arm measures at a tick."""

from __future__ import annotations

import numpy as np

from coop_pin.arrays import Array, Mask, frozen
from coop_pin.control.interface import ArmMeasurement
from coop_pin.description.cell import Cell
from coop_pin.description.controller import LateForcePath, LowPassForcePath, NoForcePath
from coop_pin.model.arm_model import ArmKinematics
from coop_pin.model.cell_model import ArmPlace
from coop_pin.spatial import internal_wrenches


class ArmSensor:
    """Encoders and kinematics of one arm."""

    def __init__(self, cell: Cell, place: ArmPlace) -> None:
        self._place = place
        self._kinematics = ArmKinematics(
            cell.arms[place.name], cell.grasps[place.name].matrix, cell.task_rows
        )
        posture = cell.arms[place.name].posture
        self._angles = np.zeros(len(place.drive)) if posture is None else np.array(posture)

    def measure(
        self, time: float, q: Array, v: Array, internal_wrench: Array | None, saturated: Mask
    ) -> ArmMeasurement:
        """Return this arm's measurement from the state of the whole tree.

        Encoders lose no turn: the angle of a continuous joint starts within half a turn of the posture and
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
        )


class ForceSensor:
    """Measures internal wrenches over a force path: f_m[k] = p f_m[k-1] + (1 - p) f(t_k^-), f_m[0] = f_d.

    f(t_k^-) is the wrench just before tick k: it still carries the torque of tick k - 1.
    """

    def __init__(self, cell: Cell, path: NoForcePath | LateForcePath | LowPassForcePath) -> None:
        self._rows, self._shares = cell.task_rows, cell.shares
        self._pole = None if isinstance(path, NoForcePath) else path.pole
        self._last: list[Array] | None = None

    @property
    def is_needed(self) -> bool:
        """Whether anything is measured."""
        return self._pole is not None

    def start(self, desired: list[Array]) -> list[Array]:
        """Return f_m[0] = f_d for every arm, in world axes."""
        self._last = [frozen(np.array(f_d)) for f_d in desired]
        return self._last

    def measure(self, interaction: Array) -> list[Array]:
        """Return f_m[k] for every arm from the interaction wrenches just before the tick, shape (m, 6)."""
        internal = internal_wrenches(interaction, self._shares)
        assert self._last is not None
        assert self._pole is not None
        p = self._pole
        self._last = [
            frozen(p * old + (1.0 - p) * self._rows.select(new))
            for old, new in zip(self._last, internal, strict=True)
        ]
        return self._last
