"""3-D scene of a cell: arms, payload, grasp frames, paths, floor, arrows, camera and warning colours.

``cell_scene`` is the scene of a recorded run, for replays; its parts serve ``live_scene`` too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from coop_pin.arrays import Array, Mask
from coop_pin.description.cell import Cell
from coop_pin.figures import palette
from coop_pin.model.shapes import Box, Mesh, half_extents, payload_shape
from coop_pin.model.visuals import Body, CellVisuals
from coop_pin.results import RunResult
from coop_pin.viz.arrows import (
    ArrowSeries,
    arrow_items,
    arrow_tracks,
    recorded_scales,
    recorded_wrenches,
    wrench_arrows,
)
from coop_pin.viz.scene import (
    Camera,
    Item,
    Paint,
    Scene,
    Segments,
    Track,
    decimated,
    grid_points,
    translation,
    tube,
)

FRAMES_PER_SECOND = 30.0
LINK_VERTICES = 1500
"""Largest number of vertices of one link's mesh."""

TRAIL_SPACING_M = 0.004
TRAIL_RADIUS_M = 0.0025
_TRIAD_M = 0.05
_GHOST_SCALE = 0.97
"""The ghost at the desired pose is smaller than the payload, so that it is hidden while there is no error."""

_GRID_M = 0.25
_FLOOR_M = 3.0

_FIELD_OF_VIEW_DEG = 32.0
_AZIMUTH_DEG = 22.0
_ELEVATION_DEG = 24.0
_PLANAR_ELEVATION_DEG = 42.0
_MARGIN = 1.15

NEAR_SINGULAR = 100.0
"""Condition number of the payload Jacobian from which an arm counts as near singular; 5 to 20 is usual."""

PLAIN, SINGULAR, SATURATED = 0, 1, 2
"""Codes of warning colours."""

WARNING_COLOURS = (None, palette.rgb(palette.SINGULAR), palette.rgb(palette.SATURATED))
"""Warning colours by code; None is the body's own colour."""

Codes = NDArray[np.int8]


def cell_scene(
    result: RunResult, *, frames_per_second: float = FRAMES_PER_SECOND, arms: CellVisuals | None = None
) -> Scene:
    """Return the scene of a recorded run.

    Keyframes are recorded samples at their recorded times; nothing is interpolated here.

    Args:
        result: the run.
        frames_per_second: rate of the keyframes; never above the recording's own rate.
        arms: visual shapes of the arms; read from the URDFs when omitted.
    """
    cell, kept = result.scenario.cell, replay_samples(result.data["time"].values, frames_per_second)
    data = result.data.isel(time=kept)
    arms = CellVisuals(cell, result.scenario.plant.payload) if arms is None else arms
    poses = arms.poses(data["configuration"].values)
    series = wrench_arrows(list(cell.arms), recorded_wrenches(data), recorded_scales(cell, result.data))
    arrows = [arrow for arrow in series if arrow.vector.any()]
    path, desired = data["payload_position"].values, data["desired_position"].values
    items, camera = cell_items(
        cell,
        arms.bodies,
        points=np.concatenate((poses[..., :3].reshape(-1, 3), path)),
        tips=data["tip_position"].values,
        desired_path=desired,
        arrows=arrows,
    )
    trail = tube(path, TRAIL_RADIUS_M, TRAIL_SPACING_M)
    if trail is not None:
        paint = Paint(palette.rgb(palette.ACTUAL), lit=False)
        items = (*items, Item("trails/actual", trail, paint, np.eye(4)))
    tracks = cell_tracks(
        arms.bodies,
        poses,
        np.column_stack((path, data["payload_quaternion"].values)),
        np.column_stack((desired, data["desired_quaternion"].values)),
        arrows,
    )
    return Scene(items, data["time"].values, tracks, camera)


def replay_samples(time: Array, frames_per_second: float) -> Array:
    """Return the indices of the recorded samples nearest to an even frame rate, with the first and the last.

    Args:
        time: times of the samples, s, increasing, shape (n,).
        frames_per_second: 1/s.
    """
    wanted = np.arange(time[0], time[-1], 1.0 / frames_per_second)
    after = np.clip(np.searchsorted(time, wanted), 1, max(len(time) - 1, 1))
    nearest = np.where(
        wanted - time[after - 1] <= time[np.minimum(after, len(time) - 1)] - wanted, after - 1, after
    )
    return np.unique(np.append(nearest, len(time) - 1))


def cell_items(
    cell: Cell,
    bodies: tuple[Body, ...],
    *,
    points: Array,
    tips: Array,
    desired_path: Array,
    arrows: Sequence[ArrowSeries],
) -> tuple[tuple[Item, ...], Camera]:
    """Return the drawables of a cell, and a camera that shows all of it.

    Args:
        cell: the cell.
        bodies: visual shapes of the arms.
        points: points that the camera must show, m, shape (n, 3); the bases of the arms are added.
        tips: end-effector positions, m, shape (n, m, 3).
        desired_path: desired path of P, m, shape (n, 3).
        arrows: arrows of the wrenches.
    """
    floor = _floor_height(cell, bodies)
    camera = _camera(cell, points, tips, floor)
    mesh = tube(desired_path, 2.0 * TRAIL_RADIUS_M, TRAIL_SPACING_M)
    paint = Paint(palette.rgb(palette.DESIRED), 0.5, lit=False)
    items = (
        *_floor_items(camera.target, floor),
        *(item for body in bodies for item in _body_items(body)),
        *_payload_items(cell),
        *(() if mesh is None else (Item("trails/desired", mesh, paint, np.eye(4)),)),
        *(item for arrow in arrows for item in arrow_items(arrow)),
    )
    return items, camera


def cell_tracks(
    bodies: tuple[Body, ...], poses: Array, payload: Array, desired: Array, arrows: Sequence[ArrowSeries]
) -> tuple[Track, ...]:
    """Return the tracks of all moving nodes: bodies, payload, desired pose, arrows.

    Args:
        bodies: visual shapes of the arms, b in number.
        poses: position (m) and quaternion x, y, z, w of each body, shape (n, b, 7).
        payload: the same of the payload, shape (n, 7).
        desired: the same of its desired pose, shape (n, 7).
        arrows: arrows of the wrenches.
    """
    paths = (*(f"arms/{body.name}" for body in bodies), "payload", "desired")
    moved = (*poses.swapaxes(0, 1), payload, desired)
    return (
        *(Track(path, pose[:, :3], pose[:, 3:]) for path, pose in zip(paths, moved, strict=True)),
        *(track for arrow in arrows for track in arrow_tracks(arrow)),
    )


def warning_colours(
    bodies: Sequence[str], joints: Mapping[str, Sequence[str]], saturated: Mask, condition: Array
) -> Codes:
    """Return the codes of the bodies' warning colours.

    The whole arm has a warning colour near a singularity, the driven link at a torque limit.

    Args:
        bodies: ``<arm>/<joint>`` or ``<arm>/base``.
        joints: driven joints of each arm, in the order of the arrays.
        saturated: whether a torque is at its limit, shape (n, m, k).
        condition: condition numbers of the payload Jacobians, shape (n, m).

    Returns:
        Codes, shape (n, bodies).
    """
    arms = list(joints)
    codes = np.full((len(condition), len(bodies)), PLAIN, dtype=np.int8)
    for index, body in enumerate(bodies):
        name, _, joint = body.partition("/")
        arm = arms.index(name)
        codes[condition[:, arm] >= NEAR_SINGULAR, index] = SINGULAR
        if joint in joints[name]:
            codes[saturated[:, arm, joints[name].index(joint)], index] = SATURATED
    return codes


def _camera(cell: Cell, points: Array, tips: Array, floor: float) -> Camera:
    """Return a camera that shows the whole cell, the first arm on the left and the last on the right.

    Its azimuth is a little off the front, to the side from which the line between the tips appears longer.
    Planar cells are seen from higher up.
    """
    bases = np.array([arm.base.xyz for arm in cell.arms.values()])
    feet = bases * (1.0, 1.0, 0.0) + (0.0, 0.0, floor)
    seen = np.concatenate((points, bases, feet))
    low, high = seen.min(axis=0), seen.max(axis=0)
    target, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
    distance = _MARGIN * max(radius, 0.3) / np.sin(np.radians(_FIELD_OF_VIEW_DEG / 2.0))
    across, line = bases[-1, :2] - bases[0, :2], (tips[:, -1] - tips[:, 0]).mean(axis=0)
    if np.linalg.norm(across) < 1e-6:
        across = np.array((1.0, 0.0))
    front = np.arctan2(across[1], across[0]) - np.pi / 2.0
    sides = (front + np.radians(_AZIMUTH_DEG), front - np.radians(_AZIMUTH_DEG))
    azimuth = max(sides, key=lambda side: abs(line[0] * np.sin(side) - line[1] * np.cos(side)))
    elevation = np.radians(_PLANAR_ELEVATION_DEG if cell.rows == "planar" else _ELEVATION_DEG)
    level = np.cos(elevation)
    outwards = np.array((np.cos(azimuth) * level, np.sin(azimuth) * level, np.sin(elevation)))
    return Camera(target + distance * outwards, target, _FIELD_OF_VIEW_DEG)


def _floor_height(cell: Cell, bodies: tuple[Body, ...]) -> float:
    """Return the height of the lowest fixed visual, m; of the lowest base if no fixed part has a visual."""
    lowest = [arm.base.xyz[2] for arm in cell.arms.values()]
    for body in bodies:
        arm, _, part = body.name.partition("/")
        for visual in body.visuals if part == "base" else ():
            X_WV = cell.arms[arm].base.matrix @ visual.pose
            lowest.append(float(X_WV[2, 3] - np.abs(X_WV[2, :3]) @ half_extents(visual.shape)))
    return min(lowest)


def _floor_items(target: Array, height: float) -> tuple[Item, ...]:
    """Return the floor with its grid under a point, m, shape (3,), at a height, m."""
    x, y = np.round(target[:2] / _GRID_M) * _GRID_M
    points = grid_points(_FLOOR_M, _GRID_M)
    lines = Segments(points, np.tile(palette.rgb(palette.FLOOR_LINES), (len(points), 1)))
    slab = Box((8 * _FLOOR_M, 8 * _FLOOR_M, 0.01))
    return (
        Item("floor/slab", slab, Paint(palette.rgb(palette.FLOOR)), translation((x, y, height - 0.006))),
        Item("floor/grid", lines, Paint((1.0, 1.0, 1.0)), translation((x, y, height))),
    )


def _body_items(body: Body) -> tuple[Item, ...]:
    """Return the visual shapes of a body, on its node."""
    items: list[Item] = []
    for visual in body.visuals:
        shape = decimated(visual.shape, LINK_VERTICES) if isinstance(visual.shape, Mesh) else visual.shape
        paint = Paint(visual.colour[:3], visual.colour[3])
        items.append(Item(f"arms/{body.name}/{visual.name}", shape, paint, visual.pose))
    return tuple(items)


def _payload_items(cell: Cell) -> tuple[Item, ...]:
    """Return the payload with its grasp frames, and the ghost at the desired pose."""
    shape, ghost = payload_shape(cell.payload), payload_shape(cell.payload, _GHOST_SCALE)
    X_PS, ends = cell.payload.shape_pose.matrix, np.zeros((6, 3))
    ends[1::2] = _TRIAD_M * np.eye(3)
    axes = np.array(((0.85, 0.1, 0.1), (0.1, 0.6, 0.1), (0.1, 0.25, 0.9)))
    triad, white = Segments(ends, np.repeat(axes, 2, axis=0)), Paint((1.0, 1.0, 1.0), on_top=True)
    return (
        Item("payload/shape", shape, Paint(palette.rgb(palette.ACTUAL)), X_PS),
        Item("desired/shape", ghost, Paint(palette.rgb(palette.DESIRED), opacity=0.35), X_PS),
        *(Item(f"payload/grasps/{name}", triad, white, X_PG.matrix) for name, X_PG in cell.grasps.items()),
    )
