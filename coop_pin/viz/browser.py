"""A headless browser that draws our own pages, with the network off; it needs neither a display nor a graphics card."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from coop_pin.errors import BrowserError, BrowserNotFoundError, MissingExtraError

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
        BrowserNotFoundError: there is no browser.
        BrowserError: the browser does not start, or the page reported an error.
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
        BrowserNotFoundError: there is none, or not where the variable says.
    """
    named = os.environ.get(_VARIABLE)
    if named:
        found = shutil.which(named)
        if found is None:
            raise BrowserNotFoundError((f"{_VARIABLE}={named}",))
        return found
    if own.is_file():
        return str(own)
    installed = (shutil.which(name) for name in (*_NAMES, str(_MAC)))
    path = next((path for path in installed if path is not None), None)
    if path is None:
        raise BrowserNotFoundError((_VARIABLE, str(own), *_NAMES))
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
