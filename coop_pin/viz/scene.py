"""Scene as plain values: drawables on nodes, a camera and scales of arrows, packed for the page's three.js.

A node is addressed by its path, for example "arms/left/joint_1"; everything on it moves with it. The page
draws a force or moment over its scale as a length l: l up to ``LINEAR_M``; from there
``LINEAR_M (1 + LOGARITHMIC log(l / LINEAR_M))``, never more than ``LONGEST_M``. The number at the head is the
value. A strut of the virtual linkage is as thick as its tension is long, in proportion.
"""

from __future__ import annotations

import base64
import functools
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from fast_simplification import simplify
from numpy.typing import ArrayLike, NDArray

from coop_pin.base.arrays import Array
from coop_pin.description.cell.cell import Cell
from coop_pin.model.shapes import Mesh, Shape
from coop_pin.results.snapshot import Snapshot

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
    drawable: Shape | Axes
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
        follows: position of the payload that the camera goes with, m, shape (3,); None where it stands still.
    """

    eye: Array
    target: Array
    field_of_view: float
    follows: Array | None = None


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
    parts = ((part.tobytes(), part.dtype.str) for part in mesh)
    return Mesh(*_thinned(*parts, faces))


@functools.lru_cache(maxsize=64)  # with the meshes of its arguments
def _thinned(
    vertices: tuple[bytes, str], triangles: tuple[bytes, str], faces: int
) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices and triangles of a thinned mesh, once: the pages of a process show the same robots."""
    corners, indices = (np.frombuffer(*part).reshape(-1, 3) for part in (vertices, triangles))
    kept, places = np.unique(corners, axis=0, return_inverse=True)
    thin = places.ravel()[indices]
    if len(thin) > faces:
        kept, thin = simplify(kept, thin, target_count=faces, agg=_AGGRESSION)
    return np.asarray(kept, dtype=float), np.asarray(thin, dtype=np.int64)


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
    camera = {
        name: None if value is None else np.asarray(value).tolist()
        for name, value in scene.camera._asdict().items()
    }
    return {"items": items, "meshes": tables, "camera": camera, "floor": scene.floor}


TYPICAL_M = 0.15
"""Approximate length of the arrow of a typical force."""

LINEAR_M, LOGARITHMIC, LONGEST_M = 0.25, 0.4, 0.5


def drawn_lengths(lengths: Array) -> Array:
    """Return the lengths at which a page draws arrows that would be so long in proportion, m."""
    ratio = np.maximum(lengths / LINEAR_M, 1e-12)
    drawn: Array = np.where(ratio <= 1.0, ratio, 1.0 + LOGARITHMIC * np.log(ratio))
    return np.minimum(LINEAR_M * drawn, LONGEST_M)


_GRAVITY = 9.81
_NEGLIGIBLE = 1e-6
"""N or N m; anything below is rounding error."""

_SHORTEST_LEVER_M = 0.05


class ArrowScales(NamedTuple):
    """Force and moment that an arrow of one metre stands for.

    Attributes:
        newtons_per_metre: N/m.
        newton_metres_per_metre: scale of moments, N m/m; None if there are no moments to draw.
    """

    newtons_per_metre: float
    newton_metres_per_metre: float | None


def recorded_scales(cell: Cell, data: xr.Dataset) -> ArrowScales:
    """Return the scales of a recorded run.

    The median internal force, or the median interaction force if there is none, is about 0.15 m long.

    Args:
        cell: the cell.
        data: dataset of the result.
    """
    medians = (
        float(np.median(np.linalg.norm(np.nan_to_num(data[name].values)[..., :3], axis=-1)))
        for name in ("internal_wrench", "interaction_wrench")
    )
    typical = next((force for force in medians if force > _NEGLIGIBLE), 1.0)
    moments = np.nan_to_num(data["interaction_wrench"].values)[..., 3:]
    return _scales(cell, typical, has_moments=bool(np.abs(moments).max(initial=0.0) > _NEGLIGIBLE))


def expected_scales(cell: Cell, initial: Snapshot) -> ArrowScales:
    """Return the scales of a run before it starts.

    The desired squeeze, or the payload's weight per arm if there is none, is about 0.15 m long.

    Args:
        cell: the cell.
        initial: initial snapshot; wrench rows that are not statically determinate are NaN.
    """
    squeeze = float(np.linalg.norm(np.nan_to_num(initial.desired_internal_wrench)[:, :3], axis=1).max())
    typical = squeeze if squeeze > _NEGLIGIBLE else cell.payload.mass * _GRAVITY / len(cell.arms)
    return _scales(cell, typical, has_moments=bool(np.isfinite(initial.interaction_wrench[:, 3:]).any()))


def _scales(cell: Cell, typical_force: float, *, has_moments: bool) -> ArrowScales:
    """Return both scales; a moment is at least as long as its force on the longest lever from P to a tip."""
    per_metre = _round_number(typical_force / TYPICAL_M, up=True)
    levers = (float(np.linalg.norm(grasp.matrix[:3, 3])) for grasp in cell.grasps.values())
    lever = max(_SHORTEST_LEVER_M, *levers)
    return ArrowScales(per_metre, _round_number(per_metre * lever, up=False) if has_moments else None)


def _round_number(value: float, *, up: bool) -> float:
    """Return a value rounded up or down to 1, 2 or 5 times a power of ten."""
    steps = np.array((0.5, 1.0, 2.0, 5.0, 10.0)) * 10.0 ** np.floor(np.log10(value))
    return float(steps[steps >= value * (1 - 1e-12)][0] if up else steps[steps <= value * (1 + 1e-12)][-1])
