"""Views and pictures that cannot be had."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from coop_pin.errors.arguments import ArgumentError
from coop_pin.errors.root import CoopPinError


class BrowserNotFoundError(CoopPinError, RuntimeError):
    """There is no browser to draw pictures with.

    Attributes:
        looked_for: where one was looked for.
    """

    def __init__(self, looked_for: Sequence[str]) -> None:
        self.looked_for = tuple(looked_for)
        super().__init__(
            f"there is no browser to draw pictures with (looked for {', '.join(looked_for)});"
            " run: playwright install chromium, or install Chromium or Chrome, or say where one is in the variable CHROMIUM"
        )


class BrowserError(CoopPinError, RuntimeError):
    """The browser that draws pictures does not start, or the page in it went wrong.

    Attributes:
        browser: its path.
        complaint: what it said.
    """

    def __init__(self, browser: str, complaint: str) -> None:
        self.browser, self.complaint = browser, complaint
        super().__init__(f"{browser} drew no picture: {complaint}; name another Chromium or Chrome in the variable CHROMIUM")


class VideoError(CoopPinError, OSError):
    """The encoder did not write a whole video: the disk is full, or it ended early.

    Attributes:
        path: of the video.
        frames: that were written.
        wanted: frames of the whole video.
    """

    def __init__(self, path: Path, frames: int, wanted: int) -> None:
        self.path, self.frames, self.wanted = path, frames, wanted
        super().__init__(f"{path} was not written: the encoder wrote {frames} of {wanted} frames and said why above; is the disk full?")


class TimeOutsideRunError(ArgumentError):
    """A picture was asked for of a time that the run does not have.

    Attributes:
        time: s.
        end: of the run, s.
    """

    def __init__(self, time: float, end: float) -> None:
        self.time, self.end = time, end
        super().__init__(f"time is {time:.6g} s; the run has pictures from 0 to {end:.6g} s")


class PictureSizeError(ArgumentError):
    """A width or height that pictures cannot have.

    Attributes:
        name: the argument.
        value: pixels.
    """

    def __init__(self, name: str, value: int, allowed: str) -> None:
        self.name, self.value = name, value
        super().__init__(f"{name} is {value} pixels; it must be {allowed}")


class PortTakenError(CoopPinError, OSError):
    """The port chosen for a view cannot be had.

    Attributes:
        port: its number.
        reason: what the system said.
    """

    def __init__(self, port: int, reason: str) -> None:
        self.port, self.reason = port, reason
        super().__init__(f"port {port} of 127.0.0.1 cannot be had ({reason}); choose another from 1024 to 65535, or 0 for any free one")
