"""The payload as a user says it: mass, inertia about its centre of mass, and a shape to draw."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Self

import numpy as np
from pydantic import ValidationInfo, field_validator

from coop_pin.arrays import Array
from coop_pin.description.mesh import mesh_body
from coop_pin.description.urdf import find_urdf, load_checked
from coop_pin.description.urdf.robot import link_body
from coop_pin.errors import FieldError
from coop_pin.schema.base import Description, Positive, Vector3, Vector6
from coop_pin.schema.pose import Pose


class Payload(Description):
    """The held object; its frame P has its origin at the centre of mass.

    Attributes:
        mass: kg.
        inertia: ixx, iyy, izz, ixy, ixz, iyz about P, kg m^2.
        size: edges of the box around it, m; a cylinder has the axis z.
        shape: what stands for it in pictures: "box", "cylinder" or "mesh".
        mesh_file: the mesh, where the shape is one.
        mesh_scale: metres of one unit of that file.
        shape_pose: pose X_PS of the shape in the payload frame.
    """

    mass: Positive
    inertia: Vector6
    size: Vector3 = (0.1, 0.1, 0.1)
    shape: Literal["box", "cylinder", "mesh"] = "box"
    mesh_file: str = ""
    mesh_scale: Positive = 1.0
    shape_pose: Pose = Pose()

    @field_validator("inertia")
    @classmethod
    def _physical(cls, inertia: tuple[float, ...], earlier: ValidationInfo) -> tuple[float, ...]:
        if "mass" not in earlier.data:  # a wrong mass has been reported, and inertias are computed from it
            return inertia
        moments = np.linalg.eigvalsh(_matrix(inertia))
        if moments[0] <= 0.0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
            raise FieldError(
                f"has principal moments {np.round(moments, 12).tolist()}; they must be positive and none may exceed the sum of the others"
            )
        return inertia

    @field_validator("mesh_file")
    @classmethod
    def _given_for_a_mesh(cls, mesh_file: str, earlier: ValidationInfo) -> str:
        if earlier.data.get("shape") == "mesh" and not mesh_file:
            raise FieldError("must be given where the shape is a mesh")
        return mesh_file

    @property
    def inertia_matrix(self) -> Array:
        """Inertia about P in the axes of P, kg m^2, shape (3, 3)."""
        return _matrix(self.inertia)

    @classmethod
    def box(cls, mass: float, size: tuple[float, float, float]) -> Self:
        """Return a homogeneous box with edges along the axes of P.

        Args:
            mass: kg.
            size: its edges along x, y and z, m.
        """
        if len(size) != 3:
            raise FieldError(
                f"has {len(size)} entries {list(size)}; it must have 3, the edges along x, y and z in m",
                "size",
            )
        x, y, z = (edge * edge * mass / 12.0 for edge in size)
        return cls(mass=mass, inertia=(y + z, x + z, x + y, 0.0, 0.0, 0.0), size=size)

    @classmethod
    def bar(cls, mass: float, length: float, thickness: float = 0.03) -> Self:
        """Return a bar along x that turns about z like a thin rod: I_z = m d^2 / 12 (section 4.1 of the paper).

        Args:
            mass: m, kg.
            length: d, m.
            thickness: edge of its square section, m; counts in I_x only.
        """
        rod = mass * length**2 / 12.0
        return cls(
            mass=mass,
            inertia=(mass * thickness**2 / 6.0, rod, rod, 0.0, 0.0, 0.0),
            size=(length, thickness, thickness),
        )

    @classmethod
    def cylinder(cls, mass: float, radius: float, length: float) -> Self:
        """Return a homogeneous cylinder about the z axis of P.

        Args:
            mass: kg.
            radius: m.
            length: m.
        """
        across, along = mass * (3.0 * radius**2 + length**2) / 12.0, mass * radius**2 / 2.0
        size = (2.0 * radius, 2.0 * radius, length)
        return cls(mass=mass, inertia=(across, across, along, 0.0, 0.0, 0.0), size=size, shape="cylinder")

    @classmethod
    def mesh(
        cls, path: str | Path, mass: float | None = None, density: float | None = None, scale: float = 1.0
    ) -> Self:
        """Return a homogeneous body that fills a closed surface mesh; P sits at its centre of mass, with the axes of the file.

        Args:
            path: an STL, OBJ, PLY or other file that trimesh reads.
            mass: kg; or
            density: kg/m^3.
            scale: metres of one unit of the file: 0.001 for one in millimetres.

        Raises:
            FieldError: the file cannot be read or its surface is open; not exactly one of mass and density is
                given.
        """
        file = Path(path).absolute()
        body = mesh_body(file, mass, density, scale)
        drawn = {
            "shape": "mesh",
            "mesh_file": str(file),
            "mesh_scale": scale,
            "shape_pose": Pose(xyz=-body.centre),
        }
        return cls(mass=body.mass, inertia=body.inertia, size=body.size, **drawn)

    @classmethod
    def from_urdf(cls, path: str | Path) -> Self:
        """Return the only link of a URDF; P sits at its centre of mass, with the axes of the link.

        Its first visual is drawn where it is a box or a cylinder, otherwise a box of 0.1 m.

        Raises:
            UrdfError: no such file; the file has defects, physical ones included, or more than one link.
        """
        body = link_body(load_checked(find_urdf(path), strict=True), str(path))
        return cls(
            mass=body.mass,
            inertia=body.inertia,
            size=body.size,
            shape=body.shape,
            shape_pose=Pose.from_matrix(body.X_PS),
        )

    def with_mass(self, mass: float) -> Self:
        """Return the same shape with another mass: the inertia scales along."""
        scale = mass / self.mass
        return self.replace(mass=mass, inertia=tuple(scale * entry for entry in self.inertia))


def _matrix(inertia: tuple[float, ...]) -> Array:
    ixx, iyy, izz, ixy, ixz, iyz = inertia
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


class PayloadSource(Description):
    """What a payload is made from. The resolved scenario holds mass, inertia and shape in its place."""

    @abstractmethod
    def build(self) -> Payload:
        """Return the payload."""


class BoxSource(PayloadSource):
    """Arguments of Payload.box."""

    kind: Literal["box"] = "box"
    mass: Positive
    size: Vector3

    def build(self) -> Payload:
        """Return the payload."""
        return Payload.box(self.mass, self.size)


class BarSource(PayloadSource):
    """Arguments of Payload.bar."""

    kind: Literal["bar"] = "bar"
    mass: Positive
    length: Positive
    thickness: Positive = 0.03

    def build(self) -> Payload:
        """Return the payload."""
        return Payload.bar(self.mass, self.length, self.thickness)


class CylinderSource(PayloadSource):
    """Arguments of Payload.cylinder."""

    kind: Literal["cylinder"] = "cylinder"
    mass: Positive
    radius: Positive
    length: Positive

    def build(self) -> Payload:
        """Return the payload."""
        return Payload.cylinder(self.mass, self.radius, self.length)


class MeshSource(PayloadSource):
    """Arguments of Payload.mesh."""

    kind: Literal["mesh"] = "mesh"
    path: str
    mass: Positive | None = None
    density: Positive | None = None
    scale: Positive = 1.0

    def build(self) -> Payload:
        """Return the payload."""
        return Payload.mesh(self.path, self.mass, self.density, self.scale)


class UrdfSource(PayloadSource):
    """Arguments of Payload.from_urdf."""

    kind: Literal["urdf"] = "urdf"
    path: str

    def build(self) -> Payload:
        """Return the payload."""
        return Payload.from_urdf(self.path)


PAYLOAD_SOURCES: Mapping[str, type[PayloadSource]] = MappingProxyType(
    {"box": BoxSource, "bar": BarSource, "cylinder": CylinderSource, "mesh": MeshSource, "urdf": UrdfSource}
)


def built(value: Any) -> Any:
    """Return the payload of a table that has a kind; anything else as it is."""
    if not (isinstance(value, Mapping) and "kind" in value):
        return value
    kind = value["kind"]
    if kind not in PAYLOAD_SOURCES:
        raise FieldError(f"is {kind!r}; it must be one of {list(PAYLOAD_SOURCES)}", "kind")
    return PAYLOAD_SOURCES[kind](**value).build()
