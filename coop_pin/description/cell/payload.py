"""Payload: mass, inertia about the centre of mass and a shape to draw; from measures, a mesh or a URDF."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self, TypeVar, cast, get_type_hints

import numpy as np
from pydantic import ValidationInfo, create_model, field_validator, model_validator

from coop_pin.base.arrays import Array, as_positive
from coop_pin.base.errors import FieldError, UrdfError
from coop_pin.base.schema.base import Description, Positive, Vector3, Vector6
from coop_pin.base.schema.pose import Pose
from coop_pin.description.urdf import find_urdf, load_checked
from coop_pin.description.urdf.meshes import closed_mesh
from coop_pin.description.urdf.report import listed
from coop_pin.description.urdf.robot import links_of

_SMALLEST_M3, _LARGEST_M3 = 1e-18, 1e18
"""Of a mesh: a cube of a micrometre, and one of a thousand kilometres."""

Maker = TypeVar("Maker", bound=Callable[..., Any])


def _checked(make: Maker) -> Maker:
    """Validate the arguments of a class method by their annotations, all mistakes at once.

    Raises:
        ScenarioError: with the names of the arguments as paths.
    """
    signature, types = inspect.signature(make), get_type_hints(make, include_extras=True)
    fields: dict[str, Any] = {
        name: (types[name], ... if argument.default is argument.empty else argument.default)
        for name, argument in signature.parameters.items()
        if name in types
    }
    arguments = create_model(make.__name__, __base__=Description, **fields)

    @functools.wraps(make)
    def checked(cls: type[Payload], *args: Any, **kwargs: Any) -> Payload:
        positional = signature.bind_partial(cls, *args).arguments
        named = {name: value for name, value in positional.items() if name in fields}
        return make(cls, **dict(arguments(**named, **kwargs)))

    return cast(Maker, checked)


class Payload(Description):
    """The held object; its frame P has its origin at the centre of mass.

    A table with a ``kind`` ("box", "bar", "cylinder", "mesh" or "urdf") holds the arguments of the class
    method of that name: ``{ kind = "box", mass = 3.0, size = [0.3, 0.2, 0.1] }`` is ``Payload.box(3.0, (0.3,
    0.2, 0.1))``.

    Attributes:
        mass: kg.
        inertia: ixx, iyy, izz, ixy, ixz, iyz about P, kg m^2.
        size: edges of the bounding box, m; a cylinder has the axis z.
        shape: drawn by viewers and figures: "box", "cylinder" or "mesh".
        mesh_file: the mesh, if the shape is one.
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
    @_checked
    def box(cls, mass: Positive, size: Vector3) -> Self:
        """Return a homogeneous box with edges along the axes of P.

        Args:
            mass: kg.
            size: edges along x, y and z, m.
        """
        x, y, z = (edge * edge * mass / 12.0 for edge in size)
        return cls(mass=mass, inertia=(y + z, x + z, x + y, 0.0, 0.0, 0.0), size=size)

    @classmethod
    @_checked
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
    @_checked
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
    @_checked
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
    @_checked
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
        inertial = links[0].inertial
        if inertial is None or not inertial.mass:
            raise UrdfError(f"link {links[0].name!r} of {path} has no mass; a payload must have one")
        X_LI = np.eye(4) if inertial.origin is None else inertial.origin
        M = X_LI[:3, :3] @ inertial.inertia @ X_LI[:3, :3].T
        inertia = (M[0, 0], M[1, 1], M[2, 2], M[0, 1], M[0, 2], M[1, 2])
        return cls(mass=inertial.mass, inertia=inertia, **_drawn(links[0].visuals, X_LI[:3, 3]))

    def with_mass(self, mass: float) -> Self:
        """Return the same shape with another mass: the inertia is proportional to the mass."""
        scale = as_positive("mass", mass) / self.mass
        return self.replace(mass=mass, inertia=tuple(scale * entry for entry in self.inertia))


def _matrix(inertia: tuple[float, ...]) -> Array:
    ixx, iyy, izz, ixy, ixz, iyz = inertia
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


def _drawn(visuals: Sequence[Any], centre: Array) -> dict[str, Any]:
    """Return size, shape and its pose in P of the first visual of a link, if it is a box or a cylinder."""
    for visual in visuals[:1]:
        X_PS = np.eye(4) if visual.origin is None else visual.origin
        X_PS[:3, 3] -= centre
        if (box := visual.geometry.box) is not None:
            return {"size": box.size, "shape_pose": Pose.from_matrix(X_PS)}
        if (cylinder := visual.geometry.cylinder) is not None:
            size = (2.0 * cylinder.radius, 2.0 * cylinder.radius, cylinder.length)
            return {"size": size, "shape": "cylinder", "shape_pose": Pose.from_matrix(X_PS)}
    return {}
