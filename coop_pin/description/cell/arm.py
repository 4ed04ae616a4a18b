"""Arm of a cell: URDF, base pose, tip, transmission, friction, torque limits, locked joints."""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError, UrdfError
from coop_pin.base.schema.base import Description, Matrix, Vector, number_or_row, positive
from coop_pin.base.schema.pose import Pose
from coop_pin.description.cell.armature import Armature, Rotors
from coop_pin.description.cell.differential_base import Base, DifferentialBase
from coop_pin.description.cell.end_stops import EndStops
from coop_pin.description.cell.joint_friction import Friction, JointFriction
from coop_pin.description.cell.miscalibration import Miscalibration
from coop_pin.description.urdf import UrdfFile, find_urdf, load_checked
from coop_pin.description.urdf.robot import Robot


def _source_or_numbers(value: Any) -> Any:
    """Return "urdf", "none", a positive number or a row of positive numbers."""
    if isinstance(value, str):
        if value not in ("urdf", "none"):
            raise FieldError(
                f'is {value!r}; it must be "urdf", "none", a number or one number for each joint'
            )
        return value
    return positive(number_or_row(value))


TorqueLimits = Annotated[
    Literal["urdf", "none"] | float | tuple[float, ...], BeforeValidator(_source_or_numbers)
]
"""Limits of the drive torques, N m: "urdf", "none", one value for all joints, or one for each."""


@functools.lru_cache(maxsize=64)
def _read(file: UrdfFile, parts: bool, *_version: int) -> Robot:
    return Robot(load_checked(file, parts=parts))


def _robot(file: UrdfFile, *, parts: bool = True) -> Robot:
    """Return the robot of a file, read once a version, which nobody may change; parts as of load_checked."""
    version = os.stat(file.path)  # noqa: PTH116
    return _read(file, parts, version.st_mtime_ns, version.st_size)


def _robot_of(fields: Mapping[str, Any]) -> Robot | None:
    """Return the robot of an arm's file; None where the fields that name it have mistakes."""
    names = ("urdf", "package_dirs", "xacro_args")
    if not all(name in fields for name in names):
        return None
    urdf, package_dirs, xacro_args = (fields[name] for name in names)
    return _robot(find_urdf(urdf, package_dirs=package_dirs, xacro_args=xacro_args), parts=False)


class Arm(Description):
    """One arm of a cell.

    Its joints are those of the URDF that are neither fixed nor locked, in Pinocchio's order.

    Attributes:
        urdf: path of its URDF or xacro file, or the name of a bundled ("adept_3dof") or example-robot-data
            arm ("panda", "ur5").
        package_dirs: folders that are searched first for the packages of package:// and $(find ...).
        xacro_args: values of the arguments of a xacro file.
        tip: frame E of the URDF that is fixed to the payload; when omitted, the only link without child
            joints.
        base: pose X_WB of the URDF's root link in the world.
        drive: transmission matrix T with q_drive = T q and tau = T^T tau_drive, rows; identity when omitted.
        friction: coefficients at the drives; or "urdf": at the joints, from <dynamics>, with Coulomb friction
            smoothed over JointFriction's default speed; or "none".
        armature: inertia of the rotors as the joints feel it, kg m^2, or kg of a prismatic joint: one value
            for the arm's joints, or one for each joint, those of a mobile base first; or rotors behind gears.
            It adds to the diagonal of the mass matrix. None when omitted: the wrist may feel lighter than it
            is. A ``drive`` that couples joints refuses it.
        torque_limits: drive torques at which the actuation saturates, N m; "none"; or "urdf": the effort
            limits of the joints. A joint with effort 0 beside joints with efforts is passive: no drive moves
            it, unless limits are stated here. Where all efforts are 0 they set no limit (the default of many
            files), nor do any if ``drive`` is given: they are not drive torques.
        posture: joint angles near which the arm starts (one angle for a continuous joint, too); they select
            the branch of the inverse kinematics. Zeros when omitted.
        locked: joints that do not move, for example those of a gripper, and their angles, rad or m; their
            mimic joints are fixed too. "others" locks those that do not move the tip, at their angles nearest
            to zero, and the arm stores the result.
        mimic: treatment of mimic joints that are not locked: "refuse" the arm, or "ignore" the coupling.
        impossible_inertia: treatment of inertias of moved links that no body has: "refuse" the arm, or
            "repair" them by the nearest possible ones, with a warning. Those of parts that ``locked`` fixes
            are repaired where need be.
        stops: end stops of its joints in the plant; none when omitted: joints pass their position limits.
        calibration_error: errors of the arm's own kinematic model, which its controller sees.
        mobile_base: platform under the arm: omnidirectional, its three joints before the arm's; or on two
            wheels ("differential"), with a drive and a law of its own.
    """

    urdf: str
    package_dirs: tuple[str, ...] = ()
    xacro_args: dict[str, str] = Field(default_factory=dict)
    tip: str = ""
    base: Pose = Pose()
    drive: Matrix | None = None
    friction: Friction = "urdf"
    armature: Armature = 0.0
    torque_limits: TorqueLimits = "urdf"
    posture: Vector | None = None
    locked: dict[str, float] = Field(default_factory=dict)
    mimic: Literal["refuse", "ignore"] = "refuse"
    impossible_inertia: Literal["refuse", "repair"] = "refuse"
    stops: EndStops | None = None
    calibration_error: Miscalibration = Miscalibration()
    mobile_base: Base | None = None

    @field_validator("tip")
    @classmethod
    def _tip_or_only_leaf(cls, tip: str, earlier: ValidationInfo) -> str:
        if tip or (robot := _robot_of(earlier.data)) is None:
            return tip
        leaves = robot.leaves
        if len(leaves) != 1:
            raise UrdfError(
                f"must be given: {earlier.data['urdf']!r} has {len(leaves)} links at its ends,"
                f" {', '.join(map(repr, leaves))}",
                names=leaves,
            )
        return leaves[0]

    @field_validator("locked", mode="before")
    @classmethod
    def _others_or_table(cls, locked: Any, earlier: ValidationInfo) -> Any:
        if not isinstance(locked, str):
            return locked
        if locked != "others":
            form = 'a table of angles by joint, {joint = 0.1} in TOML, or "others"'
            raise FieldError(f"is {locked!r}; it must be {form}")
        robot, tip = _robot_of(earlier.data), earlier.data.get("tip")
        return {} if robot is None or tip is None else robot.idle(tip)

    @field_validator("drive")
    @classmethod
    def _invertible(cls, drive: tuple[tuple[float, ...], ...] | None) -> tuple[tuple[float, ...], ...] | None:
        if drive is None:
            return drive
        if any(len(row) != len(drive) for row in drive):
            raise FieldError(
                f"has rows of {[len(row) for row in drive]} entries; a transmission matrix is square"
                f" ({len(drive)} rows)"
            )
        condition = float(np.linalg.cond(np.array(drive)))
        if condition > 1e6:
            raise FieldError(
                f"has condition number {condition:.3g} (at most 1e6); a transmission is invertible"
            )
        return drive

    @model_validator(mode="after")
    def _sizes_agree(self) -> Self:
        sizes: dict[str, object] = {
            "drive": self.drive,
            "posture": self.posture,
            "torque_limits": self.torque_limits,
            "calibration_error.joint_offset": self.calibration_error.joint_offset,
            "calibration_error.link_length": self.calibration_error.link_length,
        }
        if isinstance(self.friction, JointFriction):
            sizes |= {f"friction.{name}": value for name, value in self.friction}
        if isinstance(self.armature, Rotors):
            sizes |= {f"armature.{name}": value for name, value in self.armature}
        else:
            sizes["armature"] = self.armature
        if self.stops is not None:
            sizes["stops.stiffness"] = self.stops.stiffness
        counts = {name: len(value) for name, value in sizes.items() if isinstance(value, tuple)}
        if len(set(counts.values())) > 1:
            raise FieldError(
                f"entries per joint disagree: {counts}; all must equal the arm's number of joints"
            )
        return self

    @model_validator(mode="after")
    def _rotors_turn_with_joints(self) -> Self:
        if self.drive is not None and self.armature != 0.0:
            T = np.array(self.drive)
            if np.any(np.diag(np.diagonal(T)) != T):
                raise FieldError(
                    "is stated beside a drive matrix that couples joints: rotors there turn with drives, and"
                    " couple joints too; add their inertia to that of the links that turn with them",
                    "armature",
                )
        return self

    @classmethod
    def from_urdf(
        cls,
        path_or_name: str | Path,
        tip: str = "",
        *,
        base: Pose | ArrayLike = (0.0, 0.0, 0.0),
        posture: ArrayLike | None = None,
        locked: Mapping[str, float] | Literal["others"] | None = None,
        **fields: Any,
    ) -> Self:
        """Return the arm of a file, or of a bundled or example-robot-data robot.

        Args:
            path_or_name: path of a URDF or xacro file, or a name such as "panda".
            tip: frame that is fixed to the payload; when omitted, the only link without child joints.
            base: X_WB, as a Pose, a matrix of shape (4, 4) or a position of shape (3,).
            posture: joint angles near which the arm starts.
            locked: joints that do not move, and their angles; "others" for those that do not move the tip.
            fields: any other field.

        Raises:
            UrdfError: no such file or name; the file has defects; it has several end links and no tip is
                given.
            MissingExtraError: it is a xacro file and xacrodoc is not installed.
            ScenarioError: another field has mistakes.
        """
        file = find_urdf(path_or_name)
        urdf = str(file.path) if file.origin == "user" else str(path_or_name)
        return cls(
            urdf=urdf, tip=tip, base=base, posture=posture, locked={} if locked is None else locked, **fields
        )

    @property
    def file(self) -> UrdfFile:
        """The URDF or xacro file.

        Raises:
            UrdfError: there is none.
        """
        file = find_urdf(self.urdf, package_dirs=self.package_dirs, xacro_args=self.xacro_args)
        locked, repairs = tuple(self.locked.items()), self.impossible_inertia == "repair"
        return dataclasses.replace(file, carrier=self.mobile_base, locked=locked, repairs=repairs)

    @property
    def robot(self) -> Robot:
        """Kinematics of its URDF with all joints, without Pinocchio; raises as ``file``."""
        return _robot(self.file)

    def moving_joints(self) -> tuple[str, ...]:
        """Return the names of its joints, in Pinocchio's order; raises as ``file``."""
        return self.robot.unlocked(self.locked)

    def tip_poses(self, angles: Array) -> Array:
        """Return X_WE by its URDF, without calibration errors, shape (..., 4, 4).

        Args:
            angles: joint angles, rad or m, shape (..., k).
        """
        robot, columns = self.robot, np.moveaxis(angles, -1, 0)
        moving = dict(zip(robot.unlocked(self.locked), columns, strict=True))
        poses: Array = self.base.matrix @ robot.pose(self.tip, robot.locked(self.locked) | moving)
        return poses

    def is_sibling(self, other: Arm) -> bool:
        """Return whether another arm is of the same robot: of one URDF and base, with another tip.

        Compared as written: a scenario may be described before its URDF files are where it names them.
        """
        mine, others = (
            (arm.urdf, arm.package_dirs, arm.xacro_args, arm.mobile_base, arm.base) for arm in (self, other)
        )
        return mine == others and self.tip != other.tip

    @property
    def base_joints(self) -> int:
        """Number of its first joints, which move its mobile base."""
        return 0 if self.mobile_base is None or isinstance(self.mobile_base, DifferentialBase) else 3

    @property
    def wheels(self) -> DifferentialBase | None:
        """Its base on wheels that a drive of its own moves; None without, or if it is parked."""
        base = self.mobile_base
        return base if isinstance(base, DifferentialBase) and base.is_driven else None

    def drive_matrix(self, nv: int) -> Array:
        """Return the transmission matrix T, shape (nv, nv).

        Raises:
            FieldError: ``drive`` has another size.
        """
        if self.drive is not None and len(self.drive) != nv:
            raise FieldError(f"has {len(self.drive)} rows; the arm {self.urdf!r} has {nv} joints", "drive")
        return np.eye(nv) if self.drive is None else np.array(self.drive)
