"""Grasp of an arm on the payload: rigid, a joint, a spring and damper, or a patch; tools without grasp."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, field_validator

from coop_pin.base.arrays import Array, as_array, as_pose, require_type
from coop_pin.base.errors import FieldError, NameNotFoundError, OutOfRangeError, suggestion
from coop_pin.base.schema.base import Positive, Vector3, Vector6, by_name, not_negative, positive
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import inverse_pose, rotate_vector6, shift_wrench
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.closure import NamedRows, row_mask
from coop_pin.description.cell.contact import PatchGrasp
from coop_pin.reference.joint_motion import JointMotion
from coop_pin.reference.motions import Motion
from coop_pin.reference.pose_reference import PoseTarget, carried

STIFFNESSES = {
    "paper": (3e5, 3e5, 3e5, 3e3, 3e3, 3e3),
    "firm": (3e4, 3e4, 3e4, 3e2, 3e2, 3e2),
    "soft": (5e3, 5e3, 5e3, 50.0, 50.0, 50.0),
}
"""Stiffness of a grasp by name, N/m and N m/rad.

"paper" is the 300 kN/m of the object in the paper's simulation, and "soft" the 5 kN/m of a planner for
torque-controlled dual arms. Neither source states the rotation: it is k / 100 m^2, as for pads of some 0.1 m.
"""


class CompliantGrasp(Pose):
    """Compliant grasp: a spring and damper holds the arm's tip at the grasp frame on the payload.

    In axes of the grasp frame, with the tip's displacement p and rotation R from it and its relative twist V,
    the wrench on the arm about the tip is

    ::

        F = -K [p, r] - D V,    r = vee(R G - G R^T) / k_r,    G = tr(K_r) / 2 - K_r

    with r the rotation vector for small angles. It is the gradient of p.K_p p / 2 + tr(G - G R), so that
    energy only leaves through D (Fasse's spring).

    Attributes:
        xyz: Position of the grasp frame in payload axes, m.
        rpy: Roll, pitch, yaw of the grasp frame, rad.
        kind: "compliant"; in a file, a grasp without a kind is rigid.
        stiffness: Diagonal of K in grasp axes, N/m and N m/rad: six numbers, or "paper" (300 kN/m of its
            object, our 3 kN m/rad), "firm" (30 kN/m, 0.3 kN m/rad) or "soft" (5 kN/m, 50 N m/rad).
        damping_ratio: zeta of D_ii = 2 zeta sqrt(K_ii / W_ii), with W the mobility between tip and grasp at
            the start, arm and payload free.
        damping: Diagonal of D, N s/m and N m s/rad, in place of the ratio.
    """

    kind: Literal["compliant"] = "compliant"
    stiffness: Annotated[Vector6, AfterValidator(positive), by_name(STIFFNESSES, "six numbers")]
    damping_ratio: Positive = 0.3
    damping: Annotated[Vector6, AfterValidator(not_negative)] | None = None

    @classmethod
    def measured(cls, load: ArrayLike, deflection: ArrayLike, **fields: Any) -> Self:
        """Return the grasp whose stiffness a load and its deflection show.

        Args:
            load: Force and moment along each grasp axis, N and N m, shape (6,).
            deflection: Displacement and rotation that each causes, m and rad, shape (6,).
            fields: The other fields.

        Raises:
            OutOfRangeError: a ratio is not a positive number.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            stiffness: Array = np.abs(as_array("load", load, 6) / as_array("deflection", deflection, 6))
        for index, value in enumerate(stiffness.tolist()):
            if not 0.0 < value < np.inf:
                raise OutOfRangeError(f"load[{index}] / deflection[{index}]", value, "a positive number")
        return cls(stiffness=tuple(stiffness.tolist()), **fields)


def _not_zero(axis: tuple[float, ...]) -> tuple[float, ...]:
    if not any(axis):
        raise FieldError("is zero; an axis has a direction")
    return axis


class LinkGrasp(Pose):
    """Rigid grasp that names the link that it holds, of a payload of several links.

    Attributes:
        xyz: Position of the grasp frame in payload axes, with the payload's joints at their start, m.
        rpy: Roll, pitch, yaw of the grasp frame, rad.
        kind: "rigid".
        link: Name of the link in the payload's URDF.
    """

    kind: Literal["rigid"] = "rigid"
    link: str = Field(min_length=1)


class JointGrasp(Pose):
    """Grasp of fewer rows: an ideal joint between the arm's tip and the payload, without friction.

    Its frame C is the grasp frame with z turned onto the axis. In axes of C the rows of wrenches that it
    transmits are those of the relative motions that it holds:

    - "hinge": all but the turn about z;
    - "ball": the three forces;
    - "cylinder": neither the turn about z nor the slide along it.

    Attributes:
        xyz: Position of the grasp frame in payload axes, m.
        rpy: Roll, pitch, yaw of the grasp frame, rad.
        kind: "hinge", "ball" or "cylinder".
        axis: Axis of a hinge or cylinder in grasp axes, of any length; a ball has none.
        link: Name of the link that it holds, of a payload of several; that of P when empty.
    """

    kind: Literal["hinge", "ball", "cylinder"] = "hinge"
    axis: Annotated[Vector3, AfterValidator(_not_zero)] = (0.0, 0.0, 1.0)
    link: str = ""

    @property
    def X_EC(self) -> Array:
        """Pose of C in the grasp frame, shape (4, 4)."""
        return Pose.model_validate({"approach": self.axis}).matrix

    @property
    def closes(self) -> NamedRows:
        """Rows of the closure, in axes of C."""
        rows: dict[str, NamedRows] = {"hinge": "axis", "ball": "point", "cylinder": "cylinder"}
        return rows[self.kind]

    @property
    def to_held_rows(self) -> Array:
        """Map of a twist, or a gap, in grasp axes to the rows that it holds, zero in the others, (6, 6)."""
        held: Array = np.diag(np.array(row_mask(self.closes), dtype=float))
        return held @ np.kron(np.eye(2), self.X_EC[:3, :3].T)


class ToolTip(Pose):
    """Tip of an arm that holds nothing of the payload, but works on it: a tool.

    It closes no loop and bears no load. Its arm sees the payload where its tip would hold it, at X_PE.

    Attributes:
        xyz: Position of the tip at the start in payload axes, m.
        rpy: Roll, pitch, yaw of the tip at the start, rad.
        kind: "tool".
        motion: Desired motion of the tip in the payload frame; at rest where it starts when omitted.
    """

    kind: Literal["tool"] = "tool"
    motion: Motion | None = None

    @field_validator("motion")
    @classmethod
    def _is_of_a_frame(cls, motion: Motion | None) -> Motion | None:
        if isinstance(motion, JointMotion):
            raise FieldError("is 'joints', by which arms move the payload; state a motion of the tip", "kind")
        return motion

    def carried(self, target: PoseTarget, time: float) -> PoseTarget:
        """Return the target of the payload as the arm is to see it at a time, s, from that of the payload."""
        if self.motion is None:
            return target
        return carried(target, self.motion.at(time), self.matrix)


_KINDS = {
    "tool": "tool",
    "patch": "patch",
    "compliant": "compliant",
    "hinge": "joint",
    "ball": "joint",
    "cylinder": "joint",
    "rigid": "link",
}


def _kind(value: Any) -> str:
    kind = value.get("kind", "") if isinstance(value, dict) else getattr(value, "kind", "")
    if not kind and isinstance(value, dict) and "link" in value:
        return "link"
    return _KINDS.get(kind, "compliant") if isinstance(kind, str) and kind else "rigid"


def _known(value: Any) -> Any:
    """Return a grasp whose kind, if it is a word, there is."""
    kind = value.get("kind", "") if isinstance(value, dict) else ""
    if isinstance(kind, str) and kind and kind not in _KINDS:
        raise FieldError(f"is {kind!r}; {suggestion(kind, [*_KINDS])}", "kind")
    return value


Grasp = Annotated[
    Annotated[Pose, Tag("rigid")]
    | Annotated[LinkGrasp, Tag("link")]
    | Annotated[JointGrasp, Tag("joint")]
    | Annotated[ToolTip, Tag("tool")]
    | Annotated[CompliantGrasp, Tag("compliant")]
    | Annotated[PatchGrasp, Tag("patch")],
    Discriminator(_kind),
    BeforeValidator(_known),
]
"""Pose X_PE of a rigid grasp, the same on a named link, a joint, a compliant grasp, a patch, or a tool."""


def compliance_of(grasp: Pose) -> Array:
    """Return C of a grasp that gives, from a wrench about P to the displacement there, shape (6, 6).

    In payload axes, m/N and rad/(N m); zero for a grasp that does not give.
    """
    if isinstance(grasp, PatchGrasp):
        X, stiffness = grasp.matrix @ grasp.plane, grasp.stiffnesses
    elif isinstance(grasp, CompliantGrasp):
        X, stiffness = grasp.matrix, grasp.stiffness
    else:
        return np.zeros((6, 6))
    to_grasp = rotate_vector6(X[:3, :3].T, shift_wrench(np.eye(6), np.tile(-X[:3, 3], (6, 1))))
    return to_grasp @ np.diag(1.0 / np.array(stiffness)) @ to_grasp.T


def grasps_from_configuration(
    arms: Mapping[str, Arm], joint_angles: Mapping[str, ArrayLike], payload_pose: Pose | ArrayLike
) -> dict[str, Pose]:
    """Return the grasps X_PE of arms at given joint angles: X_PE = X_WP^-1 X_WB X_BE(q).

    Args:
        arms: the arms by name.
        joint_angles: angles of every arm, one value for each joint that is neither fixed nor locked, rad or
            m, in Pinocchio's order.
        payload_pose: X_WP, as a Pose or a matrix of shape (4, 4).

    Raises:
        NameNotFoundError: an arm has no joint angles.
        ShapeError: the number of angles is not that of the joints.
        UrdfError, NameNotFoundError: an arm's URDF or tip is missing or has defects.
    """
    require_type("arms", arms, Mapping)
    require_type("joint_angles", joint_angles, Mapping)
    X_WP = payload_pose.matrix if isinstance(payload_pose, Pose) else as_pose("payload_pose", payload_pose)
    grasps = {}
    for name, arm in arms.items():
        require_type(f"arms[{name!r}]", arm, Arm)
        if name not in joint_angles:
            raise NameNotFoundError("arm", name, joint_angles, "joint_angles")
        angles = as_array(f"joint_angles[{name!r}]", joint_angles[name], len(arm.moving_joints()))
        grasps[name] = Pose.from_matrix(inverse_pose(X_WP) @ arm.tip_poses(angles))
    return grasps
