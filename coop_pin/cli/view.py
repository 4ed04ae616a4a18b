"""Commands ``coop-pin view`` and ``coop-pin report``: 3-D views, images, videos and report pages."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import sys
import threading
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from coop_pin import viz
from coop_pin.cli.exit_codes import OK
from coop_pin.cli.overrides import TypedFields, load_scenario, refuse_fields
from coop_pin.errors import FieldError


@dataclasses.dataclass(frozen=True)
class View:
    """Show a run or a cell in 3-D, or write an image or a video of a run.

    For a run, this opens its replay, a file that plays offline; a missing replay is written from the result.
    Up to three more runs are shown beside it: one clock, one scale of forces, linked cameras.
    For a scenario, this opens a live view of the cell in its initial state on an address of this machine
    only, until Ctrl-C; with --run the scenario is simulated. Every field of the scenario can be changed as in
    'coop-pin run'.

    With --image or --video nothing opens: the replay is rendered into a file. That takes the extra 'video'
    and Chromium or Chrome, but no display.

    Attributes:
        what: folder or result file of a run, or a scenario: a name listed by 'coop-pin list', or a TOML file.
        against: folders or result files of up to three more runs.
        open: open a browser; without a screen only the address is printed.
        run: simulate the scenario, over and over; nothing is written.
        realtime_rate: simulated seconds in one second of wall time.
        port: port of a scenario's view, for example one that 'ssh -L' forwards; any free port when omitted.
        image: PNG or PDF file to write, of a run.
        time: time that the image shows, s; the end of the run when omitted.
        video: MP4 file to write, of a run.
        fields: fields of the scenario, as typed.
    """

    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_SCENARIO")]
    against: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN")] = ()
    open: bool = True
    run: bool = False
    realtime_rate: float = 1.0
    port: int = 0
    image: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    time: float | None = None
    video: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    fields: TypedFields = dataclasses.field(default_factory=dict)

    def execute(self) -> int:
        """Print the address and open it, or write the files and print their paths.

        Raises:
            FieldError: a time is given, but no image; a field is given for a run.
            UnreachablePoseError: the initial pose of a scenario is out of an arm's reach.
            PortTakenError: the chosen port is in use.
            FileReadError: the result is missing or damaged.
            MissingExtraError: the extra 'video' is not installed.
            BrowserError: there is no browser.
            OutOfRangeError: the run does not have the requested time.
        """
        from coop_pin.catalogue import scenario_names

        path = Path(self.what)
        if self.time is not None and self.image is None:
            raise FieldError("is the time that an image shows; add --image FILE", "--time")
        pictures = self.image is not None or self.video is not None
        if (
            not pictures
            and not self.against
            and (self.what in scenario_names() or (path.suffix == ".toml" and path.is_file()))
        ):
            self._view_until_interrupted()
            return OK
        refuse_fields(self.fields, self.what)
        if pictures:
            self._write_images(path)
        else:
            replay = (_side_by_side(path, self.against) if self.against else _replay(path)).resolve()
            self._show(str(replay), replay.as_uri())
        return OK

    def _write_images(self, path: Path) -> None:
        paths = (path, *self.against)
        (result, *others), names = map(_result, paths), _names(paths)
        if self.image is not None:
            viz.save_image(result, self.image, *others, names=names, time=self.time)
            print(self.image.resolve(), flush=True)
        if self.video is not None:
            viz.save_video(result, self.video, *others, names=names)
            print(self.video.resolve())

    def _view_until_interrupted(self) -> None:
        """Serve a live view of the scenario's cell until Ctrl-C, which ends it normally."""
        from coop_pin.run_scenario import run

        scenario = load_scenario(self.what, self.fields)
        view = viz.open_view(scenario, port=self.port)
        try:
            self._show(view.url, view.url)
            hint = "open this address in a browser on this machine; Ctrl-C ends the view"
            print(f"coop-pin: {hint}", file=sys.stderr)
            with contextlib.suppress(KeyboardInterrupt):
                if not self.run:
                    threading.Event().wait()
                while view.is_alive:
                    run(scenario, view=view, realtime_rate=self.realtime_rate)
        finally:
            view.close()

    def _show(self, text: str, address: str) -> None:
        print(text, flush=True)
        # without a screen a text-mode browser would take over the terminal
        displays = [os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")]
        if self.open and (sys.platform == "darwin" or any(displays)):
            webbrowser.open(address)


def _result(path: Path) -> Any:
    """Return the RunResult of a run's folder or file; the class is loaded only when it is needed."""
    from coop_pin.results import RunResult
    from coop_pin.run_folder import RunFolder

    return RunResult.load(path / RunFolder.RESULT if path.is_dir() else path)


def _names(paths: Sequence[Path]) -> list[str]:
    """Return the names of runs: of their folders, or of their files beside each other."""
    folders = [path if path.is_dir() else path.parent for path in paths]
    is_different = len(set(folders)) == len(folders)
    return [
        folder.resolve().name if is_different else path.stem
        for path, folder in zip(paths, folders, strict=True)
    ]


def _side_by_side(path: Path, against: Sequence[Path]) -> Path:
    """Write the page of several runs beside the first one's result, and return its file."""
    paths = (path, *against)
    names = _names(paths)
    page = (path if path.is_dir() else path.parent) / f"against-{'-'.join(names[1:])}.html"
    (result, *others) = map(_result, paths)
    viz.save_replay(result, page, *others, names=names)
    return page


def _replay(path: Path) -> Path:
    """Return the replay of a run's folder or result file; a missing one is written."""
    from coop_pin.run_folder import RunFolder

    if not path.is_file() or path.name == RunFolder.RESULT:
        return RunFolder(path.parent if path.is_file() else path).replay()
    replay = path.with_suffix(".html")
    if not replay.is_file():
        viz.save_replay(_result(path), replay)
    return replay


@dataclasses.dataclass(frozen=True)
class Report:
    """Write a run on one page that opens offline: scenario, metrics, figures, limits and the 3-D replay.

    Attributes:
        result: the folder of a run, or its result.nc.
        out: output file; report.html beside the result when omitted.
    """

    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR_OR_FILE")]
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None

    def execute(self) -> int:
        """Write the page and print its path."""
        from coop_pin.run_folder import RunFolder

        folder = self.result if self.result.is_dir() else self.result.parent
        page = self.out or folder / RunFolder.REPORT
        viz.save_report(_result(self.result), page)
        print(page.resolve())
        return OK
