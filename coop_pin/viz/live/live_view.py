"""Live view: a simulation shown in a browser while it runs, through meshcat's viewer page."""

from __future__ import annotations

import os
import time
import warnings
from pathlib import Path

from coop_pin.base.arrays import as_positive
from coop_pin.base.errors import PortTakenError, ViewWarning
from coop_pin.description.cell.cell import Cell
from coop_pin.description.scenario import Scenario
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Snapshot
from coop_pin.viz.frames import FRAMES_PER_SECOND
from coop_pin.viz.live.live_scene import InitialScene, LiveScene, initial_scene
from coop_pin.viz.live.live_server import LiveServer
from coop_pin.viz.page import page_frame, page_html, page_parts

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
        self._server: LiveServer | None = None
        try:
            self._server = LiveServer(self.page(), port=port)
        except PortTakenError:
            raise
        except OSError as error:
            text = f"there is no 3-D view ({error}); the simulation goes on without it"
            warnings.warn(text, ViewWarning, stacklevel=2)

    @property
    def url(self) -> str:
        """Address of the page on this machine; "" if it is not served."""
        return self._server.url if self._server else ""

    @property
    def is_alive(self) -> bool:
        """Whether the server process was alive when the last frame was sent."""
        return self._server is not None and self._server.is_alive

    @property
    def pid(self) -> int | None:
        """Process id of the server; None if there is none."""
        return self._server.pid if self._server else None

    def __call__(self, snapshot: Snapshot) -> None:
        """Show a snapshot, unless the previous frame is more recent than the frame period."""
        self._latest, now = snapshot, time.monotonic()
        if now >= self._due:
            self._due = max(self._due, now - self._period) + self._period
            self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot now."""
        self._latest = snapshot
        if self._server is None or not self._server.is_alive:
            return
        if self._server.send(self._scene.frame(snapshot)):
            self.sent += 1
        else:
            self.dropped += 1

    def close(self) -> None:
        """End the server process; an open page keeps its last image."""
        if self._server is not None:
            self._server.close()

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
