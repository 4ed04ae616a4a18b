"""Images and videos of runs, drawn by a headless browser from the replay page: no display, no graphics card, no network."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Generator, Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.arrays import Array
from coop_pin.errors import MissingExtraError, NotFiniteError, NotPositiveError, PictureSizeError, TimeOutsideRunError, VideoError
from coop_pin.results import RunResult
from coop_pin.results.atomic_write import write_atomically
from coop_pin.viz.browser import in_own_thread, offline_page
from coop_pin.viz.replay import replay_html

WIDTH, HEIGHT = 1200, 720
FRAMES_PER_SECOND = 30.0
_LEAST_PIXELS = 64
_QUALITY = 8
"""Of 10."""

_ROUNDING = 1e-9
_WITHOUT_BUTTONS = "#play, #speed, .dg { display: none !important; }"
_DRAWN = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"


def save_image(result: RunResult, path: str | Path, time: float | None = None, *, width: int = WIDTH, height: int = HEIGHT) -> None:
    """Write a picture of a run at a time, as PNG: what its replay shows then.

    Args:
        result: the run.
        path: the file.
        time: s; the end of the run when omitted.
        width: pixels.
        height: pixels.

    Raises:
        MissingExtraError: playwright is not installed.
        BrowserNotFoundError: there is no browser.
        BrowserError: it drew nothing.
        TimeOutsideRunError: the run does not have that time.
        PictureSizeError: width or height is too small.
    """
    time = result.end if time is None else time
    if not 0.0 <= time <= result.end:
        raise TimeOutsideRunError(time, result.end)
    (picture,) = in_own_thread(lambda _: list(page_pictures(replay_html(result), [time], width, height)))
    write_atomically(Path(path), lambda part: part.write_bytes(picture))


def save_video(
    result: RunResult, path: str | Path, frames_per_second: float = FRAMES_PER_SECOND, *, width: int = WIDTH, height: int = HEIGHT
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
        BrowserNotFoundError: there is no browser.
        BrowserError: it drew nothing.
        NotPositiveError: the frame rate is not greater than zero.
        NotFiniteError: it is infinite.
        PictureSizeError: width or height is too small, or odd.
        VideoError: the encoder did not write all of it.
    """
    times = frame_times(result.end, frames_per_second)
    for name, value in (("width", width), ("height", height)):
        if value % 2:
            raise PictureSizeError(name, value, "even in a video")
    packages, page = _video_packages(), replay_html(result)

    def encode(stop: threading.Event, part: Path) -> int:
        with closing(page_pictures(page, times, width, height)) as pictures:
            wanted = itertools.takewhile(lambda _: not stop.is_set(), pictures)
            return _encode(wanted, part, (width, height), frames_per_second, packages)

    def write(part: Path) -> None:
        frames = in_own_thread(lambda stop: encode(stop, part))
        if frames < len(times):
            raise VideoError(Path(path), frames, len(times))

    write_atomically(Path(path), write)


def frame_times(end: float, frames_per_second: float) -> Array:
    """Return the times that a video shows, t = k / frames_per_second from 0 up to the end, s.

    Args:
        end: of the run, s.
        frames_per_second: 1/s.

    Raises:
        NotPositiveError: the rate is not greater than zero.
        NotFiniteError: it is infinite.
    """
    if not frames_per_second > 0.0:
        raise NotPositiveError("frames_per_second", frames_per_second)
    if not np.isfinite(frames_per_second):
        raise NotFiniteError("frames_per_second", (), frames_per_second)
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
        BrowserNotFoundError: there is no browser.
        BrowserError: it drew nothing.
        PictureSizeError: width or height is too small.
    """
    for name, value in (("width", width), ("height", height)):
        if value < _LEAST_PIXELS:
            raise PictureSizeError(name, value, f"at least {_LEAST_PIXELS}")
    with offline_page(width, height) as browser_page:
        browser_page.set_content(page)
        browser_page.add_style_tag(content=_WITHOUT_BUTTONS)
        for time in times:
            browser_page.evaluate("time => window.coopPin.seek(time)", float(time))
            browser_page.evaluate(_DRAWN)
            yield browser_page.screenshot(type="png")


def _encode(pictures: Iterable[bytes], part: Path, size: tuple[int, int], frames_per_second: float, packages: tuple[Any, Any]) -> int:
    """Write pictures as a video and return how many frames it holds.

    They are counted: an encoder that could not write to the end, because the disk is full, tells nobody.
    """
    encoder, reader = packages
    video = encoder.write_frames(str(part), size, fps=frames_per_second, quality=_QUALITY, macro_block_size=2, output_params=["-f", "mp4"])
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
