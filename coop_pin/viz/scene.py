"""Scene as plain values: drawables on named nodes and a camera, packed for the page's three.js.

A node is addressed by its path, for example "arms/left/joint_1"; everything on it moves with it.
"""

from __future__ import annotations

import base64
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from fast_simplification import simplify
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array
from coop_pin.model.shapes import Mesh, Shape

_AGGRESSION = 3
"""Of the decimation: with 7, its default, loose parts of a link vanish; with 3 bounds stay within 5 mm."""


_STEPS = 65535
"""Largest number of 16 bits."""


class Axes(NamedTuple):
    """Axes x, y, z in red, green, blue.

    Attributes:
        length: m.
    """

    length: float


Drawable: TypeAlias = Shape | Axes


class Item(NamedTuple):
    """Drawable on a node.

    Attributes:
        node: path of the node.
        drawable: drawn object, a shape or axes.
        colour: "#rrggbb".
        pose: pose of the drawable in its node, shape (4, 4).
        layer: name of the layer that shows and hides it.
        opacity: opacity from 0 to 1.
        lit: True if it is shaded and casts a shadow.
        over: True if nothing hides it.
    """

    node: str
    drawable: Drawable
    colour: str
    pose: Array
    layer: str = ""
    opacity: float = 1.0
    lit: bool = True
    over: bool = False


class Camera(NamedTuple):
    """Perspective camera; z is up.

    Attributes:
        eye: position of the camera, m, shape (3,).
        target: point in the middle of the view, m, shape (3,).
        field_of_view: vertical, degrees.
    """

    eye: Array
    target: Array
    field_of_view: float


class Scene(NamedTuple):
    """Everything that a viewer draws.

    Attributes:
        items: drawables on their nodes.
        camera: initial camera; the middle of the floor is below its target.
        floor: height of the floor, m.
    """

    items: tuple[Item, ...]
    camera: Camera
    floor: float


def thinned(mesh: Mesh, faces: int) -> Mesh:
    """Return a mesh with fewer triangles, by quadric decimation (Garland and Heckbert, 1997).

    Pages hold the meshes of all links and must stay small.

    Args:
        mesh: mesh of any size.
        faces: number of triangles to keep.
    """
    vertices, places = np.unique(mesh.vertices, axis=0, return_inverse=True)
    triangles = places.ravel()[mesh.faces]
    if len(triangles) > faces:
        vertices, triangles = simplify(vertices, triangles, target_count=faces, agg=_AGGRESSION)
    return Mesh(np.asarray(vertices, dtype=float), np.asarray(triangles, dtype=np.int64))


def base64_floats(values: ArrayLike) -> str:
    """Return numbers as little-endian float32 in base64."""
    return _base64(np.asarray(values, dtype="<f4"))


def _packed_mesh(mesh: Mesh) -> dict[str, Any]:
    """Return a mesh as 16-bit numbers: vertices as steps of its box (5 um in 0.3 m), indices if they fit."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    step = np.where(high > low, high - low, 1.0) / _STEPS
    steps = np.rint((mesh.vertices - low) / step).astype("<u2")
    indices = "<u2" if len(mesh.vertices) <= _STEPS else "<u4"
    return {
        "low": low.tolist(),
        "step": step.tolist(),
        "vertices": _base64(steps),
        "faces": _base64(mesh.faces.astype(indices)),
        "bytes": np.dtype(indices).itemsize,
    }


def _base64(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def packed_scene(scene: Scene) -> dict[str, Any]:
    """Return a scene as the page reads it; a mesh that several items share is stored once."""
    meshes: dict[int, int] = {}
    tables: list[dict[str, str]] = []
    items: list[dict[str, Any]] = []
    for item in scene.items:
        shape = item.drawable
        if isinstance(shape, Mesh) and id(shape) not in meshes:
            meshes[id(shape)] = len(tables)
            tables.append(_packed_mesh(shape))
        numbers = (
            {"mesh": meshes[id(shape)]} if isinstance(shape, Mesh) else {"size": np.ravel(shape).tolist()}
        )
        drawable = {"kind": type(shape).__name__.lower(), **numbers}
        items.append({**item._asdict(), "drawable": drawable, "pose": item.pose.T.ravel().tolist()})
    camera = {name: np.asarray(value).tolist() for name, value in scene.camera._asdict().items()}
    return {"items": items, "meshes": tables, "camera": camera, "floor": scene.floor}
