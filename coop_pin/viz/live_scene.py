"""The scene of a run under way: what stands on its nodes, and where the nodes are at a moment."""

from __future__ import annotations

import json
import struct
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.description.plant import PlantOptions
from coop_pin.model.visuals import CellVisuals
from coop_pin.results import Snapshot
from coop_pin.spatial import pose_error
from coop_pin.viz.arrows import (
    ArrowSeries,
    arrow_items,
    arrow_tracks,
    expected_scales,
    largest_force,
    wrench_arrows,
    wrenches_at,
)
from coop_pin.viz.cell_scene import (
    TRAIL_SPACING_M,
    body_items,
    body_tints,
    camera_on,
    desired_path_items,
    floor_height,
    floor_items,
    payload_items,
)
from coop_pin.viz.scene import Scene, Track

MOST_POINTS = 1500


class Trail:
    """Points along a path, a few millimetres apart; it starts again when time does, and forgets every other point when it grows long."""

    def __init__(self) -> None:
        self._time, self._points = -np.inf, np.zeros((0, 3))

    def follow(self, time: float, position: Array) -> None:
        """Go on to a position.

        Args:
            time: s.
            position: m, shape (3,).
        """
        if time < self._time:
            self._points = np.zeros((0, 3))
        self._time = time
        if len(self._points) == 0 or np.linalg.norm(position - self._points[-1]) >= TRAIL_SPACING_M:
            self._points = np.vstack((self._points, position))
        if len(self._points) > MOST_POINTS:
            self._points = self._points[::2]

    def segments(self) -> Array:
        """Return start and end of each segment, m, shape (k, 2, 3)."""
        return np.stack((self._points[:-1], self._points[1:]), axis=1)


class LiveFrame(NamedTuple):
    """A moment of a run as values that any viewer can show.

    Attributes:
        time: s.
        position_error: distance of the payload from where it should be, m.
        orientation_error: angle, rad.
        internal: largest internal force of all arms, N.
        desired_internal: what it should be, N.
        tints: code of every body's colour, in the order of the scene's bodies; see ``tints``.
        rows: position (m), quaternion x, y, z, w and scale of every node, in the order of the scene's nodes,
            shape (nodes, 10).
    """

    time: float
    position_error: float
    orientation_error: float
    internal: float
    desired_internal: float
    tints: tuple[int, ...]
    rows: Array

    def packed(self) -> bytes:
        """Return the frame as the page reads it: the length of a JSON text, the text, and a row of float32 for each node."""
        told = self._asdict()
        del told["rows"]
        text = json.dumps(told).encode()
        text += b" " * (-len(text) % 4)  # the numbers after it start at a multiple of four
        return struct.pack("<I", len(text)) + text + self.rows.astype("<f4").tobytes()


_STILL = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0))


class LiveScene:
    """What a live view shows.

    Attributes:
        scene: everything to draw; it has no samples.
        nodes: paths of the nodes that move, in the order of a frame's rows.
        bodies: paths of the nodes whose colour can change, in the order of a frame's tints.
        scales: of the arrows.
    """

    def __init__(self, cell: Cell, plant: PlantOptions, first: Snapshot, desired_path: Array) -> None:
        """Build the scene around a first moment.

        Args:
            cell: the description.
            plant: as of the run: it fixes the layout of q.
            first: where everything stands at the start.
            desired_path: where P should go, m, shape (n, 3).
        """
        self._arms = CellVisuals(cell, plant.payload)
        self._names = tuple(cell.arms)
        self.scales = expected_scales(cell, first)
        points = np.concatenate(
            (
                self._arms.poses(first.configuration[None])[0, :, :3],
                desired_path,
                first.payload_pose[None, :3, 3],
            )
        )
        floor = floor_height(cell, self._arms.bodies)
        camera = camera_on(cell, points, first.tip_position[None], floor)
        items = (
            *floor_items(camera.target, floor),
            *(item for body in self._arms.bodies for item in body_items(body)),
            *payload_items(cell),
            *desired_path_items(desired_path),
            *(item for arrow in self._arrows(first) for item in arrow_items(arrow)),
        )
        self.scene = Scene(items, np.zeros(0), (), camera)
        self.nodes = tuple(track.path for track in self._tracks(first))
        self.bodies = tuple(f"arms/{body.name}" for body in self._arms.bodies)

    def frame(self, moment: Snapshot) -> LiveFrame:
        """Return what there is to see at a moment."""
        error = pose_error(moment.payload_pose, moment.desired_pose)
        bodies = [body.name for body in self._arms.bodies]
        tints = body_tints(bodies, self._arms.joints, moment.saturated[None], moment.jacobian_condition[None])
        return LiveFrame(
            time=moment.time,
            position_error=float(np.linalg.norm(error[:3])),
            orientation_error=float(np.linalg.norm(error[3:])),
            internal=largest_force(moment.internal_wrench),
            desired_internal=largest_force(moment.desired_internal_wrench),
            tints=tuple(tints[0].tolist()),
            rows=self._rows(moment),
        )

    def _rows(self, moment: Snapshot) -> Array:
        tracks = self._tracks(moment)
        rows = np.tile(_STILL, (len(tracks), 1))
        for row, track in zip(rows, tracks, strict=True):
            for columns, values in (
                (slice(0, 3), track.position),
                (slice(3, 7), track.quaternion),
                (slice(7, 10), track.scale),
            ):
                if values is not None:
                    row[columns] = values[0]
        return rows

    def _tracks(self, moment: Snapshot) -> tuple[Track, ...]:
        """Return the tracks of one sample: bodies, payload, ghost, arrows."""
        poses = self._arms.poses(moment.configuration[None]).swapaxes(0, 1)
        return (
            *(
                Track(f"arms/{body.name}", pose[:, :3], pose[:, 3:])
                for body, pose in zip(self._arms.bodies, poses, strict=True)
            ),
            _pose_track("payload", moment.payload_pose),
            _pose_track("desired", moment.desired_pose),
            *(track for arrow in self._arrows(moment) for track in arrow_tracks(arrow)),
        )

    def _arrows(self, moment: Snapshot) -> tuple[ArrowSeries, ...]:
        return wrench_arrows(self._names, wrenches_at(moment), self.scales)


def _pose_track(path: str, pose: Array) -> Track:
    return Track(path, pose[None, :3, 3], Rotation.from_matrix(pose[None, :3, :3]).as_quat())
