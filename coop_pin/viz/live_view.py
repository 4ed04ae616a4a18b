"""The live view in a browser, through meshcat's viewer page, and how it is opened."""

from __future__ import annotations

import html
import os
import time
import warnings
from pathlib import Path
from typing import Protocol

from coop_pin.description.cell import Cell
from coop_pin.description.scenario import Scenario
from coop_pin.errors import OutOfRangeError, PortTakenError, ViewWarning
from coop_pin.figures import palette
from coop_pin.results import RunResult, Snapshot, ThrottledObserver
from coop_pin.viz.cell_scene import COLOURS, TRAIL_RADIUS_M, TRAIL_SPACING_M
from coop_pin.viz.initial_scene import InitialScene, initial_scene
from coop_pin.viz.live_scene import MOST_POINTS, LiveFrame, LiveScene
from coop_pin.viz.live_server import ViewServer
from coop_pin.viz.meshcat_commands import scene_messages
from coop_pin.viz.page import LEGEND, PUSH, SATURATED, SINGULAR, as_text, page_html
from coop_pin.viz.replay import page_frame

FRAMES_PER_SECOND = 30.0


class Viewer(ThrottledObserver, Protocol):
    """Shows a run while it is under way; an Observer. None of its methods waits for anything or raises because nobody looks.

    What there is to see comes from ``LiveScene``: its scene is drawn once, and every moment becomes a frame
    that says where the nodes of the scene are and which colours its bodies have. A viewer adds neither
    physics nor geometry.
    """

    @property
    def url(self) -> str:
        """The address to look at, on this machine; "" where it cannot be served."""

    @property
    def is_alive(self) -> bool:
        """Whether frames still go anywhere."""

    def close(self) -> None:
        """End the view and give its port back."""


class FrameRate:
    """Says which moments of a run are worth showing: so many in a second of wall time, and no more."""

    def __init__(self, frames_per_second: float) -> None:
        """Start with a frame that is due.

        Raises:
            OutOfRangeError: the rate is not greater than zero.
        """
        if not frames_per_second > 0.0:
            raise OutOfRangeError("frames_per_second", frames_per_second)
        self._period, self._due = 1.0 / frames_per_second, -1.0

    def is_due(self) -> bool:
        """Say whether it is time for a frame; if so, the next is due a period later."""
        now = time.monotonic()
        if now < self._due:
            return False
        self._due = max(self._due, now - self._period) + self._period
        return True


def live_html(title: str, scene: LiveScene, frame: LiveFrame, still: str = "") -> str:
    """Return the page: it draws the scene, shows one frame, and waits for more at the address it came from.

    Args:
        title: its heading.
        scene: what it shows.
        frame: what it shows first.
        still: of a page that waits for nothing, and needs no network: why.
    """
    live = {
        "messages": [as_text(message) for message in scene_messages(scene.scene)],
        "nodes": scene.nodes,
        "bodies": scene.bodies,
        "colours": COLOURS,
        "trail": {
            "colour": palette.ACTUAL,
            "radius": TRAIL_RADIUS_M,
            "spacing": TRAIL_SPACING_M,
            "most": MOST_POINTS,
        },
        "chart": {"actual": palette.ACTUAL, "desired": palette.DESIRED, "internal": palette.INTERNAL},
        "frame": as_text(frame.packed()),
        "still": still,
    }
    return page_html("live", title, "", (*LEGEND, PUSH, SATURATED, SINGULAR), scene.scales, live)


_PROXIES = (
    "JUPYTERHUB_SERVICE_PREFIX",
    "JUPYTERHUB_API_URL",
    "BINDER_SERVICE_HOST",
    "COLAB_RELEASE_TAG",
    "KAGGLE_KERNEL_RUN_TYPE",
)
"""Where one of these is set, the browser is on another machine, behind a proxy that does not lead to our loopback."""


class LiveView:
    """A live view in the browser, through meshcat's viewer page; a Viewer, and what a notebook shows where a cell returns it.

    Attributes:
        sent: frames handed to the server process.
        dropped: frames that found the way to it full.
    """

    def __init__(
        self, title: str, standing: InitialScene, frames_per_second: float = FRAMES_PER_SECOND, port: int = 0
    ) -> None:
        """Start to serve the page. Where that is not possible warn, and show nothing.

        Args:
            title: the page's heading.
            standing: how the cell stands before it moves.
            frames_per_second: the most that are shown, in wall time.
            port: on 127.0.0.1; 0 for any free one.

        Raises:
            OutOfRangeError: the rate is not greater than zero.
            PortTakenError: the chosen port cannot be had.
        """
        self._rate = FrameRate(frames_per_second)
        self._title, self._scene, self._last = title, LiveScene(*standing), standing.moment
        self.sent = self.dropped = 0
        self._server: ViewServer | None = None
        try:
            self._server = ViewServer(self._page(""), port)
        except PortTakenError:
            raise
        except OSError as error:
            warnings.warn(
                f"there is no 3-D view ({error}); the simulation goes on without it",
                ViewWarning,
                stacklevel=2,
            )

    @property
    def url(self) -> str:
        """The page's address on this machine; "" where it could not be served."""
        return self._server.url if self._server else ""

    @property
    def is_alive(self) -> bool:
        """Whether frames still go anywhere."""
        return self._server is not None and self._server.is_alive

    @property
    def pid(self) -> int | None:
        """The server process; None where there is none."""
        return self._server.pid if self._server else None

    def __call__(self, moment: Snapshot) -> None:
        """Show a moment, unless the last one was shown too short a time ago."""
        self._last = moment
        if self._rate.is_due():
            self.show(moment)

    def show(self, moment: Snapshot) -> None:
        """Show a moment now."""
        self._last = moment
        if self._server is None or not self._server.is_alive:
            return
        if self._server.send(self._scene.frame(moment).packed()):
            self.sent += 1
        else:
            self.dropped += 1

    def close(self) -> None:
        """End the server process; an open page keeps its last picture."""
        if self._server is not None:
            self._server.close()

    def still_html(self, why: str = "a still picture") -> str:
        """Return a page with the moment that was shown last; it needs no network and no server."""
        return self._page(why)

    def frame_html(self, height: int = 560) -> str:
        """Return what a notebook shows: a frame with the live page, or behind a proxy a still picture that says so.

        Args:
            height: pixels.
        """
        if not is_behind_proxy():
            return f'<iframe src="{html.escape(self.url)}" style="width: 100%; height: {height}px; border: 0" title="coop_pin live"></iframe>'
        why = "still picture: this notebook runs behind a proxy, through which no live view can be reached; replays work here"
        return page_frame(self.still_html(why), height, "coop_pin")

    def _repr_html_(self) -> str:
        return self.frame_html()

    def _page(self, still: str) -> str:
        return live_html(self._title, self._scene, self._scene.frame(self._last), still)


def open_view(
    what: Cell | Scenario | RunResult | str | Path,
    frames_per_second: float = FRAMES_PER_SECOND,
    port: int = 0,
) -> LiveView:
    """Open a live view: hand it to ``run`` or ``simulate``, let a notebook cell return it, or open its ``url`` in a browser.

        view = open_view("adept-paper")
        result = coop_pin.run("adept-paper", view=view)

    The page is served to this machine alone, by a process of its own, which ends with ours.

    Args:
        what: whose cell: a Cell, a Scenario, a result, a name in the catalogue or the path of a TOML file.
        frames_per_second: the most that are shown, in wall time.
        port: on 127.0.0.1, for example one that ``ssh -L`` forwards; 0 for any free one.

    Raises:
        ScenarioError: the scenario has mistakes.
        UnreachablePoseError: an arm does not reach its grasp at the start.
        PortTakenError: the chosen port cannot be had.
    """
    title, standing = initial_scene(what)
    return LiveView(title, standing, frames_per_second, port)


def is_behind_proxy() -> bool:
    """Say whether the browser of a notebook cannot reach this machine's loopback."""
    return any(os.environ.get(name) for name in _PROXIES)
