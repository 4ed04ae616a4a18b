"""An arm as a user says it: its URDF, where it stands, where it grips, and what its motors turn."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import field_validator, model_validator

from coop_pin.arrays import Array
from coop_pin.description.base import Description, Matrix, NumberOrVector, Positive, Vector
from coop_pin.description.pose import Pose
from coop_pin.errors import FieldError, FieldShapeError


class JointFriction(Description):
    """Friction at the drives of an arm, in drive coordinates.

    ``tau_friction = -(viscous * v + coulomb * tanh(v / coulomb_velocity))``

    Attributes:
        viscous: N m s/rad, one value for all joints or one for each.
        coulomb: N m, likewise.
        coulomb_velocity: the speed over which Coulomb friction changes sign, rad/s. A step would cost RK4 its order.
    """

    viscous: NumberOrVector = 0.0
    coulomb: NumberOrVector = 0.0
    coulomb_velocity: Positive = 0.05

    @field_validator("viscous", "coulomb")
    @classmethod
    def _not_negative(cls, value: float | tuple[float, ...]) -> float | tuple[float, ...]:
        if np.min(value) < 0.0:
            raise FieldError(f"is {value}; friction coefficients must not be negative")
        return value


class Arm(Description):
    """One arm of a cell.

    Attributes:
        urdf: path of its URDF, or the name of a bundled ("adept_3dof") or example-robot-data arm ("panda", "ur5").
        tip: frame of the URDF that is fixed to the payload, E.
        base: pose X_WB of the URDF's root link in the world.
        drive: drive matrix T with q_drive = T q and tau = T^T tau_drive, rows; identity when omitted.
        friction: friction at the drives.
        posture: joint angles q near which the arm starts; they choose its elbow. Zeros when omitted.
        calibration_error: pose of the tip that the arm's own kinematics believe in, seen from the true tip.
    """

    urdf: str
    tip: str
    base: Pose = Pose()
    drive: Matrix | None = None
    friction: JointFriction = JointFriction()
    posture: Vector | None = None
    calibration_error: Pose = Pose()

    @field_validator("drive")
    @classmethod
    def _invertible(cls, drive: tuple[tuple[float, ...], ...] | None) -> tuple[tuple[float, ...], ...] | None:
        if drive is None:
            return drive
        if any(len(row) != len(drive) for row in drive):
            raise FieldShapeError(f"has rows of {[len(row) for row in drive]} entries; a drive matrix is square ({len(drive)} rows)")
        condition = float(np.linalg.cond(np.array(drive)))
        if condition > 1e6:
            raise FieldError(f"has condition number {condition:.3g}; a drive matrix must be invertible (at most 1e6)")
        return drive

    @model_validator(mode="after")
    def _sizes_agree(self) -> Self:
        sizes = {"drive": self.drive, "friction.viscous": self.friction.viscous, "friction.coulomb": self.friction.coulomb}
        counts = {name: len(value) for name, value in sizes.items() if isinstance(value, tuple)}
        if len(set(counts.values())) > 1:
            raise FieldShapeError(f"entries per joint disagree: {counts}; all must equal the arm's number of joints")
        return self

    def drive_matrix(self, nv: int) -> Array:
        """Return T, shape (nv, nv)."""
        return np.eye(nv) if self.drive is None else np.array(self.drive)
