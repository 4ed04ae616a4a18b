"""A homogeneous body that fills a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.errors import FieldError


class MeshBody(NamedTuple):
    """A body in the axes of its mesh.

    Attributes:
        mass: kg.
        inertia: ixx, iyy, izz, ixy, ixz, iyz about the centre of mass, kg m^2.
        centre: centre of mass in the (scaled) file's frame, m, shape (3,).
        size: edges of the box around it, m.
    """

    mass: float
    inertia: tuple[float, float, float, float, float, float]
    centre: Array
    size: tuple[float, float, float]


def mesh_body(path: Path, mass: float | None, density: float | None, scale: float) -> MeshBody:
    """Return the body that fills a mesh with one density.

    Args:
        path: the file.
        mass: kg; or
        density: kg/m^3.
        scale: metres of one unit of the file.

    Raises:
        FieldError: the file cannot be read, or its surface does not enclose a volume; not exactly one of mass
            and density is given.
    """
    if (mass is None) == (density is None):
        raise FieldError(f"give either mass or density; they are {mass} and {density}", "mass")
    mesh = _closed_mesh(path)
    mesh.apply_scale(scale)
    volume = float(mesh.volume)
    kilograms = mass if mass is not None else (density or 0.0) * volume
    M = kilograms / volume * np.array(mesh.moment_inertia)
    x, y, z = (float(edge) for edge in mesh.extents)
    return MeshBody(
        kilograms,
        (M[0, 0], M[1, 1], M[2, 2], M[0, 1], M[0, 2], M[1, 2]),
        np.array(mesh.center_mass),
        (x, y, z),
    )


def read_mesh(path: Path) -> Any:
    """Return the trimesh.Trimesh of a file, its parts joined into one.

    Raises:
        FieldError: the file cannot be read.
    """
    import trimesh  # takes a tenth of a second: only who needs it pays

    if not path.is_file():
        raise FieldError(f"there is no mesh at {path}", "mesh_file")
    try:
        mesh = trimesh.load(path, force="mesh")
    except Exception as error:  # the readers of many formats have no common base of their errors
        raise FieldError(f"{path} cannot be read as a mesh: {error}", "mesh_file") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise FieldError(f"{path} holds no triangles", "mesh_file")
    return mesh


def _closed_mesh(path: Path) -> Any:
    mesh = read_mesh(path)
    mesh.merge_vertices()
    if not mesh.is_watertight:
        raise FieldError(
            f"{path} is open: it encloses no volume. Close its holes, or give mass and inertia yourself",
            "mesh_file",
        )
    if mesh.volume < 0.0:
        mesh.invert()  # the triangles look inwards
    return mesh
