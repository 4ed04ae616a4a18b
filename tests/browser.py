"""A real browser for tests; where there is none, they skip and say so."""

import functools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from coop_pin.errors import BrowserError
from coop_pin.viz.export import find_browser, launch

PATIENCE_MS = 90_000
OURS = ("file:", "data:", "blob:", "about:", "http://127.0.0.1:", "ws://127.0.0.1:")
"""How the addresses begin that a page may ask for: on no test's behalf does anything leave the machine."""


@functools.cache
def chromium() -> str:
    """The path of the Chromium that pictures are drawn with; skips the test where there is none, or no playwright."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install 'coop-pin[test]'"
    )
    with playwright.sync_playwright() as driver:
        own = Path(driver.chromium.executable_path)
    try:
        return find_browser(own)
    except BrowserError as error:
        if os.environ.get("CHROMIUM"):
            raise  # named, but not there
        pytest.skip(str(error))


@contextmanager
def browser_page(width: int = 1200, height: int = 720, **context: object) -> Iterator[object]:
    """A page of a browser of its own. In the end it must have complained about nothing and asked nobody elsewhere for anything."""
    path, complaints = chromium(), []
    from playwright import sync_api

    with sync_api.sync_playwright() as driver:
        browser = launch(driver, path)
        page = browser.new_context(viewport={"width": width, "height": height}, **context).new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.context.on(
            "request",
            lambda request: (
                None if request.url.startswith(OURS) else complaints.append(f"asked for {request.url}")
            ),
        )
        yield page
        browser.close()
    assert complaints == []


@contextmanager
def offline_page(file: Path, width: int = 1400, height: int = 900) -> Iterator[object]:
    """A file, opened with the network off; its console must have no errors either."""
    with browser_page(width, height, offline=True) as page:
        said = []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.goto(file.resolve().as_uri())
        yield page
        assert said == []
