"""A real browser for tests; where there is none, they skip and say so."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

ARGUMENTS = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
PATIENCE_MS = 90_000


def chromium() -> str:
    """The path of a Chromium; skips the test where there is none."""
    path = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("there is no Chromium on this machine: apt-get install chromium, or say where it is in CHROMIUM")
    return path


@contextmanager
def browser_page(width: int = 1200, height: int = 720, **context: object) -> Iterator[object]:
    """A page of a browser of its own, and what it complained about, which must be nothing in the end."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install 'coop-pin[test]'")
    path, complaints = chromium(), []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        page = browser.new_context(viewport={"width": width, "height": height}, **context).new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        yield page
        browser.close()
    assert complaints == []
