"""Live view: a simulation under way in a browser, through meshcat's viewer page, and its scene."""

from __future__ import annotations

import os
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, as_positive, require_type
from coop_pin.base.errors import PortTakenError, ViewWarning
from coop_pin.base.spatial import rotate_vector6
from coop_pin.description.cell.cell import Cell
from coop_pin.description.plant import PlantOptions
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.visuals import CellVisuals
from coop_pin.results.quantities import GROUPS
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Snapshot
from coop_pin.viz.cell_scene import cell_scene
from coop_pin.viz.curves import cell_curves, curve_rows
from coop_pin.viz.frames import FRAMES_PER_SECOND, CellFrames, snapshot_samples
from coop_pin.viz.live.live_server import LiveServer
from coop_pin.viz.page import packed_run, page_frame, page_html, page_parts
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
    motion = scenario.payload_motion
    path = np.array([motion.at(t).X_WP_d[:3, 3] for t in np.linspace(0.0, scenario.duration, _PATH_SAMPLES)])
    snapshot = _initial_snapshot(
        scenario.cell, scenario.plant, scenario.start.matrix, motion.at(0.0).X_WP_d, scenario.squeeze_wrenches
    )
    if GROUPS["force path"](scenario):  # f_m[0] = f_d
        snapshot = snapshot._replace(measured_internal_wrench=snapshot.desired_internal_wrench)
    return InitialScene(scenario.name, scenario.cell, scenario.plant, snapshot, path)


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
    joints = max(len(arm.drive) for arm in chain.model.arms)
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
        torque=np.zeros((arms, joints)),
        saturated=np.zeros((arms, joints), dtype=bool),
        jacobian_condition=np.ones(arms),
    )


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
        cell, first = initial.cell, initial.snapshot
        self._cell = cell
        self.frames = CellFrames(cell, CellVisuals(cell, initial.plant.payload))
        self.scales = expected_scales(cell, first)
        self.curves = cell_curves(snapshot_samples(first, cell), cell)
        self._desired_path, bodies = initial.desired_path, self.frames.visuals.bodies
        self.scene = cell_scene(cell, bodies, tips=first.tip_position, path=initial.desired_path)

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


_PROXY_VARIABLES = (
    "JUPYTERHUB_SERVICE_PREFIX",
    "JUPYTERHUB_API_URL",
    "BINDER_SERVICE_HOST",
    "COLAB_RELEASE_TAG",
    "KAGGLE_KERNEL_RUN_TYPE",
)
"""If one of these is set, the browser is behind a proxy that does not reach the loopback of this machine."""


class LiveView:
    """Live view of a simulation in a browser; an Observer.

    A notebook displays it as the result of a cell. Its methods never block, and never raise when no browser
    is connected.

    Attributes:
        server: server of the page; None if there is none.
        sent: number of frames sent to the server process.
        dropped: number of frames dropped because the pipe to it was full.
    """

    def __init__(
        self, initial: InitialScene, *, frames_per_second: float = FRAMES_PER_SECOND, port: int = 0
    ) -> None:
        """Serve the page; if that is impossible, warn and go on without a view.

        Args:
            initial: initial state of the cell.
            frames_per_second: largest number of frames per second of wall time.
            port: port on 127.0.0.1; 0 for any free one.

        Raises:
            OutOfRangeError: the frame rate is not greater than zero.
            PortTakenError: the chosen port is not available.
        """
        frames_per_second = as_positive("frames_per_second", frames_per_second)
        self._period, self._due = 1.0 / frames_per_second, 0.0
        self._title, self._scene, self._latest = initial.name, LiveScene(initial), initial.snapshot
        self.sent = self.dropped = 0
        self.server: LiveServer | None = None
        try:
            self.server = LiveServer(self.page(), port=port)
        except PortTakenError:
            raise
        except OSError as error:
            text = f"there is no 3-D view ({error}); the simulation goes on without it"
            warnings.warn(text, ViewWarning, stacklevel=2)

    @property
    def url(self) -> str:
        """Address of the page on this machine; "" if it is not served."""
        return self.server.url if self.server else ""

    @property
    def is_alive(self) -> bool:
        """Whether the server process was alive when the last frame was sent."""
        return self.server is not None and self.server.is_alive

    def __call__(self, snapshot: Snapshot) -> None:
        """Show a snapshot, unless the previous frame is more recent than the frame period."""
        self._latest, now = snapshot, time.monotonic()
        if now >= self._due:
            self._due = max(self._due, now - self._period) + self._period
            self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot now."""
        self._latest = snapshot
        if self.server is None or not self.server.is_alive:
            return
        if self.server.send(self._scene.frame(snapshot)):
            self.sent += 1
        else:
            self.dropped += 1

    def close(self) -> None:
        """End the server process; an open page keeps its last image."""
        if self.server is not None:
            self.server.close()

    def page(self, *, still: str = "") -> str:
        """Return the page with the latest snapshot: it connects to the server, or is a still image.

        Args:
            still: reason shown on a still image, which needs no server; "" for a page that connects to it.
        """
        scene = self._scene
        data = {"runs": [scene.packed(self._latest)], "live": True, "still": still, "duration": 0.0}
        return page_html(
            *page_parts("live", self._title, "", scales=scene.scales, curves=scene.curves, data=data)
        )

    def frame_html(self, *, height: int = 560) -> str:
        """Return an iframe with the live page; behind a proxy, with a still image and the reason.

        Args:
            height: pixels.
        """
        if not any(os.environ.get(name) for name in _PROXY_VARIABLES):
            return page_frame(height, "coop_pin live", src=self.url)
        still = "still image: a live view cannot be reached through this notebook's proxy; replays work here"
        return page_frame(height, "coop_pin", srcdoc=self.page(still=still))

    def _repr_html_(self) -> str:
        return self.frame_html()


def open_view(
    source: Cell | Scenario | RunResult | str | Path,
    *,
    frames_per_second: float = FRAMES_PER_SECOND,
    port: int = 0,
) -> LiveView:
    """Open a live view, to be passed to ``run`` or ``simulate``.

        view = open_view("adept-paper")
        result = coop_pin.run("adept-paper", view=view)

    Open its ``url`` in a browser, or let a notebook display it. A separate process serves the page to this
    machine only; it ends with the calling process.

    Args:
        source: a Cell, a Scenario, a result, a name in the catalogue or the path of a TOML file.
        frames_per_second: largest number of frames per second of wall time.
        port: port on 127.0.0.1, for example one forwarded by ``ssh -L``; 0 for any free one.

    Raises:
        ScenarioError: the scenario has mistakes.
        UnreachablePoseError: an arm does not reach its grasp at the start.
        PortTakenError: the chosen port is not available.
    """
    return LiveView(initial_scene(source), frames_per_second=frames_per_second, port=port)
