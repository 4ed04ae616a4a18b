"""Visual shapes (box, cylinder, sphere, mesh) as plain numbers, read from Pinocchio's geometry objects."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError, UrdfWarning
from coop_pin.description.cell.payload import Payload
from coop_pin.description.urdf.meshes import read_mesh


class Box(NamedTuple):
    """A box centred at its origin.

    Attributes:
        size: edges along x, y, z, m.
    """

    size: tuple[float, float, float]


class Cylinder(NamedTuple):
    """A cylinder about z, centred at its origin.

    Attributes:
        radius: m.
        length: length along z, m.
    """

    radius: float
    length: float


class Sphere(NamedTuple):
    """A sphere about its origin.

    Attributes:
        radius: m.
    """

    radius: float


class Mesh(NamedTuple):
    """A triangle mesh.

    Attributes:
        vertices: m, shape (n, 3).
        faces: three vertices of each triangle, shape (k, 3).
    """

    vertices: Array
    faces: NDArray[np.int64]


Shape: TypeAlias = Box | Cylinder | Sphere | Mesh


def bounds(shape: Shape) -> tuple[Array, Array]:
    """Return the lower and upper corner of the box around a shape, m, shape (3,) each."""
    if isinstance(shape, Mesh) and len(shape.vertices):
        return shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    return -half_extents(shape), half_extents(shape)


def half_extents(shape: Shape) -> Array:
    """Return half the edges of a box around the origin that contains the shape, m, shape (3,)."""
    match shape:
        case Box(size):
            return np.array(size) / 2.0
        case Cylinder(radius, length):
            return np.array((radius, radius, length / 2.0))
        case Sphere(radius):
            return np.full(3, radius)
        case Mesh(vertices, _):
            return np.abs(vertices).max(axis=0, initial=0.0)


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Return meshes as one."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def shape_of(geometry: Any) -> Shape | None:
    """Return the shape of a geometry object of Pinocchio; None for a kind that is not drawn."""
    reader = _READERS.get(type(geometry).__name__)
    return None if reader is None else reader(geometry)


def _box(geometry: Any) -> Box:
    x, y, z = (2.0 * float(half) for half in geometry.halfSide)
    return Box((x, y, z))


def _mesh(geometry: Any) -> Mesh:
    triangles = (geometry.tri_indices(index) for index in range(geometry.num_tris))
    faces = np.array(
        [(triangle[0], triangle[1], triangle[2]) for triangle in triangles], dtype=np.int64
    ).reshape(-1, 3)
    return Mesh(np.array(geometry.vertices(), dtype=float), faces)


_READERS: dict[str, Callable[[Any], Shape]] = {
    "Box": _box,
    "Cylinder": lambda shape: Cylinder(float(shape.radius), 2.0 * float(shape.halfLength)),
    "Sphere": lambda shape: Sphere(float(shape.radius)),
    "BVHModelOBBRSS": _mesh,
    "BVHModelOBB": _mesh,
}


def payload_shape(payload: Payload, scale: float = 1.0) -> Shape:
    """Return the shape of a payload, centred at its ``shape_pose``; a box if its mesh cannot be read.

    Args:
        payload: the description.
        scale: factor by which it is enlarged.
    """
    x, y, z = (scale * edge for edge in payload.size)
    if payload.shape == "cylinder":
        return Cylinder(x / 2.0, z)
    if payload.shape == "mesh":
        try:
            mesh = read_mesh(Path(payload.mesh_file))
        except FieldError as error:
            warnings.warn(f"the payload is drawn as a box: {error}", UrdfWarning, stacklevel=2)
        else:
            return Mesh(
                scale * payload.mesh_scale * np.array(mesh.vertices, dtype=float),
                np.array(mesh.faces, dtype=np.int64),
            )
    return Box((x, y, z))
