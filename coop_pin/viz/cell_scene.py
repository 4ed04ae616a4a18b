"""The scene of a recorded run: arms, payload, where it should be, its trail, the floor, and the wrenches on the arms."""

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
from coop_pin.viz.arrows import arrow_items, arrow_tracks, recorded_scales, recorded_wrenches, wrench_arrows
from coop_pin.viz.meshes import grid_points, thinned, tube
from coop_pin.viz.scene import Camera, Item, Paint, Scene, Segments, Track, translation

_FIELD_OF_VIEW_DEG = 32.0
_AZIMUTH_DEG = 22.0
_ELEVATION_DEG = 24.0
_PLANAR_ELEVATION_DEG = 42.0
_MARGIN = 1.15


def camera_on(cell: Cell, points: Array, tips: Array, floor: float) -> Camera:
    """Return a camera that has the whole cell in view, the first arm on the left and the last on the right.

    It stands a little aside, where it sees the line between the tips more from its side. Planar cells are
    seen from higher up.

    Args:
        cell: the description.
        points: what must be in view, m, shape (n, 3); the arms' bases are added.
        tips: where the tips are, m, shape (n, m, 3).
        floor: height of the floor, m.
    """
    bases = np.array([arm.base.xyz for arm in cell.arms.values()])
    feet = bases * (1.0, 1.0, 0.0) + (0.0, 0.0, floor)
    seen = np.concatenate((points, bases, feet))
    low, high = seen.min(axis=0), seen.max(axis=0)
    target, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
    distance = _MARGIN * max(radius, 0.3) / np.sin(np.radians(_FIELD_OF_VIEW_DEG / 2.0))
    elevation = _PLANAR_ELEVATION_DEG if cell.rows == "planar" else _ELEVATION_DEG
    return Camera(
        target + distance * _direction(bases, (tips[:, -1] - tips[:, 0]).mean(axis=0), elevation),
        target,
        _FIELD_OF_VIEW_DEG,
    )


def _direction(bases: Array, line: Array, elevation_deg: float) -> Array:
    """Return the unit vector from the target to the camera; line is that between the tips."""
    across = bases[-1, :2] - bases[0, :2]
    if np.linalg.norm(across) < 1e-6:
        across = np.array((1.0, 0.0))
    front = np.arctan2(across[1], across[0]) - np.pi / 2.0
    sides = (front + np.radians(_AZIMUTH_DEG), front - np.radians(_AZIMUTH_DEG))
    heading = max(sides, key=lambda side: abs(line[0] * np.sin(side) - line[1] * np.cos(side)))
    elevation = np.radians(elevation_deg)
    return np.array(
        (np.cos(heading) * np.cos(elevation), np.sin(heading) * np.cos(elevation), np.sin(elevation))
    )


NEAR_SINGULAR = 100.0
"""From this condition number of its payload Jacobian on an arm counts as near a singular pose; healthy arms have 5 to 20."""

IS_PLAIN, IS_SINGULAR, IS_SATURATED = 0, 1, 2

COLOURS = (None, palette.rgb(palette.SINGULAR), palette.rgb(palette.SATURATED))
"""By code; None is the body's own colour."""

Codes = NDArray[np.int8]


def body_tints(
    bodies: Sequence[str], joints: Mapping[str, Sequence[str]], saturated: Mask, condition: Array
) -> Codes:
    """Return the code of every body's colour: the whole arm for a singular pose, the link that a drive moves for its saturation.

    Args:
        bodies: ``<arm>/<joint>`` or ``<arm>/base``.
        joints: of each arm, in the order of its drives; the arms in the order of the arrays.
        saturated: shape (n, m, k).
        condition: of the payload Jacobians, shape (n, m).

    Returns:
        Codes, shape (n, bodies).
    """
    arms = list(joints)
    codes = np.full((len(condition), len(bodies)), IS_PLAIN, dtype=np.int8)
    for index, body in enumerate(bodies):
        name, _, joint = body.partition("/")
        arm = arms.index(name)
        codes[condition[:, arm] >= NEAR_SINGULAR, index] = IS_SINGULAR
        if joint in joints[name]:
            codes[saturated[:, arm, joints[name].index(joint)], index] = IS_SATURATED
    return codes


def tint_changes(time: Array, codes: Codes) -> list[list[float]]:
    """Return ``[time, body, code]`` of every change, in order of time; nothing for bodies that stay plain.

    Args:
        time: s, shape (n,).
        codes: shape (n, bodies).
    """
    before = np.concatenate((np.full((1, codes.shape[1]), IS_PLAIN, dtype=np.int8), codes[:-1]))
    return [
        [float(time[sample]), int(body), int(codes[sample, body])]
        for sample, body in np.argwhere(codes != before)
    ]


FRAMES_PER_SECOND = 30.0
LINK_VERTICES = 1500
"""Most vertices of one link's mesh."""

TRAIL_SPACING_M = 0.004
TRAIL_RADIUS_M = 0.0025
_TRIAD_M = 0.05
_GHOST_SCALE = 0.97
"""The ghost is smaller than the payload, so that it hides inside while the payload is where it should be."""

_GRID_M = 0.25
_FLOOR_M = 3.0


def cell_scene(
    result: RunResult, frames_per_second: float = FRAMES_PER_SECOND, arms: CellVisuals | None = None
) -> Scene:
    """Return everything there is to see of a run.

    The keyframes are recorded samples at their recorded times: nothing is interpolated here.

    Args:
        result: the run.
        frames_per_second: of the keyframes; the recording's own rate where that is lower.
        arms: what the arms look like; read here when omitted.
    """
    scenario, kept = result.scenario, replay_samples(result.data["time"].values, frames_per_second)
    data = result.data.isel(time=kept)
    arms = CellVisuals(scenario.cell, scenario.plant.payload) if arms is None else arms
    poses = arms.poses(data["configuration"].values)
    path = data["payload_position"].values
    scales = recorded_scales(scenario.cell, result.data)
    arrows = [
        arrow
        for arrow in wrench_arrows(list(scenario.cell.arms), recorded_wrenches(data), scales)
        if arrow.vector.any()
    ]
    floor = floor_height(scenario.cell, arms.bodies)
    camera = camera_on(
        scenario.cell,
        np.concatenate((poses[..., :3].reshape(-1, 3), path)),
        data["tip_position"].values,
        floor,
    )
    items = (
        *floor_items(camera.target, floor),
        *(item for body in arms.bodies for item in body_items(body)),
        *payload_items(scenario.cell),
        *_trail_items(path, data["desired_position"].values),
        *(item for arrow in arrows for item in arrow_items(arrow)),
    )
    tracks = (
        *(
            Track(f"arms/{body.name}", pose[:, :3], pose[:, 3:])
            for body, pose in zip(arms.bodies, poses.swapaxes(0, 1), strict=True)
        ),
        Track("payload", path, data["payload_quaternion"].values),
        Track("desired", data["desired_position"].values, data["desired_quaternion"].values),
        *(track for arrow in arrows for track in arrow_tracks(arrow)),
    )
    return Scene(items, data["time"].values, tracks, camera)


def replay_samples(time: Array, frames_per_second: float) -> Array:
    """Return the indices of the recorded samples nearest to an even frame rate, the first and the last among them.

    Args:
        time: of the samples, s, increasing, shape (n,).
        frames_per_second: 1/s.
    """
    wanted = np.arange(time[0], time[-1], 1.0 / frames_per_second)
    after = np.clip(np.searchsorted(time, wanted), 1, max(len(time) - 1, 1))
    nearest = np.where(
        wanted - time[after - 1] <= time[np.minimum(after, len(time) - 1)] - wanted, after - 1, after
    )
    return np.unique(np.append(nearest, len(time) - 1))


def floor_height(cell: Cell, bodies: tuple[Body, ...]) -> float:
    """Return the lowest point of what stands still, m; the lowest base where nothing is drawn of it."""
    lowest = [arm.base.xyz[2] for arm in cell.arms.values()]
    for body in bodies:
        arm, _, part = body.name.partition("/")
        for visual in body.visuals if part == "base" else ():
            X_WV = cell.arms[arm].base.matrix @ visual.pose
            lowest.append(float(X_WV[2, 3] - np.abs(X_WV[2, :3]) @ half_extents(visual.shape)))
    return min(lowest)


def body_items(body: Body) -> tuple[Item, ...]:
    """Return the shapes of a body, on its node."""
    items: list[Item] = []
    for visual in body.visuals:
        shape = thinned(visual.shape, LINK_VERTICES) if isinstance(visual.shape, Mesh) else visual.shape
        items.append(
            Item(
                f"arms/{body.name}/{visual.name}",
                shape,
                Paint(visual.colour[:3], visual.colour[3]),
                visual.pose,
            )
        )
    return tuple(items)


def payload_items(cell: Cell) -> tuple[Item, ...]:
    """Return the payload with its grasp frames, and the ghost where it should be, on their nodes."""
    shape, ghost, X_PS = (
        payload_shape(cell.payload),
        payload_shape(cell.payload, _GHOST_SCALE),
        cell.payload.shape_pose.matrix,
    )
    grasps = (
        Item(f"payload/grasps/{name}", _triad(), Paint((1.0, 1.0, 1.0), on_top=True), grasp.matrix)
        for name, grasp in cell.grasps.items()
    )
    return (
        Item("payload/shape", shape, Paint(palette.rgb(palette.ACTUAL)), X_PS),
        Item("desired/shape", ghost, Paint(palette.rgb(palette.DESIRED), opacity=0.35), X_PS),
        *grasps,
    )


def _triad() -> Segments:
    ends = np.zeros((6, 3))
    ends[1::2] = _TRIAD_M * np.eye(3)
    return Segments(
        ends, np.repeat(np.array(((0.85, 0.1, 0.1), (0.1, 0.6, 0.1), (0.1, 0.25, 0.9))), 2, axis=0)
    )


def _trail_items(actual: Array, desired: Array) -> tuple[Item, ...]:
    mesh = tube(actual, TRAIL_RADIUS_M, TRAIL_SPACING_M)
    trail = (
        ()
        if mesh is None
        else (Item("trails/actual", mesh, Paint(palette.rgb(palette.ACTUAL), lit=False), np.eye(4)),)
    )
    return (*trail, *desired_path_items(desired))


def desired_path_items(positions: Array) -> tuple[Item, ...]:
    """Return the path that P should take, m, shape (n, 3); nothing where it does not go anywhere."""
    mesh = tube(positions, 2.0 * TRAIL_RADIUS_M, TRAIL_SPACING_M)
    paint = Paint(palette.rgb(palette.DESIRED), 0.5, lit=False)
    return () if mesh is None else (Item("trails/desired", mesh, paint, np.eye(4)),)


def floor_items(target: Array, height: float) -> tuple[Item, ...]:
    """Return the floor under a point, m, shape (3,), at a height, m."""
    x, y = np.round(target[:2] / _GRID_M) * _GRID_M
    points = grid_points(_FLOOR_M, _GRID_M)
    lines = Segments(points, np.tile(palette.rgb(palette.FLOOR_LINES), (len(points), 1)))
    slab = Box((8 * _FLOOR_M, 8 * _FLOOR_M, 0.01))
    return (
        Item("floor/slab", slab, Paint(palette.rgb(palette.FLOOR)), translation((x, y, height - 0.006))),
        Item("floor/grid", lines, Paint((1.0, 1.0, 1.0)), translation((x, y, height))),
    )
