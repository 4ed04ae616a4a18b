"""A real browser for tests; where there is none, they skip and say so."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
OURS = ("file:", "data:", "blob:", "about:", "http://127.0.0.1:", "ws://127.0.0.1:")
"""How the addresses begin that a page may ask for: on no test's behalf does anything leave the machine."""


def chromium() -> str:
    """The path of a Chromium; skips the test where there is none."""
    path = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("there is no Chromium on this machine: apt-get install chromium, or say where it is in CHROMIUM")
    return path


@contextmanager
def browser_page(width: int = 1200, height: int = 720, **context: object) -> Iterator[object]:
    """A page of a browser of its own. In the end it must have complained about nothing and asked nobody elsewhere for anything."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install 'coop-pin[test]'")
    path, complaints = chromium(), []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        page = browser.new_context(viewport={"width": width, "height": height}, **context).new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.context.on("request", lambda request: None if request.url.startswith(OURS) else complaints.append(f"asked for {request.url}"))
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
