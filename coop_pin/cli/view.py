"""``coop-pin view``."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import FAILED, OK
from coop_pin.description import Scenario
from coop_pin.run_scenario import run
from coop_pin.viz import open_view


@dataclasses.dataclass(frozen=True)
class View:
    """Look at a run or at a cell in 3-D, or write pictures of a run.

    Of a run, its replay opens, a file that plays offline; it is made anew from the result if it is missing.
    Of a scenario, its cell opens as it stands at the start, on an address of this machine alone, until
    Ctrl-C; with --run it moves.

    With --image or --video nothing opens: pictures are written, as the replay shows them. That takes the
    extra 'video', and a Chromium or Chrome, but no display.

    Attributes:
        what: the folder or result file of a run, or a scenario: a name that 'coop-pin list' shows, or a TOML
            file.
        open: whether to open a browser; without a screen only the address is printed.
        run: whether to let the run of a scenario go by, over and over; nothing is written.
        realtime_rate: simulated seconds in one second of wall time.
        port: of a scenario's view, for example one that 'ssh -L' forwards; any free one when omitted.
        image: PNG file to write, of a run.
        time: what the image shows, s; the end of the run when omitted.
        video: MP4 file to write, of a run.
    """

    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_SCENARIO")]
    open: bool = True
    run: bool = False
    realtime_rate: float = 1.0
    port: int = 0
    image: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    time: float | None = None
    video: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None

    def execute(self) -> int:
        """Print the address and open it; or write pictures and print their names.

        Raises:
            FieldError: a time is given, but no image to show it.
        """
        from coop_pin.description import scenario_names
        from coop_pin.errors import FieldError, FileWriteError

        path = Path(self.what)
        if self.time is not None and self.image is None:
            raise FieldError("says what an image shows; give --image FILE with it", "--time")
        if self.image is not None or self.video is not None:
            from coop_pin.cli.view import write_pictures

            try:
                write_pictures(path, self.image, self.time, self.video)
            except FileWriteError as error:
                print(f"coop-pin: {error}", file=sys.stderr)
                return FAILED
            return OK
        if self.what in scenario_names() or (path.suffix == ".toml" and path.is_file()):
            return self._live()
        replay = _replay(path).resolve()
        self._show(str(replay), replay.as_uri())
        return OK

    def _live(self) -> int:
        from coop_pin.cli.view import view_until_interrupted
        from coop_pin.description import Scenario

        realtime_rate = self.realtime_rate if self.run else None
        view_until_interrupted(Scenario.load(self.what), realtime_rate, self.port, self._show_live)
        return OK

    def _show_live(self, url: str) -> None:
        self._show(url, url)
        print(
            "coop-pin: open this address in a browser on this machine; Ctrl-C ends the view", file=sys.stderr
        )

    def _show(self, text: str, address: str) -> None:
        print(text, flush=True)
        if self.open and _has_screen():
            import webbrowser

            webbrowser.open(address)


def _replay(path: Path) -> Path:
    """Return the replay of a run's folder or result file; it is written where it is missing."""
    from coop_pin.run_folder import RunFolder

    if not path.is_file() or path.name == RunFolder.RESULT:
        return RunFolder(path.parent if path.is_file() else path).replay()
    from coop_pin.results import RunResult
    from coop_pin.viz import save_replay

    replay = path.with_suffix(".html")
    if not replay.is_file():
        save_replay(RunResult.load(path), replay)
    return replay


def _has_screen() -> bool:
    """Say whether a browser has somewhere to show; on a bare terminal one in text mode would take the terminal over."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def write_pictures(run: Path, image: Path | None, time: float | None, video: Path | None) -> None:
    """Write an image and a video of a run, whichever is asked for, and print their paths.

    Args:
        run: its folder or result file.
        image: PNG to write.
        time: what it shows, s; the end of the run when omitted.
        video: MP4 to write.

    Raises:
        FileReadError: the result is missing or damaged.
        MissingExtraError: the extra 'video' is not installed.
        BrowserError: there is no browser.
        OutOfRangeError: the run does not have that time.
    """
    from coop_pin.results import RunResult
    from coop_pin.run_folder import RunFolder
    from coop_pin.viz import save_image, save_video

    result = RunResult.load(run / RunFolder.RESULT if run.is_dir() else run)
    if image is not None:
        save_image(result, image, time)
        print(image.resolve(), flush=True)
    if video is not None:
        save_video(result, video)
        print(video.resolve())


def view_until_interrupted(
    scenario: Scenario, realtime_rate: float | None, port: int, show: Callable[[str], None]
) -> None:
    """Serve a live view of a scenario's cell until Ctrl-C, which is how it ends.

    Args:
        scenario: whose cell.
        realtime_rate: at which its run goes by, over and over; None for a cell that stands still.
        port: on 127.0.0.1; 0 for any free one.
        show: called with the view's address.

    Raises:
        UnreachablePoseError: the start is out of an arm's reach.
        PortTakenError: the chosen port cannot be had.
        CoopPinError: the run broke off.
    """
    view = open_view(scenario, port=port)
    try:
        show(view.url)
        with contextlib.suppress(KeyboardInterrupt):
            if realtime_rate is None:
                threading.Event().wait()
            else:
                while view.is_alive:
                    run(scenario, view=view, realtime_rate=realtime_rate)
    finally:
        view.close()


@dataclasses.dataclass(frozen=True)
class Report:
    """Write one page that tells a whole run: scenario, judgements, figures, limits and the 3-D replay; it opens offline.

    Attributes:
        result: the folder of a run, or its result.nc.
        out: the page; report.html beside the result when omitted.
    """

    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR_OR_FILE")]
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None

    def execute(self) -> int:
        """Write the page and print its path."""
        from coop_pin.report import save_report
        from coop_pin.results import RunResult
        from coop_pin.run_folder import RunFolder

        file = self.result / RunFolder.RESULT if self.result.is_dir() else self.result
        page = self.out or file.with_name(RunFolder.REPORT)
        save_report(RunResult.load(file), page)
        print(page.resolve())
        return OK
