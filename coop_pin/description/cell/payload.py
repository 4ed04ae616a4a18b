"""Payload: mass, inertia about the centre of mass and a shape to draw; from measures, a mesh or a URDF."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import ValidationInfo, field_validator, model_validator

from coop_pin.base.arrays import Array, as_positive
from coop_pin.base.errors import FieldError, UrdfError
from coop_pin.base.schema.base import Description, NotNegative, Positive, Vector3, Vector6, checked
from coop_pin.base.schema.pose import Pose
from coop_pin.description.cell.linkage import Count, Linkage, LinkBody, PayloadJoint, Rods
from coop_pin.description.urdf import find_urdf, load_checked
from coop_pin.description.urdf.meshes import closed_mesh
from coop_pin.description.urdf.report import listed
from coop_pin.description.urdf.robot import links_of

_SMALLEST_M3, _LARGEST_M3 = 1e-18, 1e18
"""Of a mesh: a cube of a micrometre, and one of a thousand kilometres."""


class Payload(Description):
    """The held object; its frame P has its origin at the centre of mass.

    A table with a ``kind`` ("box", "bar", "cylinder", "mesh", "urdf", "links", "beam" or "chain") holds the
    arguments of the class method of that name: ``{ kind = "box", mass = 3.0, size = [0.3, 0.2, 0.1] }`` is
    ``Payload.box(3.0, (0.3, 0.2, 0.1))``.

    Attributes:
        mass: kg.
        inertia: ixx, iyy, izz, ixy, ixz, iyz about P, kg m^2.
        size: edges of the bounding box, m; a cylinder has the axis z.
        shape: drawn by viewers and figures: "box", "cylinder" or "mesh".
        mesh_file: the mesh, if the shape is one.
        mesh_scale: metres of one unit of that file.
        shape_pose: pose X_PS of the shape in the payload frame.
        links: the links of a payload of several, of which mass, inertia and shape are those of the one that
            has the frame P; a payload without it is one rigid body.
    """

    mass: Positive
    inertia: Vector6
    size: Vector3 = (0.1, 0.1, 0.1)
    shape: Literal["box", "cylinder", "mesh"] = "box"
    mesh_file: str = ""
    mesh_scale: Positive = 1.0
    shape_pose: Pose = Pose()
    links: Linkage | None = None

    @model_validator(mode="before")
    @classmethod
    def _by_kind(cls, value: Any) -> Any:
        if not (isinstance(value, Mapping) and "kind" in value):
            return value
        makers: dict[str, Callable[..., Payload]] = {
            "box": cls.box,
            "bar": cls.bar,
            "cylinder": cls.cylinder,
            "mesh": cls.mesh,
            "urdf": cls.from_urdf,
            "links": cls.of_links,
            "beam": cls.beam,
            "chain": cls.chain,
        }
        kind, arguments = value["kind"], {name: entry for name, entry in value.items() if name != "kind"}
        if kind not in makers:
            raise FieldError(f"is {kind!r}; it must be one of {list(makers)}", "kind")
        return dict(makers[kind](**arguments))

    @field_validator("inertia")
    @classmethod
    def _physical(cls, inertia: tuple[float, ...], earlier: ValidationInfo) -> tuple[float, ...]:
        if "mass" not in earlier.data:  # a wrong mass has been reported, and inertias are computed from it
            return inertia
        moments = np.linalg.eigvalsh(_matrix(inertia))
        if moments[0] <= 0.0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
            raise FieldError(
                f"has principal moments {np.round(moments, 12).tolist()}; they must be positive and none may"
                " exceed the sum of the others"
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
    @checked
    def box(cls, mass: Positive, size: Vector3) -> Self:
        """Return a homogeneous box with edges along the axes of P.

        Args:
            mass: kg.
            size: edges along x, y and z, m.
        """
        x, y, z = (edge * edge * mass / 12.0 for edge in size)
        return cls(mass=mass, inertia=(y + z, x + z, x + y, 0.0, 0.0, 0.0), size=size)

    @classmethod
    @checked
    def bar(cls, mass: Positive, length: Positive, *, thickness: Positive = 0.03) -> Self:
        """Return a bar along x with the I_z = m d^2 / 12 of a thin rod (section 4.1 of the paper).

        Args:
            mass: m, kg.
            length: d, m.
            thickness: edge of its square section, m; counts in I_x only.
        """
        rod = mass * length**2 / 12.0
        inertia = (mass * thickness**2 / 6.0, rod, rod, 0.0, 0.0, 0.0)
        return cls(mass=mass, inertia=inertia, size=(length, thickness, thickness))

    @classmethod
    @checked
    def cylinder(cls, mass: Positive, radius: Positive, length: Positive) -> Self:
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
    @checked
    def mesh(
        cls,
        path: str | Path,
        *,
        mass: Positive | None = None,
        density: Positive | None = None,
        scale: Positive = 1.0,
    ) -> Self:
        """Return a homogeneous body that fills a closed surface mesh; P has the axes of the file.

        Args:
            path: an STL, OBJ, PLY or other file that trimesh reads.
            mass: kg; or
            density: kg/m^3.
            scale: metres of one unit of the file: 0.001 for one in millimetres.

        Raises:
            FieldError: the file cannot be read, or its surface does not enclose a volume; not exactly one of
                mass and density is given.
        """
        if (mass is None) == (density is None):
            raise FieldError(f"give either mass or density; they are {mass} and {density}", "mass")
        file = Path(path).absolute()
        mesh = closed_mesh(file)
        with np.errstate(all="ignore"):
            mesh.apply_scale(scale)
            volume = float(mesh.volume)
        if not _SMALLEST_M3 < volume < _LARGEST_M3:
            raise FieldError(f"gives the mesh a volume of {volume:g} m^3; it is metres of a unit", "scale")
        kilograms = mass if mass is not None else (density or 0.0) * volume
        M = kilograms / volume * np.array(mesh.moment_inertia)
        return cls(
            mass=kilograms,
            inertia=(M[0, 0], M[1, 1], M[2, 2], M[0, 1], M[0, 2], M[1, 2]),
            size=mesh.extents,
            shape="mesh",
            mesh_file=str(file),
            mesh_scale=scale,
            shape_pose=Pose(xyz=-np.array(mesh.center_mass)),
        )

    @classmethod
    @checked
    def from_urdf(
        cls,
        path: str | Path,
        *,
        package_dirs: tuple[str, ...] = (),
        xacro_args: Mapping[str, str] | None = None,
    ) -> Self:
        """Return the only link of a URDF; P has the axes of the link.

        Its first visual is drawn if it is a box or a cylinder, otherwise a box of 0.1 m.

        Args:
            path: path of a URDF or xacro file.
            package_dirs: folders that are searched first for the packages of package:// and $(find ...).
            xacro_args: values of the arguments of a xacro file.

        Raises:
            MissingExtraError: it is a xacro file and xacrodoc is not installed.
            UrdfError: no such file; the file has defects, physical ones included, or more than one link.
        """
        file = find_urdf(path, package_dirs=package_dirs, xacro_args=xacro_args or {})
        links = links_of(load_checked(file, strict=True))
        if len(links) != 1:
            names = listed(link.name for link in links)
            raise UrdfError(f"{path} has {len(links)} links, {names}; a payload must be a single link")
        body = LinkBody.of(links[0])
        if not body.mass:
            raise UrdfError(f"link {links[0].name!r} of {path} has no mass; a payload must have one")
        return cls(**body.fields())

    @classmethod
    @checked
    def of_links(
        cls,
        path: str | Path,
        link: str,
        *,
        base: Pose | None = None,
        joints: Mapping[str, PayloadJoint] | None = None,
    ) -> Self:
        """Return a payload of several links with undriven joints, such as a door or a box with a lid.

        P has its origin at the centre of mass of one of its links and the axes of that link.

        Args:
            path: path of a URDF, name of a known one, or its text.
            link: name of the link whose pose is controlled.
            base: pose of the root link in the world, of a payload that is mounted there; it is free when
                omitted.
            joints: springs, dampers, friction and stops, by the names of joints.

        Raises:
            UrdfError: no such file; the file has defects.
            FieldError: it has no such link or joint, or none that moves.
        """
        linkage = Linkage(urdf=str(path), link=link, base=base, joints=dict(joints or {}))
        return cls(links=linkage, **linkage.bodies[link].fields())

    @classmethod
    @checked
    def beam(
        cls,
        mass: Positive,
        length: Positive,
        bending_stiffness: Positive,
        *,
        links: Count = 9,
        section: tuple[Positive, Positive] = (0.1, 0.02),
        axis: Literal["y", "z"] = "y",
        damping_time: NotNegative = 2e-4,
    ) -> Self:
        """Return a beam along x as rods with springs between them, for small deflections in one plane.

        The n rods, of which the first and the last have half the length, have n - 1 hinges of stiffness
        EI/l, l = length / (n - 1). P is on the middle rod; grasps name the rods ``rod0`` to ``rod(n-1)``.

        Args:
            mass: kg.
            length: m.
            bending_stiffness: EI, N m^2.
            links: number of rods, three or more; with an odd number P is in the middle.
            section: width along y and height along z, m.
            axis: axis about which it bends.
            damping_time: damping of a hinge over its stiffness, s.
        """
        row = Rods(mass=mass, length=length, rods=links, section=section, axis=axis)
        k = bending_stiffness / row.pitch
        return cls.of_links(row.urdf(), row.middle, joints=row.joints(k, k * damping_time))

    @classmethod
    @checked
    def chain(
        cls,
        mass: Positive,
        length: Positive,
        *,
        links: Count = 17,
        thickness: Positive = 0.02,
        axis: Literal["y", "z"] = "y",
        damping: NotNegative = 1e-3,
    ) -> Self:
        """Return a chain or rope along x as rods with hinges between them, in one plane; rods as of a beam.

        Args:
            mass: kg.
            length: m.
            links: number of rods, three or more.
            thickness: edge of the square section, m.
            axis: axis of the hinges.
            damping: damping of a hinge, N m s/rad.
        """
        row = Rods(mass=mass, length=length, rods=links, section=(thickness, thickness), axis=axis)
        return cls.of_links(row.urdf(), row.middle, joints=row.joints(0.0, damping))

    @property
    def total_mass(self) -> float:
        """Mass of all links, kg."""
        return self.mass if self.links is None else sum(body.mass for body in self.links.bodies.values())

    def with_mass(self, mass: float) -> Self:
        """Return the same shape with another mass: the inertia is proportional to the mass."""
        scale = as_positive("mass", mass) / self.mass
        return self.replace(mass=mass, inertia=tuple(scale * entry for entry in self.inertia))


def _matrix(inertia: tuple[float, ...]) -> Array:
    ixx, iyy, izz, ixy, ixz, iyz = inertia
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
