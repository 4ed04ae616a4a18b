"""The scene of a run under way: what stands on its nodes, and where the nodes are at a moment."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.description.plant import PlantOptions
from coop_pin.model.visuals import CellVisuals
from coop_pin.results import Moment
from coop_pin.spatial import pose_error
from coop_pin.viz.arrow_scales import expected_scales, largest_force
from coop_pin.viz.arrows import ArrowSeries, arrow_items, arrow_tracks
from coop_pin.viz.camera import camera_on
from coop_pin.viz.cell_scene import body_items, desired_path_items, floor_height, floor_items, payload_items
from coop_pin.viz.live_frame import LiveFrame
from coop_pin.viz.scene import Scene, Track
from coop_pin.viz.tints import body_tints
from coop_pin.viz.wrench_arrows import wrench_arrows, wrenches_at

_STILL = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0))


class LiveScene:
    """What a live view shows.

    Attributes:
        scene: everything to draw; it has no samples.
        nodes: paths of the nodes that move, in the order of a frame's rows.
        bodies: paths of the nodes whose colour can change, in the order of a frame's tints.
        scales: of the arrows.
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
        self.scales = expected_scales(cell, first)
        points = np.concatenate((self._arms.poses(first.configuration[None])[0, :, :3], desired_path, first.payload_pose[None, :3, 3]))
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

    def frame(self, moment: Moment) -> LiveFrame:
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

    def _rows(self, moment: Moment) -> Array:
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
            *(track for arrow in self._arrows(moment) for track in arrow_tracks(arrow)),
        )

    def _arrows(self, moment: Moment) -> tuple[ArrowSeries, ...]:
        return wrench_arrows(self._names, wrenches_at(moment), self.scales)


def _pose_track(path: str, pose: Array) -> Track:
    return Track(path, pose[None, :3, 3], Rotation.from_matrix(pose[None, :3, :3]).as_quat())
