"""Links and undriven joints of a payload of several links, from URDF, and the URDF of a row of rods."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError, suggestion
from coop_pin.base.schema.base import Description, Name, NotNegative
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import inverse_pose, shift_wrench
from coop_pin.description.urdf import UrdfFile, find_urdf, load_checked, text_checked
from coop_pin.description.urdf.robot import Robot, links_of

Count = Annotated[int, Field(ge=3, le=1000)]
"""Number of rods in a row."""
_MOVING = ("revolute", "continuous", "prismatic")


class PayloadJoint(Description):
    """Joint between links of a payload, which no drive moves: spring, damper, friction and stops.

    Attributes:
        start: Angle or travel at which grasps are stated, and near which the payload starts, rad or m.
        stiffness: Stiffness of its spring, N m/rad or N/m.
        rest: Angle or travel at which the spring is relaxed, rad or m.
        damping: Damping, N m s/rad or N s/m; that of the URDF when omitted.
        friction: Coulomb friction, N m or N; that of the URDF when omitted.
        stop_stiffness: Stiffness k of the stops at the limits of the URDF, N m/rad or N/m; 0 for none. When
            omitted that at which the joint of the payload in nobody's hands swings at 30 rad/s on them.
        stop_damping_ratio: Damping of the joint on its stop in the grasps at the start; 1 is critical.
    """

    start: float = 0.0
    stiffness: NotNegative = 0.0
    rest: float = 0.0
    damping: NotNegative | None = None
    friction: NotNegative | None = None
    stop_stiffness: NotNegative | None = None
    stop_damping_ratio: NotNegative = 0.5


class LinkBody(NamedTuple):
    """Link of a payload as a body.

    Attributes:
        mass: Mass, kg.
        inertia: Inertia about the centre of mass in axes of the link, kg m^2, shape (3, 3).
        centre: Centre of mass in the link, m, shape (3,).
        visuals: Shapes of the link, as of yourdfpy.
    """

    mass: float
    inertia: Array
    centre: Array
    visuals: tuple[Any, ...]

    @classmethod
    def of(cls, link: Any) -> LinkBody:
        """Return the body of a link of yourdfpy, without mass where the URDF states none."""
        inertial, shapes = link.inertial, tuple(link.visuals)
        if inertial is None or not inertial.mass:
            return cls(0.0, np.zeros((3, 3)), np.zeros(3), shapes)
        X_LI = np.eye(4) if inertial.origin is None else inertial.origin
        inertia = X_LI[:3, :3] @ inertial.inertia @ X_LI[:3, :3].T
        return cls(inertial.mass, inertia, X_LI[:3, 3], shapes)

    def fields(self) -> dict[str, Any]:
        """Return mass, inertia and shape of a payload, with P at the centre of mass in axes of the link."""
        M = self.inertia
        inertia = (M[0, 0], M[1, 1], M[2, 2], M[0, 1], M[0, 2], M[1, 2])
        return {"mass": self.mass, "inertia": inertia, **self._drawn()}

    def _drawn(self) -> dict[str, Any]:
        """Return size, shape and its pose in P of the first visual, if it is a box or a cylinder."""
        for visual in self.visuals[:1]:
            X_PS = np.eye(4) if visual.origin is None else np.array(visual.origin)
            X_PS[:3, 3] -= self.centre
            if (box := visual.geometry.box) is not None:
                return {"size": box.size, "shape_pose": Pose.from_matrix(X_PS)}
            if (cylinder := visual.geometry.cylinder) is not None:
                size = (2.0 * cylinder.radius, 2.0 * cylinder.radius, cylinder.length)
                return {"size": size, "shape": "cylinder", "shape_pose": Pose.from_matrix(X_PS)}
        return {}


@lru_cache(maxsize=32)
def _robot(text: str) -> Robot:
    return Robot(text)


@lru_cache(maxsize=32)
def _bodies(text: str) -> dict[str, LinkBody]:
    """Return the bodies of a URDF by link."""
    return {str(link.name): LinkBody.of(link) for link in links_of(text)}


class Linkage(Description):
    """Links of a payload and the joints between them; the payload frame P is on one of the links.

    P has its origin at the centre of mass of ``link`` and the axes of that link. Its pose is what the arms
    control; the other links move as springs, weights and grasps have it.

    Attributes:
        urdf: Path of a URDF, name of a known one, or its text; joints are revolute, continuous, prismatic or
            fixed.
        link: Name of the link whose pose is controlled.
        base: Pose of the root link in the world, of a payload that is mounted there, such as a door; a
            payload without it is free.
        joints: Springs, dampers, friction and stops of joints, by their names.
    """

    urdf: str
    link: str
    base: Pose | None = None
    joints: dict[Name, PayloadJoint] = Field(default={})

    @model_validator(mode="after")
    def _of_the_urdf(self) -> Self:
        robot, bodies = self.robot, self.bodies
        self.require_link(self.link, "link")
        if wrong := [name for name, kind in robot.joints.items() if kind not in _MOVING]:
            raise FieldError(f"has joints {wrong} that are planar or floating", "urdf")
        if robot.mimics:
            raise FieldError(f"has mimic joints {list(robot.mimics)}, which a payload does not have", "urdf")
        if not robot.joints:
            raise FieldError("has no joint that moves; a single body is kind = 'urdf'", "urdf")
        for name in self.joints:
            if name not in robot.joints:
                raise FieldError(
                    f"names no joint of it; {suggestion(name, list(robot.joints))}", f"joints.{name}"
                )
            lower, upper = robot.limits(name)
            if not lower <= (start := self.joints[name].start) <= upper:
                detail = f"is {start:g}, beyond the limits {lower:g} to {upper:g} of the joint"
                raise FieldError(detail, f"joints.{name}.start")
        if not bodies[self.link].mass:
            raise FieldError(f"is {self.link!r}, which has no mass; P is at its centre of mass", "link")
        if self.base is not None and len(robot.movers(self.link)) != 1:
            detail = f"is {self.link!r}, moved by {list(robot.movers(self.link))} on a payload with a base;"
            raise FieldError(f"{detail} state a link that one joint moves", "link")
        return self

    def require_link(self, name: str, path: str) -> None:
        """Refuse a link that the URDF does not have.

        Raises:
            FieldError: with the path of the field.
        """
        if name not in self.bodies:
            raise FieldError(
                f"is {name!r}, no link of the payload; {suggestion(name, list(self.bodies))}", path
            )

    @property
    def text(self) -> str:
        """Checked text of the URDF."""
        return self._text

    @cached_property  # analyses ask at every pose of a motion; a name without _ would count as a field
    def _text(self) -> str:
        return text_checked(self.urdf) if self.file is None else load_checked(self.file)

    @property
    def file(self) -> UrdfFile | None:
        """File of the URDF; None of a text."""
        return None if self.urdf.lstrip().startswith("<") else find_urdf(self.urdf)

    @property
    def robot(self) -> Robot:
        """Kinematics of the URDF."""
        return _robot(self.text)

    @property
    def bodies(self) -> dict[str, LinkBody]:
        """Bodies by link."""
        return _bodies(self.text)

    def joint(self, name: str) -> PayloadJoint:
        """Return a joint by its name."""
        return self.joints.get(name, PayloadJoint())

    @property
    def start(self) -> dict[str, float]:
        """Angles and travels at which grasps are stated, by joint, in the order of Pinocchio's q."""
        return {name: self.joint(name).start for name in self.robot.joints}

    @property
    def X_LP(self) -> Array:
        """Pose of P in its link, shape (4, 4)."""
        X = np.eye(4)
        X[:3, 3] = self.bodies[self.link].centre
        return X

    def pose(self, link: str) -> Array:
        """Return the pose of a link in P at the start, shape (4, 4)."""
        X_0P = self.robot.pose(self.link, self.start) @ self.X_LP
        return inverse_pose(X_0P) @ self.robot.pose(link, self.start)

    def weight(self, gravity: Array) -> Array:
        """Return the weight of all links about P at the start, in the axes of the gravity, those of P.

        Args:
            gravity: g in axes of P, m/s^2, shape (3,).
        """
        W = np.zeros(6)
        for mass, lever in self._centres:
            W += shift_wrench(np.concatenate((mass * gravity, np.zeros(3))), lever)
        return W

    @cached_property
    def _centres(self) -> tuple[tuple[float, Array], ...]:
        """Masses of the links and their centres in P at the start."""
        poses = {name: self.pose(name) for name in self.bodies}
        return tuple(
            (body.mass, poses[name][:3, :3] @ body.centre + poses[name][:3, 3])
            for name, body in self.bodies.items()
        )

    @property
    def freedom(self) -> Array:
        """Twist of P about P in its axes at unit rate of the joint that moves its link, shape (6,).

        It is that of a payload with a base, and constant.
        """
        (joint,), h = self.robot.movers(self.link), 1e-6
        ahead, back = (
            self.robot.pose(self.link, self.start | {joint: self.start[joint] + step}) @ self.X_LP
            for step in (h, -h)
        )
        turn = (ahead[:3, :3] @ back[:3, :3].T - back[:3, :3] @ ahead[:3, :3].T) / (4.0 * h)
        R = (self.robot.pose(self.link, self.start) @ self.X_LP)[:3, :3]
        linear = (ahead[:3, 3] - back[:3, 3]) / (2.0 * h)
        return np.concatenate((R.T @ linear, R.T @ (turn[2, 1], turn[0, 2], turn[1, 0])))


class Rods(NamedTuple):
    """Row of rigid rods along x with hinges between them: a beam of springs, or a chain.

    The first and the last rod have half the length of the others, so that a clamp is that of a beam: a hinge
    with the spring EI/l stands for the bending of the length l around it. Errors of the modes are of order 2.

    Attributes:
        mass: Mass of all, kg.
        length: Length of all, m.
        rods: Number of rods.
        section: Width along y and height along z, m.
        axis: Axis of the hinges, "y" or "z".
    """

    mass: float
    length: float
    rods: int
    section: tuple[float, float]
    axis: Literal["y", "z"]

    @property
    def pitch(self) -> float:
        """Distance l of the hinges, m."""
        return self.length / (self.rods - 1)

    @property
    def middle(self) -> str:
        """Name of the middle rod, of an even number that after the middle."""
        return f"rod{self.rods // 2}"

    def joints(self, stiffness: float, damping: float) -> dict[str, PayloadJoint]:
        """Return the hinges by name, with springs, N m/rad, and dampers, N m s/rad."""
        joint = PayloadJoint(stiffness=stiffness, damping=damping)
        return {f"hinge{index}": joint for index in range(1, self.rods)}

    def urdf(self) -> str:
        """Return the URDF; links are ``rod0``, ``rod1`` and so on, with origins at their first ends."""
        axis, parts = "0 1 0" if self.axis == "y" else "0 0 1", list[str]()
        lengths = [self.pitch] * self.rods
        lengths[0] = lengths[-1] = self.pitch / 2.0
        for index, length in enumerate(lengths):
            parts.append(_rod(f"rod{index}", self.mass * length / self.length, length, self.section))
            if index:
                parts.append(
                    f'<joint name="hinge{index}" type="revolute"><parent link="rod{index - 1}"/>'
                    f'<child link="rod{index}"/><origin xyz="{lengths[index - 1]!r} 0 0"/><axis'
                    f' xyz="{axis}"/><limit lower="-3" upper="3" effort="1" velocity="0"/></joint>'
                )
        return f'<robot name="rods">{"".join(parts)}</robot>'


def _rod(name: str, mass: float, length: float, section: tuple[float, float]) -> str:
    (y, z), x = section, length
    xx, yy, zz = (mass / 12.0 * (a * a + b * b) for a, b in ((y, z), (x, z), (x, y)))
    origin = f'<origin xyz="{x / 2.0!r} 0 0"/>'
    return (
        f'<link name="{name}"><inertial>{origin}<mass value="{mass!r}"/><inertia ixx="{xx!r}" iyy="{yy!r}"'
        f' izz="{zz!r}" ixy="0" ixz="0" iyz="0"/></inertial><visual>{origin}<geometry>'
        f'<box size="{x!r} {y!r} {z!r}"/></geometry></visual></link>'
    )
