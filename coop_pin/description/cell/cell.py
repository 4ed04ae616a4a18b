"""Cell: arms that hold one payload, the distance that they keep and the joints that they share."""

from __future__ import annotations

import itertools
from typing import Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import ArgumentError, FieldError, one_or_all
from coop_pin.base.schema.base import (
    NotNegative,
    plain_name,
)
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import inverse_pose
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.differential_base import DifferentialBase
from coop_pin.description.cell.grasp import LinkGrasp
from coop_pin.description.cell.held_payload import HeldPayload
from coop_pin.description.cell.shared_joint import (
    SharedJoint,
    SharedJoints,
    require_own_joints,
    shared_problems,
    wheel_problems,
)
from coop_pin.description.events import Surroundings
from coop_pin.reference.pose_reference import PoseTarget


class Cell(HeldPayload):
    """Arms that grasp one payload: rigidly, compliantly or by friction; a single arm is an arm with a load.

    Its first fields are those of ``HeldPayload``.

    Attributes:
        clearance: distance that bodies which may not touch should keep, m; ``check`` warns below it, and
            proposed postures keep it where they can.
        shared_joints: joints of one robot that its arms lock and a drive of its own moves, by name.
    """

    clearance: NotNegative = 0.0
    shared_joints: dict[str, SharedJoint] = Field(default={})

    @field_validator("arms")
    @classmethod
    def _named(cls, arms: dict[str, Arm]) -> dict[str, Arm]:
        for name in arms:
            plain_name(name)
            if "." in name or name == "payload":
                raise FieldError(f"arm name {name!r} must not be 'payload', nor contain '.'")
        return arms

    @field_validator("arms")
    @classmethod
    def _share_no_joint(cls, arms: dict[str, Arm]) -> dict[str, Arm]:
        for name, other in itertools.combinations(arms, 2):
            if arms[name].is_sibling(arms[other]):
                require_own_joints(name, arms[name], other, arms[other])
        return arms

    @model_validator(mode="after")
    def _holds_with_tools(self) -> Self:
        borne = sum(self.gain_shares[index] for index, name in enumerate(self.arms) if name not in self.tools)
        if self.tools and (not borne > 0.0 or self.unclosed or self.jointed or self.tables):
            detail = "has tools; beside them are rigid grasps that bear the load, and no tables"
            raise FieldError(detail, "grasps")
        return self

    @model_validator(mode="after")
    def _carried_by_one_robot(self) -> Self:
        g, is_planar = np.array(self.gravity), self.rows == "planar"
        if problems := list(shared_problems(self.shared_joints, self.arms, g, is_planar)):
            raise one_or_all([problem.below("shared_joints") for problem in problems], "the shared joints")
        if problems := list(wheel_problems(self.arms, self.shared_joints, g, is_planar)):
            raise one_or_all([problem.below("arms") for problem in problems], "the mobile bases")
        return self

    @property
    def carrier(self) -> SharedJoints | None:
        """Shared joints with the arms that they carry; None without any."""
        return SharedJoints.of(self.shared_joints, self.arms) if self.shared_joints else None

    @property
    def wheels(self) -> dict[str, DifferentialBase]:
        """Bases that roll, by the name of their arm."""
        return {name: arm.wheels for name, arm in self.arms.items() if arm.wheels is not None}

    @property
    def carriers(self) -> tuple[SharedJoints, ...]:
        """What moves arms by drives of its own: a robot on shared joints, or each base that rolls."""
        bases = (SharedJoints.of_wheels(name, self.arms[name]) for name in self.wheels)
        return tuple(bases) if self.carrier is None else (self.carrier,)

    @property
    def driven(self) -> tuple[str, ...]:
        """Joints under the arms that drives of their own move: shared ones, or those of bases that roll."""
        return tuple(joint for carrier in self.carriers for joint in carrier.joints)

    @property
    def surroundings(self) -> Surroundings:
        """Payload and gravity before all events, without a push; every field is a new object."""
        mass, inertia = np.float64(self.payload.mass), self.payload.inertia_matrix
        return Surroundings(mass, inertia, np.array(self.gravity), np.zeros(6))

    @property
    def rigid(self) -> Self:
        """The same cell with rigid grasps on the same links, without tables."""
        links = self.held_links
        grasps = {
            name: LinkGrasp(xyz=g.xyz, rpy=g.rpy, link=links[name])
            if name in links
            else Pose(xyz=g.xyz, rpy=g.rpy)
            for name, g in self.grasps.items()
        }
        return self.replace(grasps=grasps, tables={})

    def require_rigid(self, purpose: str) -> None:
        """Refuse other grasps, and tables, where the method is that of rigid ones.

        Args:
            purpose: Subject that needs rigid grasps, as the beginning of a sentence.

        Raises:
            ArgumentError: a tip is a tool, a grasp compliant or held by friction, with the arms; there is a
                table, or the payload has several links.
        """
        if self.payload.links is not None:
            raise ArgumentError(f"{purpose} is for a payload of one body, and this one has several links")
        for names, are in (
            (list(self.jointed), "those of {} are joints"),
            (list(self.compliant), "those of {} are compliant"),
            (list(self.patches), "those of {} are held by friction"),
            (list(self.tables), "the cell has tables {}"),
            (list(self.tools), "the tips of {} are tools"),
        ):
            if names:
                raise ArgumentError(
                    f"{purpose} is for rigid grasps, and {are.format(names)}; look at ``cell.rigid``, with"
                    " bare poses as grasps"
                )

    @property
    def controls_turns(self) -> bool:
        """Whether the task rows have a rotation."""
        return self.rows != "positional"

    def arm_joints(self) -> dict[str, tuple[str, ...]]:
        """Return the names of the moving joints of each arm."""
        return {name: arm.moving_joints() for name, arm in self.arms.items()}

    def payload_poses(self, arm: str, angles: Array) -> Array:
        """Return X_WP of the payload in the grasp of an arm, (..., 4, 4), at joint angles, (..., k)."""
        return self.arms[arm].tip_poses(angles) @ inverse_pose(self.grasps[arm].matrix)

    def siblings(self, arm: str) -> tuple[str, ...]:
        """Return the other arms of the same robot: of one URDF and base, with another tip."""
        return tuple(name for name, other in self.arms.items() if self.arms[arm].is_sibling(other))

    def target_of(self, arm: str, target: PoseTarget, time: float) -> PoseTarget:
        """Return the target of the payload for an arm: that of a tool moves with the tool.

        Args:
            arm: Name of the arm.
            target: Target of the payload.
            time: Time, s.
        """
        tool = self.tools.get(arm)
        return target if tool is None else tool.carried(target, time)

    def share(self, arm: str) -> float:
        """Return the load share c_i of an arm."""
        return float(self.shares[list(self.arms).index(arm)])
