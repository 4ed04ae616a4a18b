"""3-D scene of a simulation: its initial state, and the frame of every snapshot, packed for the live page."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array, require_type
from coop_pin.chain.cell_chain import CellChain, determinate_rows
from coop_pin.description.cell import Cell
from coop_pin.description.plant import PlantOptions
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.visuals import CellVisuals
from coop_pin.results import RunResult, Snapshot
from coop_pin.spatial import pose_error, quaternions, rotate_vector6
from coop_pin.viz.arrows import (
    ArrowSeries,
    expected_scales,
    largest_force,
    snapshot_wrenches,
    wrench_arrows,
)
from coop_pin.viz.cell_scene import cell_items, cell_tracks, warning_colours
from coop_pin.viz.scene import Scene, Track

_PATH_SAMPLES = 400
_IDENTITY = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0))
"""Position, quaternion and scale of a node that does not move."""


class InitialScene(NamedTuple):
    """Initial state of a cell, for viewers that open before the run.

    Attributes:
        name: name of the scenario, or "cell".
        cell: the cell.
        plant: options of the plant; they fix the layout of q.
        snapshot: initial snapshot; wrenches are zero, and NaN in rows that are not statically determinate.
        desired_path: desired path of P, m, shape (n, 3).
    """

    name: str
    cell: Cell
    plant: PlantOptions
    snapshot: Snapshot
    desired_path: Array


def initial_scene(source: Cell | Scenario | RunResult | str | Path) -> InitialScene:
    """Return the initial state of a cell, a scenario or the scenario of a result.

    A Cell has its payload at ``payload_pose``, or else at the pose that the first arm's posture gives it.

    Args:
        source: a Cell, a Scenario, a result, a name in the catalogue or the path of a TOML file.

    Raises:
        ScenarioError: the scenario has mistakes.
        UnreachablePoseError: an arm does not reach its grasp at the start.
    """
    require_type("source", source, Cell, Scenario, RunResult, str, Path)
    if isinstance(source, Cell):
        X_WP, plant = _payload_pose(source), PlantOptions()
        snapshot = _initial_snapshot(source, plant, X_WP, X_WP, np.zeros((len(source.arms), 6)))
        return InitialScene("cell", source, plant, snapshot, X_WP[None, :3, 3])
    if isinstance(source, RunResult):
        source = source.scenario
    scenario = source if isinstance(source, Scenario) else Scenario.load(source)
    motion = scenario.motion
    path = np.array([motion.at(t).X_WP_d[:3, 3] for t in np.linspace(0.0, scenario.duration, _PATH_SAMPLES)])
    snapshot = _initial_snapshot(
        scenario.cell, scenario.plant, scenario.start.matrix, motion.at(0.0).X_WP_d, scenario.squeeze_wrenches
    )
    return InitialScene(scenario.name, scenario.cell, scenario.plant, snapshot, path)


def _payload_pose(cell: Cell) -> Array:
    """Return X_WP of a cell without a scenario."""
    if cell.payload_pose is not None:
        return cell.payload_pose.matrix
    name, arm = next(iter(cell.arms.items()))
    model = ArmModel(arm, cell.grasps[name].matrix)
    return model.payload_pose(model.configuration(np.zeros(model.nv) if arm.posture is None else arm.posture))


def _initial_snapshot(
    cell: Cell, plant: PlantOptions, X_WP: Array, X_WP_d: Array, squeeze: Array
) -> Snapshot:
    """Return the snapshot of a cell at rest; the squeeze is in payload axes, shape (m, 6)."""
    chain = CellChain(cell, plant)
    q, arms = chain.configuration(X_WP), len(cell.arms)
    joints = max(len(place.drive) for place in chain.model.arms)
    zero = np.tile(np.where(determinate_rows(chain, q), 0.0, np.nan), (arms, 1))
    return Snapshot(
        time=0.0,
        configuration=q,
        payload_pose=X_WP,
        desired_pose=X_WP_d,
        tip_position=chain.tip_positions(q),
        interaction_wrench=zero,
        internal_wrench=zero,
        desired_internal_wrench=rotate_vector6(X_WP[:3, :3], squeeze),
        external_wrench=np.zeros(6),
        torque=np.zeros((arms, joints)),
        saturated=np.zeros((arms, joints), dtype=bool),
        jacobian_condition=np.ones(arms),
    )


class LiveScene:
    """Scene of a simulation under way.

    Attributes:
        scene: drawables and camera; it has no keyframes.
        nodes: paths of the nodes that move, in the order of a frame's rows.
        bodies: paths of the nodes with warning colours, in the order of a frame's warnings.
        scales: scales of the arrows.
    """

    def __init__(self, initial: InitialScene) -> None:
        """Build the scene around the initial state of a cell."""
        cell, first = initial.cell, initial.snapshot
        self._arms, self._names = CellVisuals(cell, initial.plant.payload), tuple(cell.arms)
        self.scales = expected_scales(cell, first)
        origins = self._arms.poses(first.configuration[None])[0, :, :3]
        items, camera = cell_items(
            cell,
            self._arms.bodies,
            points=np.concatenate((origins, initial.desired_path, first.payload_pose[None, :3, 3])),
            tips=first.tip_position[None],
            desired_path=initial.desired_path,
            arrows=self._arrows(first),
        )
        self.scene = Scene(items, np.zeros(0), (), camera)
        self.nodes = tuple(track.path for track in self._tracks(first))
        self.bodies = tuple(f"arms/{body.name}" for body in self._arms.bodies)

    def frame(self, snapshot: Snapshot) -> bytes:
        """Return the frame of a snapshot, as the live page reads it.

        Four bytes with the length of a JSON text (little-endian), the text, and ten float32 for each node:
        position (m), quaternion x, y, z, w, and scale. The text has the time (s), the position error (m), the
        largest internal force of all arms, its desired value and what the controllers measure (N; null where
        that is not recorded), and the warning code of each body.
        """
        error = pose_error(snapshot.payload_pose, snapshot.desired_pose)
        names = [body.name for body in self._arms.bodies]
        warnings = warning_colours(
            names, self._arms.joints, snapshot.saturated[None], snapshot.jacobian_condition[None]
        )
        measured = snapshot.measured_internal_wrench
        header = {
            "time": snapshot.time,
            "position_error": float(np.linalg.norm(error[:3])),
            "internal": largest_force(snapshot.internal_wrench),
            "desired_internal": largest_force(snapshot.desired_internal_wrench),
            "measured_internal": None if measured is None else largest_force(measured),
            "warnings": warnings[0].tolist(),
        }
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)  # float32 arrays must start at a multiple of four bytes
        tracks = self._tracks(snapshot)
        rows = np.tile(_IDENTITY, (len(tracks), 1))
        for row, track in zip(rows, tracks, strict=True):
            parts = np.split(row, (3, 7))  # views of the row
            for part, values in zip(parts, (track.position, track.quaternion, track.scale), strict=True):
                if values is not None:
                    part[:] = values[0]
        return struct.pack("<I", len(text)) + text + rows.astype("<f4").tobytes()

    def _tracks(self, snapshot: Snapshot) -> tuple[Track, ...]:
        """Return the tracks of all moving nodes, with one sample."""
        return cell_tracks(
            self._arms.bodies,
            self._arms.poses(snapshot.configuration[None]),
            _position_and_quaternion(snapshot.payload_pose),
            _position_and_quaternion(snapshot.desired_pose),
            self._arrows(snapshot),
        )

    def _arrows(self, snapshot: Snapshot) -> tuple[ArrowSeries, ...]:
        return wrench_arrows(self._names, snapshot_wrenches(snapshot), self.scales)


def _position_and_quaternion(pose: Array) -> Array:
    """Return the position (m) and quaternion x, y, z, w of a pose, shape (1, 7)."""
    return np.concatenate((pose[:3, 3], quaternions(pose[:3, :3])))[None]
