"""Take a picture of a replay page at a given time, in a headless browser with the network off.

    python tools/screenshot.py out/replay.html picture.png --time 6

Needs playwright (``pip install playwright``) and a Chromium; Debian's is found at /usr/bin/chromium. The README's picture is made so:

    coop-pin run adept-paper --out out
    python tools/screenshot.py out/replay.html docs/images/adept-paper.png --time 0.1
"""

from __future__ import annotations

import argparse
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

_ARGUMENTS = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def screenshot(replay: Path, picture: Path, time: float, width: int, height: int, chromium: str) -> None:
    """Write a PNG of a replay page at a time of the run.

    Args:
        replay: the page.
        picture: the PNG.
        time: of the run, s.
        width: pixels.
        height: pixels.
        chromium: the browser.

    Raises:
        RuntimeError: the page reported an error.
    """
    complaints: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(_ARGUMENTS))
        context = browser.new_context(viewport={"width": width, "height": height}, offline=True)
        page = context.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.goto(replay.resolve().as_uri())
        _settle(page, time)
        picture.parent.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=picture, type="png")
        browser.close()
    if complaints:
        raise RuntimeError(f"{replay} reported: {complaints}")


def _settle(page: Page, time: float) -> None:
    """Bring the page to a time and wait until it is drawn."""
    page.wait_for_function("window.coopPin !== undefined")
    page.evaluate("time => window.coopPin.seek(time)", time)
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("replay", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--time", type=float, default=6.0)
    parser.add_argument("--width", type=int, default=1200)
    parser.add_argument("--height", type=int, default=720)
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    given = parser.parse_args()
    screenshot(given.replay, given.picture, given.time, given.width, given.height, given.chromium)


if __name__ == "__main__":
    main()
