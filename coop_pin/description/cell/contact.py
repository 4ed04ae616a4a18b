"""Contact with friction: grasps by a pressed patch, and tables that the payload may lie on."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, Interval, Positive, positive
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import inverse_pose, rotate_vector6, shift_wrench
from coop_pin.base.spatial.limit_surface import elastic_pressures, needed_friction
from coop_pin.description.cell.payload import Payload

_ON_FACE = 1e-3
"""Largest distance of a patch from the face of a box, m."""
_ALONG = 1e-3
"""Largest entry of a patch's normal across the normal of that face."""
_RING = np.arange(8) * np.pi / 4.0
_CORNERS = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
PRESSES = ("x", "-x", "y", "-y", "z", "-z")
"""Axes of the grasp frame along which an arm may press."""


Edges = Annotated[Interval, AfterValidator(positive)]
"""Edges of a rectangle, m."""


class DryContact(Description):
    """Numbers of a contact with dry friction: the equations of ``ContactPoints``, which share them equally.

    Attributes:
        mu: Coefficient of friction.
        stiffness: Normal stiffness of all points together, N/m.
        shear_stiffness: Stiffness of all bristles together, N/m: what a stuck contact gives sideways.
        damping_ratio: zeta of the normal damper 2 zeta sqrt(k / W) and that of the bristles, with W the
            mobility between the two bodies at the start.
    """

    mu: Positive
    stiffness: Positive = 1e5
    shear_stiffness: Positive = 1e5
    damping_ratio: Positive = 0.5


class Pad(Description):
    """Pad by which a gripper presses: what a grasp that holds any wrench would bear by friction alone.

    Attributes:
        mu: Coefficient of friction.
        radius: Radius of a round pad, m; or
        size: Edges of a rectangular one, m.
        press: Axis of the grasp frame along which the arm presses; the others follow it in cyclic order.
    """

    mu: Positive
    radius: Positive | None = None
    size: Edges | None = None
    press: Literal["x", "-x", "y", "-y", "z", "-z"] = "z"

    @model_validator(mode="after")
    def _has_one_outline(self) -> Self:
        if (self.radius is None) == (self.size is None):
            raise FieldError(f"is {self.radius}, and size is {self.size}; give exactly one", "radius")
        return self

    @property
    def torsion_radius(self) -> float:
        """R of the torsion mu N r that it bears, m: the mean distance from the middle, 2/3 of a radius."""
        return float(np.linalg.norm(self.points, axis=1).mean())

    @property
    def levers(self) -> Array:
        """Levers l of moments m about the axes of the plane, m, shape (2,): it tips from m = N l on."""
        return np.full(2, self.torsion_radius) if self.size is None else self.points[-1, 1::-1]

    @property
    def plane(self) -> Array:
        """X_GF: plane of the face in the grasp frame; its z axis points out of the payload, shape (4, 4)."""
        axis, X = PRESSES.index(self.press), np.eye(4)
        normal = np.zeros(3)
        normal[axis // 2] = -1.0 if axis % 2 == 0 else 1.0
        first = np.eye(3)[(axis // 2 + 1) % 3]
        X[:3, :3] = np.column_stack((first, np.cross(normal, first), normal))
        return X

    @property
    def points(self) -> Array:
        """Points of the patch in the plane, m, shape (n, 3)."""
        if self.size is None:
            outer = (
                0.75 * (self.radius or 0.0) * np.stack((np.cos(_RING), np.sin(_RING), 0.0 * _RING), axis=1)
            )
        else:
            a, b = half = 0.5 * np.array(self.size)
            d = np.hypot(a, b)
            r = d / 3.0 + (a * a / b * np.arcsinh(b / a) + b * b / a * np.arcsinh(a / b)) / 6.0
            outer = 1.25 * r / d * np.array([(*signs * half, 0.0) for signs in _CORNERS])
        return np.concatenate((np.zeros((1, 3)), outer))

    @property
    def reach(self) -> Array:
        """Half extents of the patch along the axes of the plane, m, shape (2,)."""
        return np.full(2, self.radius) if self.size is None else 0.5 * np.array(self.size)

    def in_plane(self, F: Array, X_PG: Array) -> Array:
        """Return wrenches about P as those about the middle of the pad in axes of its plane, shape (..., 6).

        Args:
            F: Wrenches on the arm about P, shape (..., 6).
            X_PG: Pose of the grasp frame seen from P, in the axes of the wrenches, shape (4, 4).
        """
        X_PF = X_PG @ self.plane
        return rotate_vector6(X_PF[:3, :3].T, shift_wrench(F, -X_PF[:3, 3]))

    def pressures(self, F: Array) -> Array:
        """Return the parts of the normal force that the points bear, shape (..., k): all the same.

        Args:
            F: Wrenches on the arm about the middle of the pad in axes of the plane, shape (..., 6).
        """
        return np.full((*F.shape[:-1], len(self.points)), 1.0 / len(self.points))

    def needed_friction(self, F: Array) -> Array:
        """Return the friction mu N that wrenches need (``spatial.limit_surface``), N, shape (...,).

        Args:
            F: Wrenches on the arm about the middle of the pad in axes of the plane, shape (..., 6).
        """
        return needed_friction(F, self.points[:, :2], self.pressures(F))


class PatchGrasp(Pose, DryContact, Pad):
    """Grasp by friction: a patch fixed to the arm's tip is pressed on a flat face of the payload.

    Nothing but friction holds the payload: it sticks, slides, spins, tips and drops. The patch is a few
    points on the plane of the face, with the torsion of an evenly pressed one: the middle, and eight on a
    ring of 3/4 of the radius, with a disc's stiffness against tilting as well; or four on the diagonals.

    Attributes:
        xyz: Position of the grasp frame in payload axes, m: the middle of the patch, on the face.
        rpy: Roll, pitch, yaw of the grasp frame, rad.
        kind: "patch"; in a file, a grasp without a kind is rigid.
        mu: Coefficient of friction.
        radius: Radius of a round patch, m; or
        size: Edges of a rectangular one, m.
        press: Axis of the grasp frame along which the arm presses; the others follow it in cyclic order.
        face: Edges of the payload's face about the grasp, m; a box has its own.
        stiffness: Normal stiffness of all points together, N/m.
        shear_stiffness: Stiffness of all bristles together, N/m: what a stuck contact gives sideways.
        damping_ratio: zeta of the normal damper 2 zeta sqrt(k / W) and that of the bristles, with W the
            mobility between the two bodies at the start.
    """

    kind: Literal["patch"] = "patch"
    face: Edges | None = None

    @property
    def stiffnesses(self) -> tuple[float, ...]:
        """Diagonal of K in axes of the plane while all points stick, N/m and N m/rad, shape (6,)."""
        x, y, _ = (self.points**2).mean(axis=0).tolist()
        k, shear = self.stiffness, self.shear_stiffness
        return shear, shear, k, k * y, k * x, shear * (x + y)

    def pressures(self, F: Array) -> Array:
        """Return the parts of the normal force that the points bear, by their springs, shape (..., k).

        Args:
            F: Wrenches on the arm about the middle of the patch in axes of the plane, shape (..., 6).
        """
        return elastic_pressures(F, self.points[:, :2], self.levers)

    def bounds(self, payload: Payload) -> Array:
        """Return lower and upper corner of the payload's face in the plane, m, shape (2, 2).

        Raises:
            FieldError: the face is not known, the patch does not lie on it, or reaches beyond it.
        """
        if self.face is not None:
            half = 0.5 * np.array(self.face)
            bounds = np.array((-half, half))
        else:
            bounds = self._face_of_box(payload)
        beyond = np.maximum(self.reach - bounds[1], bounds[0] + self.reach).max()
        if beyond > 1e-12:
            name = "radius" if self.size is None else "size"
            raise FieldError(
                f"reaches {1e3 * beyond:.3g} mm beyond the payload's face, which spans"
                f" {bounds[0].tolist()} to {bounds[1].tolist()} m about the grasp; use a smaller patch, or"
                " move the grasp",
                name,
            )
        return bounds

    def _face_of_box(self, payload: Payload) -> Array:
        if payload.shape != "box":
            raise FieldError(
                f"is missing; the payload is drawn as a {payload.shape}, whose flat faces are not known:"
                " state the edges of the face about the grasp, m",
                "face",
            )
        X_SF = inverse_pose(payload.shape_pose.matrix) @ self.matrix @ self.plane
        half, normal, p = 0.5 * np.array(payload.size), X_SF[:3, 2], X_SF[:3, 3]
        axis = int(np.abs(normal).argmax())
        distance = float(np.sign(normal[axis]) * p[axis] - half[axis])
        if np.abs(np.delete(normal, axis)).max() > _ALONG or abs(distance) > _ON_FACE:
            raise FieldError(
                f"is {list(self.xyz)}; pressed along {self.press} it is {1e3 * distance:.3g} mm outside the"
                f" nearest face of the box, with the normal {np.round(normal, 6).tolist()} in its axes: put"
                " the grasp on a face, and let it press into it",
                "xyz",
            )
        corners = np.array([(-1.0, -1.0), (1.0, 1.0)])
        across = np.delete(np.arange(3), axis)
        edges = np.zeros((2, 3))
        edges[:, across], edges[:, axis] = corners * half[across], p[axis]
        in_plane = (edges - p) @ X_SF[:3, :2]
        return np.array((in_plane.min(axis=0), in_plane.max(axis=0)))


class Table(Pose, DryContact):
    """Table: a bounded plane fixed in the world that the payload's corners may lie on.

    Attributes:
        xyz: Position of the middle of its top in the world, m.
        rpy: Roll, pitch, yaw of the top, rad; its z axis points up, to the payload.
        size: Edges of the top along its x and y axes, m.
        mu: Coefficient of friction.
        stiffness: Normal stiffness of the corners of one face together, N/m.
        shear_stiffness: Stiffness of their bristles together, N/m: what a stuck contact gives sideways.
        damping_ratio: zeta of the normal damper 2 zeta sqrt(k / W) and that of the bristles, with W the
            mobility of the payload.
    """

    size: Edges

    @property
    def bounds(self) -> Array:
        """Lower and upper corner of the top in its plane, m, shape (2, 2)."""
        half = 0.5 * np.array(self.size)
        return np.array((-half, half))


def corners(payload: Payload) -> Array:
    """Return the points of the payload that may lie on a table, in payload axes, m, shape (n, 3).

    They are the corners of its bounding box; a cylinder has eight on each rim.
    """
    half = 0.5 * np.array(payload.size)
    if payload.shape == "cylinder":
        rim = np.stack((np.cos(_RING), np.sin(_RING), np.ones(8)), axis=1)
        signs = np.concatenate((rim, rim * (1.0, 1.0, -1.0)))
    else:
        signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    X = payload.shape_pose.matrix
    # The box of a mesh is about its own middle, which the payload does not know: about P.
    return (signs * half) @ X[:3, :3].T + (0.0 if payload.shape == "mesh" else X[:3, 3])
