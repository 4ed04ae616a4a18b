"""The scene of a run under way: what stands on its nodes, and where the nodes are at a moment."""

from __future__ import annotations

import json
import struct

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.description.clock import PlantOptions
from coop_pin.model.visuals import CellVisuals
from coop_pin.results import Moment
from coop_pin.spatial import pose_error
from coop_pin.viz.arrows import ForceSeries, arm_forces, arrow_items, arrow_tracks, push_force, round_scale
from coop_pin.viz.camera import camera_on
from coop_pin.viz.cell_scene import body_items, desired_path_items, floor_height, floor_items, payload_items
from coop_pin.viz.scene import Scene, Track
from coop_pin.viz.tints import body_tints

_NUMBERS = 10
"""Of each node: position, quaternion, scale."""

_STILL = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0))
_GRAVITY = 9.81


class LiveScene:
    """What a live view shows.

    Attributes:
        scene: everything to draw; it has no samples.
        nodes: paths of the nodes that move, in the order of a frame's rows.
        newtons_per_metre: scale of the arrows.
    """

    def __init__(self, cell: Cell, plant: PlantOptions, first: Moment, desired_path: Array) -> None:
        """Build the scene around a first moment.

        Args:
            cell: the description.
            plant: as of the run: it fixes the layout of q.
            first: where everything stands at the start.
            desired_path: where P should go, m, shape (n, 3).
        """
        self._arms = CellVisuals(cell, plant.payload)
        self._names = tuple(cell.arms)
        self.newtons_per_metre = round_scale(_typical_force(cell, first))
        points = np.concatenate((self._arms.poses(first.configuration[None])[0, :, :3], desired_path, first.payload_pose[None, :3, 3]))
        floor = floor_height(cell, self._arms.bodies)
        camera = camera_on(cell, points, first.tip_position[None], floor)
        items = (
            *floor_items(camera.target, floor),
            *(item for body in self._arms.bodies for item in body_items(body)),
            *payload_items(cell),
            *desired_path_items(desired_path),
            *(item for series in self._forces(first) for item in arrow_items(series)),
        )
        self.scene = Scene(items, np.zeros(0), (), camera)
        self.nodes = tuple(track.path for track in self._tracks(first))
        self.bodies = tuple(f"arms/{body.name}" for body in self._arms.bodies)

    def frame(self, moment: Moment) -> bytes:
        """Return a moment as the page reads it: the length of a JSON text, the text, and a row of float32 for each node."""
        error = pose_error(moment.payload_pose, moment.desired_pose)
        tints = body_tints([b.name for b in self._arms.bodies], self._arms.joints, moment.saturated[None], moment.jacobian_condition[None])
        told = {
            "time": moment.time,
            "position_error": float(np.linalg.norm(error[:3])),
            "orientation_error": float(np.linalg.norm(error[3:])),
            "internal": _largest(moment.internal_wrench),
            "desired_internal": _largest(moment.desired_internal_wrench),
            "tints": tints[0].tolist(),
        }
        text = json.dumps(told).encode()
        text += b" " * (-len(text) % 4)  # the numbers after it start at a multiple of four
        return struct.pack("<I", len(text)) + text + self.rows(moment).astype("<f4").tobytes()

    def rows(self, moment: Moment) -> Array:
        """Return position (m), quaternion x, y, z, w and scale of every node, shape (nodes, 10)."""
        tracks = self._tracks(moment)
        rows = np.tile(_STILL, (len(tracks), 1))
        for row, track in zip(rows, tracks, strict=True):
            for columns, values in ((slice(0, 3), track.position), (slice(3, 7), track.quaternion), (slice(7, 10), track.scale)):
                if values is not None:
                    row[columns] = values[0]
        return rows

    def _tracks(self, moment: Moment) -> tuple[Track, ...]:
        """Return the tracks of one sample: bodies, payload, ghost, arrows."""
        poses = self._arms.poses(moment.configuration[None]).swapaxes(0, 1)
        return (
            *(Track(f"arms/{body.name}", pose[:, :3], pose[:, 3:]) for body, pose in zip(self._arms.bodies, poses, strict=True)),
            _pose_track("payload", moment.payload_pose),
            _pose_track("desired", moment.desired_pose),
            *(track for series in self._forces(moment) for track in arrow_tracks(series, self.newtons_per_metre)),
        )

    def _forces(self, moment: Moment) -> tuple[ForceSeries, ...]:
        on_arms = arm_forces(self._names, moment.tip_position[None], moment.interaction_wrench[None], moment.internal_wrench[None])
        return (*on_arms, push_force(moment.payload_pose[None, :3, 3], moment.external_wrench[None]))


def _pose_track(path: str, pose: Array) -> Track:
    return Track(path, pose[None, :3, 3], Rotation.from_matrix(pose[None, :3, :3]).as_quat())


def _largest(wrenches: Array) -> float:
    """Return the largest force of all arms, N; rows that rigid bodies do not determine count as zero."""
    return float(np.linalg.norm(np.nan_to_num(wrenches)[:, :3], axis=1).max())


def _typical_force(cell: Cell, first: Moment) -> float:
    """Return the force that sets the scale: the desired squeeze, or where there is none the payload's weight on one arm, N."""
    squeeze = _largest(first.desired_internal_wrench)
    return squeeze if squeeze > 1e-6 else cell.payload.mass * _GRAVITY / len(cell.arms)
