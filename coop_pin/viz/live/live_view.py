"""Live view: a simulation under way in a notebook or a browser.

A notebook shows it through its own kernel (``live_widget``), a browser through a local server
(``live_server``); both have the same page.
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import Any

from coop_pin.base.arrays import Array, as_positive, require_type
from coop_pin.base.errors import MissingExtraError, PortTakenError, ViewWarning, needs_extra
from coop_pin.description.cell.cell import Cell
from coop_pin.description.scenario import Scenario
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Snapshot
from coop_pin.viz.frames import FRAMES_PER_SECOND
from coop_pin.viz.live.live_scene import InitialScene, LiveScene, initial_scene
from coop_pin.viz.live.live_server import LiveServer
from coop_pin.viz.page import page_frame, page_html, page_parts

_HEIGHT = 560


class LiveView:
    """Live view of a simulation; an Observer.

    A notebook displays it as the result of a cell, through its kernel. A browser opens ``url``: a server is
    started when the address is asked for. Its methods never block, and never raise when no page is open.

    Attributes:
        server: server of the page; None as long as there is none.
        widget: the view in a notebook, a LiveWidget; None as long as there is none.
        sent: number of frames sent to a notebook or to the server process.
        dropped: number of frames that the server did not get, because the pipe to it was full.
    """

    def __init__(
        self, initial: InitialScene, *, frames_per_second: float = FRAMES_PER_SECOND, port: int = 0
    ) -> None:
        """Build the scene; with a port, serve the page.

        Args:
            initial: initial state of the cell.
            frames_per_second: largest number of frames per second of wall time.
            port: port on 127.0.0.1; 0 for any free one.

        Raises:
            OutOfRangeError: the frame rate is not greater than zero.
            PortTakenError: the chosen port is not available.
        """
        frames_per_second = as_positive("frames_per_second", frames_per_second)
        require_type("port", port, int)
        self._period, self._due = 1.0 / frames_per_second, 0.0
        self._title, self._scene, self._latest = initial.name, LiveScene(initial), initial.snapshot
        self.sent = self.dropped = 0
        self.server: LiveServer | None = None
        self.widget: Any = None
        self._is_closed = False
        if port:
            self._serve(port)

    @property
    def url(self) -> str:
        """Address of the page on this machine, which is served from now on; "" if that is impossible."""
        if self.server is None and not self._is_closed:
            self._serve(0)
        return self.server.url if self.server else ""

    @property
    def is_alive(self) -> bool:
        """Whether the server process was alive when the last frame was sent."""
        return self.server is not None and self.server.is_alive

    @property
    def payload_position(self) -> Array:
        """Position of P in the latest snapshot, m, shape (3,)."""
        return self._latest.payload_pose[:3, 3]

    def __call__(self, snapshot: Snapshot) -> None:
        """Show a snapshot, unless the previous frame is more recent than the frame period."""
        self._latest, now = snapshot, time.monotonic()
        if now >= self._due:
            self._due = max(self._due, now - self._period) + self._period
            self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot now."""
        self._latest = snapshot
        if self._is_closed or not (self.widget or self.is_alive):
            return
        frame, is_sent = self._scene.frame(snapshot), self.widget is not None
        if self.widget is not None:
            self.widget.show(frame)
        if self.server is not None and self.server.is_alive:
            is_taken = self.server.send(frame)
            is_sent |= is_taken
            self.dropped += not is_taken
        self.sent += is_sent

    def close(self) -> None:
        """End the server process, and show no more frames; an open page keeps its last image."""
        self._is_closed = True
        if self.server is not None:
            self.server.close()

    def page(self, *, channel: str = "server", still: str = "", most_push: float = 0.0) -> str:
        """Return the page with the latest snapshot.

        Args:
            channel: way by which frames come: "server", "notebook", or "none" for a still image.
            still: reason shown on a still image.
            most_push: largest force with which a person can push the payload, N; 0 if they cannot.
        """
        scene = self._scene
        data = {
            "runs": [scene.packed(self._latest)],
            "live": True,
            "channel": channel,
            "still": still,
            "duration": 0.0,
            "push": most_push and {"most": most_push, "normal": scene.push_normal},
        }
        return page_html(
            *page_parts("live", self._title, "", scales=scene.scales, curves=scene.curves, data=data)
        )

    def in_notebook(self, *, height: int = _HEIGHT, most_push: float = 0.0) -> Any:
        """Return the view as a LiveWidget, which speaks through the notebook's kernel.

        Args:
            height: pixels.
            most_push: largest force with which a person can push the payload, N; 0 if they cannot.

        Raises:
            MissingExtraError: anywidget is not installed.
        """
        if self.widget is None:
            with needs_extra("anywidget", "notebook", "for a live view in a notebook"):
                from coop_pin.viz.live.live_widget import LiveWidget
            self.widget = LiveWidget(self.page(channel="notebook", most_push=most_push), height)
        return self.widget

    def still_html(self, reason: str, *, height: int = _HEIGHT) -> str:
        """Return the latest snapshot as a frame inside another page.

        Args:
            reason: why it is a still image, shown in it.
            height: pixels.
        """
        return page_frame(height, "coop_pin", srcdoc=self.page(channel="none", still=reason))

    def _repr_mimebundle_(self, **options: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the widget, and a still image for pages without a kernel or without anywidget."""
        try:
            data, metadata = self.in_notebook()._repr_mimebundle_(**options)
        except MissingExtraError as error:
            return {"text/html": self.still_html(f"still image: {error}")}, {}
        return data | {
            "text/html": self.still_html("still image: a live view needs a running notebook")
        }, metadata

    def _serve(self, port: int) -> None:
        """Start the server; if that is impossible, warn and go on without it.

        Raises:
            PortTakenError: the chosen port is not available.
        """
        try:
            self.server = LiveServer(self.page(), port=port)
        except PortTakenError:
            raise
        except OSError as error:
            text = f"there is no 3-D view ({error}); the simulation goes on without it"
            warnings.warn(text, ViewWarning, stacklevel=3)


def open_view(
    source: Cell | Scenario | RunResult | str | Path,
    *,
    frames_per_second: float = FRAMES_PER_SECOND,
    port: int = 0,
) -> LiveView:
    """Open a live view, to be passed to ``run`` or ``simulate``.

        view = open_view("adept-paper")
        result = coop_pin.run("adept-paper", view=view)

    Let a notebook display it, or open its ``url`` in a browser. A separate process serves the page of that
    address to this machine only; it ends with the calling process.

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
