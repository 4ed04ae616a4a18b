"""Size of pages, and processor time of a browser until they are painted, drawn in 3-D and loaded.

    python benchmarks/bench_pages.py [--rounds 5] [REPLAY ...]

Without replays, those of two cells and of four runs side by side. Times are of all processes of a headless
Chromium that draws in software, medians of the rounds: on a machine with nothing else to do a page takes at
most as long. Printed, never asserted.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from pathlib import Path
from typing import Any

from playwright import sync_api

import coop_pin as cp
from coop_pin.viz import save_replay
from coop_pin.viz.browser import find_browser, launch

DRAWN = """() => new Promise(done => { const look = () => window.coopPin
    ? requestAnimationFrame(() => requestAnimationFrame(done)) : requestAnimationFrame(look); look(); })"""
"""Resolves once a page has drawn its first 3-D frame; of several runs, that of each."""
PAINTED = "() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? NaN"


def processor_s(browser: Any) -> float:
    """Return the processor time of all processes of a browser, s."""
    with_all = browser.new_browser_cdp_session()
    return float(sum(each["cpuTime"] for each in with_all.send("SystemInfo.getProcessInfo")["processInfo"]))


def opened(driver: Any, page: Path) -> tuple[float, float]:
    """Return the time to the first paint, s of wall time, and the processor time to the first 3-D frame."""
    browser = launch(driver, find_browser(Path(driver.chromium.executable_path)))
    tab = browser.new_context(viewport={"width": 1400, "height": 900}, offline=True).new_page()
    tab.set_default_timeout(300_000)
    before = processor_s(browser)
    tab.goto(page.resolve().as_uri())
    tab.evaluate(DRAWN)
    times = tab.evaluate(PAINTED) / 1e3, processor_s(browser) - before
    browser.close()
    return times


def pages(folder: Path) -> list[Path]:
    """Write the pages that are measured without an argument."""
    planar, spatial = cp.run("adept-paper", warn=False), cp.run("two-pandas-box", warn=False)
    save_replay(planar, folder / "adept-paper.html")
    save_replay(spatial, folder / "two-pandas-box.html")
    save_replay(spatial, folder / "four-panes.html", spatial, spatial, spatial, names=list("abcd"))
    return [folder / f"{name}.html" for name in ("adept-paper", "two-pandas-box", "four-panes")]


def main(arguments: list[str] | None = None) -> None:
    """Print a row for each page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder, sync_api.sync_playwright() as driver:
        print("| replay | MB | first paint, s of wall time | first 3-D frame, s of processor |")
        print("|---|---|---|---|")
        for page in asked.pages or pages(Path(folder)):
            painted, drawn = zip(*(opened(driver, page) for _ in range(asked.rounds)), strict=True)
            medians = f"{statistics.median(painted):.2f} | {statistics.median(drawn):.1f}"
            print(f"| {page.stem} | {page.stat().st_size / 1e6:.2f} | {medians} |", flush=True)


if __name__ == "__main__":
    main()
