"""Headless browser for tests; tests are skipped, with the reason, if there is none."""

import functools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from coop_pin.base.errors import BrowserError
from coop_pin.viz.browser import find_browser, launch

PATIENCE_MS = 90_000
ALLOWED = ("file:", "data:", "blob:", "about:", "http://127.0.0.1:", "ws://127.0.0.1:")
"""Prefixes of the addresses that a page may request: tests never leave the machine."""

NOTEBOOK_7 = "/static/notebook/notebook_core"
"""Script of Notebook 7 that reports an error of its own, with an empty notebook, too."""


@functools.cache
def chromium() -> str:
    """Path of the Chromium that images are drawn with; skips the test if there is none, or no playwright."""
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
    """Page of a new browser; it must report no errors and request nothing from elsewhere."""
    path, errors = chromium(), []
    from playwright import sync_api

    with sync_api.sync_playwright() as driver:
        browser = launch(driver, path)
        page = browser.new_context(viewport={"width": width, "height": height}, **context).new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on(
            "pageerror",
            lambda error: errors.append(str(error)) if NOTEBOOK_7 not in (error.stack or "") else None,
        )
        page.context.on(
            "request",
            lambda request: (
                None if request.url.startswith(ALLOWED) else errors.append(f"asked for {request.url}")
            ),
        )
        yield page
        browser.close()
    assert errors == []


@contextmanager
def offline_page(file: Path, width: int = 1400, height: int = 900) -> Iterator[object]:
    """File opened with the network off; its console must have no errors either."""
    with browser_page(width, height, offline=True) as page:
        said = []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.goto(file.resolve().as_uri())
        yield page
        assert said == []
