"""Scene of a simulation under way: its initial state, and the frames of its snapshots."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.spatial import rotate_vector6
from coop_pin.description.cell.cell import Cell
from coop_pin.description.events import Partner
from coop_pin.description.plant import PlantOptions
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.joint_limits import JointLimits
from coop_pin.model.visuals import CellVisuals
from coop_pin.results.quantities import GROUPS
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Snapshot
from coop_pin.viz.camera import link_points, longest_arrows
from coop_pin.viz.cell_scene import cell_scene
from coop_pin.viz.curves import cell_curves, curve_rows
from coop_pin.viz.frames import CellFrames, snapshot_samples
from coop_pin.viz.page import packed_run
from coop_pin.viz.scene import expected_scales

_PATH_SAMPLES = 400


class InitialScene(NamedTuple):
    """Initial state of a cell, for viewers that open before the run.

    Attributes:
        name: name of the scenario, or "cell".
        cell: the cell.
        plant: options of the plant; they fix the layout of q.
        snapshot: initial snapshot; wrenches are zero, and NaN in rows that are not statically determinate.
        desired_path: desired path of P, m, shape (n, 3).
        partners: partners that hold the payload at some time.
    """

    name: str
    cell: Cell
    plant: PlantOptions
    snapshot: Snapshot
    desired_path: Array
    partners: tuple[Partner, ...] = ()


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
    motion = scenario.payload_motion
    path = np.array([motion.at(t).X_WP_d[:3, 3] for t in np.linspace(0.0, scenario.duration, _PATH_SAMPLES)])
    snapshot = _initial_snapshot(
        scenario.cell, scenario.plant, scenario.start.matrix, motion.at(0.0).X_WP_d, scenario.squeeze_wrenches
    )
    if GROUPS["force path"](scenario):  # f_m[0] = f_d
        snapshot = snapshot._replace(measured_internal_wrench=snapshot.desired_internal_wrench)
    return InitialScene(scenario.name, scenario.cell, scenario.plant, snapshot, path, scenario.partners)


def _payload_pose(cell: Cell) -> Array:
    """Return X_WP of a cell without a scenario."""
    if cell.payload_pose is not None:
        return cell.payload_pose.matrix
    first = CellArm(cell, next(iter(cell.arms)))
    return first.payload_pose(first.posture_configuration)


def _initial_snapshot(
    cell: Cell, plant: PlantOptions, X_WP: Array, X_WP_d: Array, squeeze: Array
) -> Snapshot:
    """Return the snapshot of a cell at rest; the squeeze is in payload axes, shape (m, 6)."""
    chain = CellChain(cell, plant)
    q, arms = chain.configuration(X_WP), len(cell.arms)
    torque = padded([np.zeros(len(arm.drive)) for arm in chain.model.arms])
    zero = np.tile(np.where(chain.rigid.determinate_rows(q), 0.0, np.nan), (arms, 1))
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
        torque=torque,
        saturated=np.zeros(torque.shape, dtype=bool),
        jacobian_condition=np.ones(arms),
    )


def padded(rows: Sequence[Array]) -> Array:
    """Return values of the joints of each arm as one array, NaN beyond an arm's joints, shape (m, k)."""
    table = np.full((len(rows), max(map(len, rows))), np.nan)
    for line, row in zip(table, rows, strict=True):
        line[: len(row)] = row
    return table


class LiveScene:
    """Scene of a simulation under way.

    Attributes:
        scene: drawables and camera.
        frames: layout of a frame's first part.
        curves: curves of the plots; a frame's second part is the time and their values.
        scales: scales of the arrows.
    """

    def __init__(self, initial: InitialScene) -> None:
        """Build the scene around the initial state of a cell."""
        cell, first, partners = initial.cell, initial.snapshot, initial.partners
        self._cell = cell
        self.frames = CellFrames(cell, CellVisuals(cell, initial.plant.payload), partners)
        self.scales = expected_scales(cell, first)
        limits = {"torque_limit": padded([JointLimits(arm, name).torque for name, arm in cell.arms.items()])}
        self.curves = cell_curves({**snapshot_samples(first, cell), **limits}, cell)
        self._desired_path, bodies = initial.desired_path, self.frames.visuals.bodies
        tips, (links,) = first.tip_position, self.frames.visuals.poses(first.configuration[None])
        shown = np.concatenate((link_points(bodies, links), longest_arrows(tips)))
        self.scene = cell_scene(cell, bodies, partners, tips=tips, path=initial.desired_path, shown=shown)

    @property
    def push_normal(self) -> list[float] | None:
        """Normal of the plane in which a person pushes the payload; None for that of the screen."""
        missing = set(range(3)) - set(self._cell.task_rows.indices)
        return [float(axis in missing) for axis in range(3)] if len(missing) == 1 else None

    def frame(self, snapshot: Snapshot) -> bytes:
        """Return the frame of a snapshot as the live page reads it: little-endian float32.

        First the columns of ``frames.blocks``, then the time and the value of each of ``curves``.
        """
        return b"".join(part.astype("<f4").tobytes() for part in self._rows(snapshot))

    def packed(self, snapshot: Snapshot) -> dict[str, Any]:
        """Return scene and frame of a snapshot as the page reads a run."""
        return packed_run(self.frames, self.scene, self._cell, self._desired_path, *self._rows(snapshot))

    def _rows(self, snapshot: Snapshot) -> tuple[Array, Array]:
        samples = snapshot_samples(snapshot, self._cell)
        return self.frames.rows(samples), curve_rows(self.curves, samples)
