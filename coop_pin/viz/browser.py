"""Headless browser of the system or of playwright, started without a display and closed again."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from coop_pin.base.errors import BrowserError, needs_extra

_VARIABLE = "CHROMIUM"
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_MAC = "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome"
_ARGUMENTS = (
    "--use-angle=swiftshader",  # renders in software: the same image on every machine
    "--enable-unsafe-swiftshader",
    "--disable-gpu-rasterization",  # text and plots are drawn faster without SwiftShader
    "--disable-accelerated-2d-canvas",
    "--disable-partial-raster",  # edges drawn anew in part had other shades, in one image of five
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
_TIMEOUT_MS = 120_000
"""Rendering in software is slow on small machines."""


@contextmanager
def offline_page(width: int, height: int) -> Iterator[Any]:
    """Open a playwright page of a headless browser without a network, and close the browser afterwards.

    Args:
        width: pixels.
        height: pixels.

    Raises:
        MissingExtraError: playwright is not installed.
        BrowserError: there is no browser; the browser does not start, or the page reported an error.
    """
    with needs_extra("playwright", "video", "to draw images"):
        from playwright import sync_api
    errors: list[str] = []
    with sync_api.sync_playwright() as driver:
        path = find_browser(Path(driver.chromium.executable_path))
        try:
            browser = launch(driver, path)
            page = browser.new_context(viewport={"width": width, "height": height}, offline=True).new_page()
            page.set_default_timeout(_TIMEOUT_MS)
            page.on("pageerror", lambda error: errors.append(str(error)))
            yield page
            browser.close()
        except sync_api.Error as error:
            raise BrowserError(path, "; ".join((*errors, str(error).strip().split("\n")[0]))) from error
    if errors:
        raise BrowserError(path, "; ".join(errors))


def launch(driver: Any, path: str) -> Any:
    """Return playwright's handle of a started browser.

    The browser gets no display: it would try to draw with it, even if the display cannot be reached.

    Args:
        driver: playwright's driver.
        path: path of the browser.
    """
    display = ("DISPLAY", "WAYLAND_DISPLAY")
    environment = {name: value for name, value in os.environ.items() if name not in display}
    return driver.chromium.launch(executable_path=path, args=list(_ARGUMENTS), env=environment)


def find_browser(installed: Path) -> str:
    """Return the path of a Chromium: that of the variable CHROMIUM, playwright's own, or one of the system's.

    Args:
        installed: path at which playwright installs its own.

    Raises:
        BrowserError: there is none, or none at the path in the variable.
    """
    named = os.environ.get(_VARIABLE)
    candidates = (named,) if named else (str(installed), *_NAMES, _MAC)
    path = next(filter(None, map(shutil.which, candidates)), None)
    if path is None:
        raise BrowserError(
            None,
            "looked for "
            + ", ".join((f"{_VARIABLE}={named}",) if named else (_VARIABLE, str(installed), *_NAMES)),
        )
    return path
