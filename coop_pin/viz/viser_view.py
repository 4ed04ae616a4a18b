"""A live view through viser, an extra: the same scene as in ``live_view``, drawn by another viewer."""

from __future__ import annotations

import html
import math
from pathlib import Path
from typing import Any

from coop_pin.description.cell import Cell
from coop_pin.description.scenario import Scenario
from coop_pin.errors import MissingExtraError, PortTakenError
from coop_pin.results import Moment, RunResult
from coop_pin.viz.live_frame import LiveFrame
from coop_pin.viz.live_scene import LiveScene
from coop_pin.viz.page_parts import FORCE, LEGEND, MOMENT, PUSH, SATURATED, SINGULAR, WHOSE, arrow_notes
from coop_pin.viz.standing import Standing, standing_of
from coop_pin.viz.view_server import loopback_socket
from coop_pin.viz.viewer import FRAMES_PER_SECOND, FrameRate
from coop_pin.viz.viser_scene import ViserScene

_ARROWS = {FORCE: "&#8594;", MOMENT: "&#8608;", WHOSE: ""}


class ViserView:
    """A live view in the browser, through viser; a Viewer.

    It is served to this machine alone, by threads of this process, which end with it. Unlike ``LiveView`` its address holds no secret, and
    viser does not ask which page a browser comes from: on a machine with other users they can look too.

    Attributes:
        server: viser's server, for whatever you want to add to the scene.
    """

    def __init__(self, title: str, standing: Standing, frames_per_second: float = FRAMES_PER_SECOND, port: int = 0) -> None:
        """Start to serve.

        Args:
            title: the heading.
            standing: how the cell stands before it moves.
            frames_per_second: the most that are shown, in wall time.
            port: on 127.0.0.1; 0 for any free one.

        Raises:
            MissingExtraError: viser is not installed.
            NotPositiveError: the rate is not greater than zero.
            PortTakenError: the chosen port cannot be had.
        """
        viser = _viser()
        self._rate, self._live = FrameRate(frames_per_second), LiveScene(*standing)
        self.server = _start(viser, title, port)
        self._is_alive = True
        camera = self._live.scene.camera
        self.server.initial_camera.position, self.server.initial_camera.look_at = camera.eye, camera.target
        self.server.initial_camera.fov = math.radians(camera.field_of_view)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)  # sharing would lead through somebody else's machine
        self._clock = self.server.gui.add_html("")
        self.server.gui.add_html(_legend(self._live))
        self._scene = ViserScene(self.server.scene, self._live)
        self.show(standing.moment)

    @property
    def url(self) -> str:
        """The address on this machine."""
        return f"http://127.0.0.1:{self.server.get_port()}/"

    @property
    def is_alive(self) -> bool:
        """Whether nobody closed it."""
        return self._is_alive

    def __call__(self, moment: Moment) -> None:
        """Show a moment, unless the last one was shown too short a time ago."""
        if self._rate.is_due():
            self.show(moment)

    def show(self, moment: Moment) -> None:
        """Show a moment now."""
        if self._is_alive:
            frame = self._live.frame(moment)
            with self.server.atomic():
                self._scene.show(frame)
                self._clock.content = _clock(frame)

    def close(self) -> None:
        """End the server and give its port back; an open page keeps its last picture."""
        if self._is_alive:
            self._is_alive = False
            self.server.stop()


def open_viser(what: Cell | Scenario | RunResult | str | Path, frames_per_second: float = FRAMES_PER_SECOND, port: int = 0) -> ViserView:
    """Open a live view through viser: hand it to ``run`` or ``simulate``, and open its ``url`` in a browser.

        view = open_viser("two-pandas-box")
        result = coop_pin.run("two-pandas-box", view=view)

    Args:
        what: whose cell: a Cell, a Scenario, a result, a name in the catalogue or the path of a TOML file.
        frames_per_second: the most that are shown, in wall time.
        port: on 127.0.0.1, for example one that ``ssh -L`` forwards; 0 for any free one.

    Raises:
        MissingExtraError: viser is not installed.
        ScenarioError: the scenario has mistakes.
        UnreachablePoseError: an arm does not reach its grasp at the start.
        PortTakenError: the chosen port cannot be had.
    """
    title, standing = standing_of(what)
    return ViserView(title, standing, frames_per_second, port)


def _start(viser: Any, title: str, port: int) -> Any:
    """Return viser's server on our loopback, and on the port that was asked for: where that is taken, viser would go on to the next."""
    loopback_socket(port).close()
    server = viser.ViserServer("127.0.0.1", port, label=title, verbose=False)
    if port not in (0, server.get_port()):
        server.stop()
        raise PortTakenError(port, "somebody was quicker")
    return server


def _clock(frame: LiveFrame) -> str:
    told = (
        f"<b>t = {frame.time:.2f} s</b>",
        f"position error {1000.0 * frame.position_error:.3g} mm",
        f"internal force {frame.internal:.3g} of {frame.desired_internal:.3g} N",
    )
    return _block(told)


def _legend(live: LiveScene) -> str:
    entries = (*LEGEND, PUSH, SATURATED, SINGULAR)
    colours = (f'<span style="color: {colour}">&#9632;</span> {html.escape(text)}' for colour, _, text in entries)
    notes = (f"{_ARROWS[about]} {html.escape(note)}" for about, note in arrow_notes(live.scales).items())
    return _block((*colours, *notes))


def _block(lines: tuple[str, ...]) -> str:
    return '<div style="padding: 0.4em 1em; font-size: 0.85em">' + "<br>".join(lines) + "</div>"


def _viser() -> Any:
    try:
        import viser
    except ImportError:
        raise MissingExtraError("viser", "viser", "for this view") from None
    return viser
