"""Images and videos of runs, drawn by a headless browser from the replay page: no display, no graphics card, no network."""

from __future__ import annotations

import itertools
import os
import shutil
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from coop_pin.arrays import Array
from coop_pin.errors import BrowserError, FileWriteError, MissingExtraError, OutOfRangeError
from coop_pin.results import RunResult
from coop_pin.results.atomic_write import write_atomically
from coop_pin.viz.replay import replay_html

_VARIABLE = "CHROMIUM"
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_MAC = Path("/Applications/Google Chrome.app/Contents/MacOS/Google Chrome")
_ARGUMENTS = (
    "--use-angle=swiftshader",  # draws in software: the same picture on every machine
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
_PATIENCE_MS = 120_000
"""Drawing in software takes its time on a small machine."""

_Answer = TypeVar("_Answer")


@contextmanager
def offline_page(width: int, height: int) -> Iterator[Any]:
    """Open a playwright page without a network, and end its browser afterwards.

    Args:
        width: pixels.
        height: pixels.

    Raises:
        MissingExtraError: playwright is not installed.
        BrowserError: there is no browser; the browser does not start, or the page reported an error.
    """
    sync_api, complaints = _playwright(), []
    with sync_api.sync_playwright() as driver:
        path = find_browser(Path(driver.chromium.executable_path))
        try:
            browser = launch(driver, path)
            page = browser.new_context(viewport={"width": width, "height": height}, offline=True).new_page()
            page.set_default_timeout(_PATIENCE_MS)
            page.on("pageerror", lambda error: complaints.append(str(error)))
            yield page
            browser.close()
        except sync_api.Error as error:
            raise BrowserError(path, "; ".join((*complaints, str(error).strip().split("\n")[0]))) from error
    if complaints:
        raise BrowserError(path, "; ".join(complaints))


def launch(driver: Any, path: str) -> Any:
    """Start a browser and return playwright's handle on it.

    Args:
        driver: playwright's.
        path: of the browser.
    """
    return driver.chromium.launch(executable_path=path, args=list(_ARGUMENTS), env=_without_display())


def find_browser(own: Path) -> str:
    """Return the path of a Chromium: the one in the variable CHROMIUM, playwright's own, or one of the system's.

    Args:
        own: where playwright puts its own.

    Raises:
        BrowserError: there is none, or not where the variable says.
    """
    named = os.environ.get(_VARIABLE)
    if named:
        found = shutil.which(named)
        if found is None:
            raise BrowserError(None, "looked for " + ", ".join((f"{_VARIABLE}={named}",)))
        return found
    if own.is_file():
        return str(own)
    installed = (shutil.which(name) for name in (*_NAMES, str(_MAC)))
    path = next((path for path in installed if path is not None), None)
    if path is None:
        raise BrowserError(None, "looked for " + ", ".join((_VARIABLE, str(own), *_NAMES)))
    return path


def in_own_thread(job: Callable[[threading.Event], _Answer]) -> _Answer:
    """Return what a job returns that runs in a thread of its own: playwright refuses to work in one with an event loop, as notebooks have.

    Args:
        job: is given an event that is set when nobody waits for it any more; then it should end soon.
    """
    stop = threading.Event()
    with ThreadPoolExecutor(1, "coop_pin pictures") as pool:
        try:
            return pool.submit(job, stop).result()
        finally:
            stop.set()  # after Ctrl-C the job has not ended yet


def _without_display() -> dict[str, str | float | bool]:
    """Return our environment without its display: a browser that finds one tries to draw with it, even where it cannot be reached."""
    return {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}


def _playwright() -> Any:
    try:
        from playwright import sync_api
    except ImportError:
        raise MissingExtraError("playwright", "video", "to draw pictures") from None
    return sync_api


WIDTH, HEIGHT = 1200, 720
FRAMES_PER_SECOND = 30.0
_LEAST_PIXELS = 64
_QUALITY = 8
"""Of 10."""

_ROUNDING = 1e-9
_WITHOUT_BUTTONS = "#play, #speed, .dg { display: none !important; }"
_DRAWN = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"


def save_image(
    result: RunResult,
    path: str | Path,
    time: float | None = None,
    *,
    width: int = WIDTH,
    height: int = HEIGHT,
) -> None:
    """Write a picture of a run at a time, as PNG: what its replay shows then.

    Args:
        result: the run.
        path: the file.
        time: s; the end of the run when omitted.
        width: pixels.
        height: pixels.

    Raises:
        MissingExtraError: playwright is not installed.
        BrowserError: there is no browser; it drew nothing.
        OutOfRangeError: the run does not have that time; width or height is too small.
    """
    time = result.end if time is None else time
    if not 0.0 <= time <= result.end:
        raise OutOfRangeError("time", time, f"from 0 to {result.end:.6g} s, the end of the run")
    (picture,) = in_own_thread(lambda _: list(page_pictures(replay_html(result), [time], width, height)))
    write_atomically(Path(path), lambda part: part.write_bytes(picture))


def save_video(
    result: RunResult,
    path: str | Path,
    frames_per_second: float = FRAMES_PER_SECOND,
    *,
    width: int = WIDTH,
    height: int = HEIGHT,
) -> None:
    """Write a video of a run, as MP4 (H.264), at the pace of its clock: frame k shows t = k / frames_per_second.

    The page is drawn once for each frame; twenty seconds at 30 frames a second take a few minutes.

    Args:
        result: the run.
        path: the file.
        frames_per_second: 1/s.
        width: pixels, even.
        height: pixels, even.

    Raises:
        MissingExtraError: playwright, imageio or imageio-ffmpeg is not installed.
        BrowserError: there is no browser; it drew nothing.
        OutOfRangeError: the frame rate is not greater than zero; it is infinite; width or height is too
            small, or odd.
        FileWriteError: the encoder did not write all of it.
    """
    times = frame_times(result.end, frames_per_second)
    for name, value in (("width", width), ("height", height)):
        if value % 2:
            raise OutOfRangeError(name, value, "an even number of pixels in a video")
    packages, page = _video_packages(), replay_html(result)

    def encode(stop: threading.Event, part: Path) -> int:
        with closing(page_pictures(page, times, width, height)) as pictures:
            wanted = itertools.takewhile(lambda _: not stop.is_set(), pictures)
            return _encode(wanted, part, (width, height), frames_per_second, packages)

    def write(part: Path) -> None:
        frames = in_own_thread(lambda stop: encode(stop, part))
        if frames < len(times):
            raise FileWriteError(
                str(path), f"the encoder wrote {frames} of {len(times)} frames (its message is above)"
            )

    write_atomically(Path(path), write)


def frame_times(end: float, frames_per_second: float) -> Array:
    """Return the times that a video shows, t = k / frames_per_second from 0 up to the end, s.

    Args:
        end: of the run, s.
        frames_per_second: 1/s.

    Raises:
        OutOfRangeError: the rate is not greater than zero; it is infinite.
    """
    if not frames_per_second > 0.0:
        raise OutOfRangeError("frames_per_second", frames_per_second)
    if not np.isfinite(frames_per_second):
        raise OutOfRangeError("frames_per_second", frames_per_second, "a finite number")
    return np.arange(int(end * frames_per_second + _ROUNDING) + 1) / frames_per_second


def page_pictures(page: str, times: Iterable[float], width: int, height: int) -> Generator[bytes, None, None]:
    """Draw a replay page at one time after the other, each as PNG; not in a thread that has an event loop.

    Args:
        page: the page's HTML.
        times: of the run, s.
        width: pixels.
        height: pixels.

    Raises:
        MissingExtraError: playwright is not installed.
        BrowserError: there is no browser; it drew nothing.
        OutOfRangeError: width or height is too small.
    """
    for name, value in (("width", width), ("height", height)):
        if value < _LEAST_PIXELS:
            raise OutOfRangeError(name, value, f"at least {_LEAST_PIXELS} pixels")
    with offline_page(width, height) as browser_page:
        browser_page.set_content(page)
        browser_page.add_style_tag(content=_WITHOUT_BUTTONS)
        for time in times:
            browser_page.evaluate("time => window.coopPin.seek(time)", float(time))
            browser_page.evaluate(_DRAWN)
            yield browser_page.screenshot(type="png")


def _encode(
    pictures: Iterable[bytes],
    part: Path,
    size: tuple[int, int],
    frames_per_second: float,
    packages: tuple[Any, Any],
) -> int:
    """Write pictures as a video and return how many frames it holds.

    They are counted: an encoder that could not write to the end, because the disk is full, tells nobody.
    """
    encoder, reader = packages
    video = encoder.write_frames(
        str(part),
        size,
        fps=frames_per_second,
        quality=_QUALITY,
        macro_block_size=2,
        output_params=["-f", "mp4"],
    )
    video.send(None)  # starts it
    try:
        for picture in pictures:
            pixels = np.ascontiguousarray(reader.imread(picture, extension=".png")[..., :3])
            try:
                video.send(pixels)
            except OSError:  # it has ended
                break
    finally:
        video.close()
    try:
        frames, _ = encoder.count_frames_and_secs(str(part))
    except RuntimeError:  # what there is cannot be read
        return 0
    return int(frames)


def _video_packages() -> tuple[Any, Any]:
    """Return the encoder and what reads pictures."""
    try:
        import imageio_ffmpeg
        from imageio import v3
    except ImportError as error:
        package = "imageio-ffmpeg" if error.name == "imageio_ffmpeg" else "imageio"
        raise MissingExtraError(package, "video", "to write videos") from None
    return imageio_ffmpeg, v3
