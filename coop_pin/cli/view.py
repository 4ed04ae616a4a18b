"""Commands ``coop-pin view`` and ``coop-pin report``: 3-D views, images, videos and report pages."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from coop_pin import viz
from coop_pin.base.errors import FieldError
from coop_pin.cli.overrides import ANY_CODE, NO_FIELDS, Code, TypedFields, load_scenario, refuse_fields
from coop_pin.cli.terminal import Working
from coop_pin.description.catalogue import scenario_names


def view(
    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_SCENARIO")],
    against: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN")] = (),
    open: bool = True,
    run: bool = False,
    realtime_rate: float = 1.0,
    port: int = 0,
    image: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    time: float | None = None,
    video: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    code: Code = ANY_CODE,
    fields: TypedFields = NO_FIELDS,
) -> None:
    """Show a run, many runs or a cell, or write an image or a video of a run.

    For a run, this opens its replay, a file that plays offline; a missing replay is written from the result.
    Up to three more runs are shown beside it: one clock, one scale of forces, linked cameras.
    For the folder of a sweep or a comparison, this opens its heat map until Ctrl-C: a cell opens its replay,
    which is simulated when it is asked for, and two cells open theirs side by side.
    For a scenario, this opens a live view of the cell in its initial state on an address of this machine
    only, until Ctrl-C; with --run the scenario is simulated. Every field of the scenario can be changed as in
    'coop-pin run'.

    With --image or --video nothing opens: the replay is rendered into a file. That takes the extra 'video'
    and Chromium or Chrome, but no display.

    Args:
        what: folder or result file of a run, folder of a sweep or a comparison, or a scenario: a name listed
            by 'coop-pin list', or a TOML file.
        against: folders or result files of up to three more runs.
        open: open a browser; without a screen only the address is printed.
        run: simulate the scenario, over and over; nothing is written.
        realtime_rate: simulated seconds in one second of wall time.
        port: port of a scenario's view, for example one that 'ssh -L' forwards; any free port when omitted.
        image: PNG or PDF file to write, of a run.
        time: time that the image shows, s; the end of the run when omitted.
        video: MP4 file to write, of a run.
        code: code that a scenario may name.
        fields: fields of the scenario, as typed.

    Raises:
        FieldError: a time is given, but no image; a field is given for a run.
        UnreachablePoseError: the initial pose of a scenario is out of an arm's reach.
        PortTakenError: the chosen port is in use.
        FileReadError: the result is missing or damaged.
        MissingExtraError: the extra 'video' is not installed.
        BrowserError: there is no browser.
        OutOfRangeError: the run does not have the requested time.
    """
    path, paths = Path(what), (Path(what), *against)
    if time is not None and image is None:
        raise FieldError("is the time that an image shows; add --image FILE", "--time")
    pictures = image is not None or video is not None
    is_scenario = what in scenario_names() or (path.suffix == ".toml" and path.is_file())
    if is_scenario and not (pictures or against):
        from coop_pin.viz.live.live_view import open_view

        scenario = load_scenario(what, fields, code)
        if run:  # loaded before Ctrl-C ends the view: it is an ImportError where compiled code loads
            from coop_pin.running import run_scenario
        with contextlib.closing(open_view(scenario, port=port)) as live:
            _show(live.url, live.url, open)
            hint = "open this address in a browser on this machine; Ctrl-C ends the view"
            print(f"coop-pin: {hint}", file=sys.stderr)
            with contextlib.suppress(KeyboardInterrupt):  # which ends it normally
                if not run:
                    threading.Event().wait()
                while live.is_alive:
                    run_scenario.run(scenario, view=live, realtime_rate=realtime_rate)
        return
    refuse_fields(fields, what)
    if not (pictures or against) and path.is_dir() and _explored(path, port, open):
        return
    if not pictures:
        with Working("drawing the replay"):
            page = (_side_by_side(paths) if against else _replay(path)).resolve()
        _show(str(page), page.as_uri(), open)
        return
    (result, *others), names = map(result_of, paths), _names(paths)
    if image is not None:
        with Working("drawing the image"):
            viz.save_image(result, image, *others, names=names, time=time)
        print(image.resolve(), flush=True)
    if video is not None:
        with Working("drawing the video, frame by frame"):
            viz.save_video(result, video, *others, names=names)
        print(video.resolve())


def _explored(folder: Path, port: int, opens: bool) -> bool:
    """Show the heat map of a folder of many runs until Ctrl-C; return whether it is one."""
    from coop_pin.viz.explorer import Explorer, is_folder_of_runs  # slow to load

    if not is_folder_of_runs(folder):
        return False
    with Working("reading the runs"):
        explorer = Explorer(folder, port=port)
    with contextlib.closing(explorer):
        _show(explorer.url, explorer.url, opens)
        hint = "open this address in a browser on this machine; Ctrl-C ends the view"
        print(f"coop-pin: {hint}", file=sys.stderr)
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()
    return True


def _show(text: str, address: str, opens: bool) -> None:
    print(text, flush=True)
    # without a screen a text-mode browser would take over the terminal
    displays = [os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")]
    if opens and (sys.platform == "darwin" or any(displays)):
        webbrowser.open(address)


def result_of(path: Path) -> Any:
    """Return the RunResult of a run's folder or file; the class is loaded only when it is needed."""
    from coop_pin.results.run_result import RunResult

    return RunResult.load(path)


def _names(paths: Sequence[Path]) -> list[str]:
    """Return the names of runs: of their folders, or of their files in one folder."""
    folders = [path if path.is_dir() else path.parent for path in paths]
    is_different = len(set(folders)) == len(folders)
    return [
        folder.resolve().name if is_different else path.stem
        for path, folder in zip(paths, folders, strict=True)
    ]


def _side_by_side(paths: Sequence[Path]) -> Path:
    """Write the page of several runs into the first one's folder, and return its file."""
    (result, *others), names = map(result_of, paths), _names(paths)
    page = (paths[0] if paths[0].is_dir() else paths[0].parent) / f"against-{'-'.join(names[1:])}.html"
    viz.save_replay(result, page, *others, names=names)
    return page


def _replay(path: Path) -> Path:
    """Return the replay of a run's folder or result file; a missing one is written."""
    from coop_pin.cli.run_folder import RunFolder

    if not path.is_file() or path.name == RunFolder.RESULT:
        return RunFolder(path.parent if path.is_file() else path).replay()
    replay = path.with_suffix(".html")
    if not replay.is_file():
        viz.save_replay(result_of(path), replay)
    return replay


def report(
    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR_OR_FILE")],
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Write a run on one page that opens offline: scenario, metrics, figures, limits and the 3-D replay.

    Args:
        result: the folder of a run, or its result.nc.
        out: output file; report.html beside the result when omitted.
    """
    from coop_pin.cli.run_folder import RunFolder

    folder = result if result.is_dir() else result.parent
    page = out or folder / RunFolder.REPORT
    with Working("drawing the report"):
        viz.save_report(result_of(result), page)
    print(page.resolve())
