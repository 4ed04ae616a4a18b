"""Image and video export of runs: a headless browser draws the replay page.

Neither a display nor a graphics card nor a network is needed.
"""

from __future__ import annotations

import contextlib
import itertools
import subprocess
import threading
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from coop_pin.base.arrays import Array, as_positive, typed
from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import FileWriteError, OutOfRangeError, needs_extra
from coop_pin.results.run_result import RunResult
from coop_pin.viz.browser import offline_page
from coop_pin.viz.frames import FRAMES_PER_SECOND
from coop_pin.viz.replay import replay_html

WIDTH, HEIGHT = 1400, 900
_MIN_PIXELS = 64
_QUALITY = "16"
"""Constant rate factor of H.264: 0 without loss, 18 without visible loss, 51 the worst."""

_ROUNDING = 1e-9

_HIDE_CONTROLS = "#play, #speed, #views { display: none !important; }"
_NEXT_FRAME = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"

_Returned = TypeVar("_Returned")


@typed
def save_image(
    result: RunResult,
    path: str | Path,
    *others: RunResult,
    names: Sequence[str] = (),
    time: float | None = None,
    width: int = WIDTH,
    height: int = HEIGHT,
) -> None:
    """Write an image of a run at one time: PNG, or PDF with text that can be searched, by the file's suffix.

    Args:
        result: the run.
        path: the file; ".pdf" for a paper, with all controls left out.
        *others: up to three runs beside it.
        names: headings of several runs.
        time: s; the end of the run when omitted.
        width: pixels.
        height: pixels.

    Raises:
        MissingExtraError: playwright is not installed.
        BrowserError: there is no browser; the browser drew nothing.
        OutOfRangeError: the time is not within the run; width or height is too small.
    """
    time = result.end if time is None else time
    if not 0.0 <= time <= result.end:
        raise OutOfRangeError("time", time, f"from 0 to {result.end:.6g} s, the end of the run")
    page = replay_html(result, *others, names=names, times=[time])
    take = _print if Path(path).suffix.lower() == ".pdf" else _photograph
    (image,) = run_in_thread(lambda _: list(page_images(page, [time], width, height, take)))
    write_atomically(Path(path), lambda part: part.write_bytes(image))


@typed
def save_video(
    result: RunResult,
    path: str | Path,
    *others: RunResult,
    names: Sequence[str] = (),
    frames_per_second: float = FRAMES_PER_SECOND,
    width: int = WIDTH,
    height: int = HEIGHT,
) -> None:
    """Write a video of a run at real time, as MP4 (H.264): frame k shows t = k / frames_per_second.

    The page is drawn once per frame; twenty seconds at 30 frames per second take a few minutes.

    Args:
        result: the run.
        path: the file.
        *others: up to three runs beside it.
        names: headings of several runs.
        frames_per_second: 1/s.
        width: pixels, even.
        height: pixels, even.

    Raises:
        MissingExtraError: playwright or imageio-ffmpeg is not installed.
        BrowserError: there is no browser; the browser drew nothing.
        OutOfRangeError: the frame rate is not greater than zero; the frame rate is infinite; width or height
            is too small, or odd.
        FileWriteError: the encoder did not write all frames.
    """
    times = frame_times(result.end, frames_per_second)
    for name, value in (("width", width), ("height", height)):
        if value % 2:
            raise OutOfRangeError(name, value, "an even number of pixels in a video")
    with needs_extra("imageio-ffmpeg", "video", "to write videos"):
        import imageio_ffmpeg
    page = replay_html(result, *others, names=names, times=times)

    def encode(stop: threading.Event, part: Path) -> int:
        with closing(page_images(page, times, width, height)) as images:
            frames = itertools.takewhile(lambda _: not stop.is_set(), images)
            return _encode(frames, part, frames_per_second, imageio_ffmpeg)

    def write(part: Path) -> None:
        frames = run_in_thread(lambda stop: encode(stop, part))
        if frames < len(times):
            raise FileWriteError(
                str(path), f"the encoder wrote {frames} of {len(times)} frames (its message is above)"
            )

    write_atomically(Path(path), write)


def frame_times(end: float, frames_per_second: float) -> Array:
    """Return the times of a video's frames, t = k / frames_per_second from 0 to the end of the run, s.

    Raises:
        OutOfRangeError: the frame rate is not greater than zero; the frame rate is infinite.
    """
    frames_per_second = as_positive("frames_per_second", frames_per_second)
    return np.arange(int(end * frames_per_second + _ROUNDING) + 1) / frames_per_second


def _photograph(browser_page: Any) -> Any:
    """Return what playwright's page shows as PNG."""
    return browser_page.screenshot(type="png")


def _print(browser_page: Any) -> Any:
    """Return what playwright's page shows as PDF of one sheet; only the 3-D views are pixels."""
    browser_page.add_style_tag(content="@page { margin: 0 !important; } nav { display: none !important; }")
    browser_page.emulate_media(media="screen")
    browser_page.evaluate("() => dispatchEvent(new Event('resize'))")
    browser_page.evaluate(_NEXT_FRAME)
    width, height = browser_page.evaluate("[innerWidth, document.documentElement.scrollHeight]")
    return browser_page.pdf(width=f"{width}px", height=f"{height}px", print_background=True)


def page_images(
    page: str,
    times: Iterable[float],
    width: int,
    height: int,
    take: Callable[[Any], bytes] = _photograph,
) -> Generator[bytes, None, None]:
    """Yield images of a replay page at several times; not in a thread with an event loop.

    Args:
        page: HTML of the page.
        times: times of the run, s.
        width: pixels.
        height: pixels.
        take: function that returns an image of playwright's page; PNG when omitted.

    Raises:
        OutOfRangeError: width or height is too small; and the errors of ``offline_page``.
    """
    for name, value in (("width", width), ("height", height)):
        if value < _MIN_PIXELS:
            raise OutOfRangeError(name, value, f"at least {_MIN_PIXELS}")
    with offline_page(width, height) as browser_page:
        browser_page.set_content(page)
        browser_page.wait_for_function("window.coopPin")  # several runs have pages of their own
        browser_page.add_style_tag(content=_HIDE_CONTROLS)
        for time in times:
            browser_page.evaluate("time => window.coopPin.goTo(time)", float(time))
            browser_page.evaluate(_NEXT_FRAME)
            yield take(browser_page)


def run_in_thread(job: Callable[[threading.Event], _Returned]) -> _Returned:
    """Return the result of a job that runs in a new thread.

    Playwright refuses threads with an event loop, such as the main thread of a notebook.

    Args:
        job: function of an event; it should end soon after the event is set (by Ctrl-C).
    """
    stop = threading.Event()
    with ThreadPoolExecutor(1, "coop_pin export") as pool:
        try:
            return pool.submit(job, stop).result()
        finally:
            stop.set()  # the job is still running if Ctrl-C ended the wait


def _encode(images: Iterable[bytes], part: Path, frames_per_second: float, encoder: Any) -> int:
    """Write images as a video; return the number of frames in the file.

    They are counted because an encoder that cannot write to the end (full disk) reports no error.
    """
    source = ("-f", "image2pipe", "-c:v", "png", "-framerate", str(frames_per_second), "-i", "-")
    coding = ("-c:v", "libx264", "-crf", _QUALITY, "-pix_fmt", "yuv420p", "-f", "mp4", "-y", str(part))
    command = [encoder.get_ffmpeg_exe(), "-v", "warning", *source, *coding]
    with (
        contextlib.suppress(BrokenPipeError),  # the encoder has ended
        subprocess.Popen(command, stdin=subprocess.PIPE) as process,
    ):
        assert process.stdin is not None
        process.stdin.writelines(images)
    try:
        return int(encoder.count_frames_and_secs(str(part))[0])
    except RuntimeError:  # the file cannot be read
        return 0
