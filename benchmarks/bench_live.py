"""Cost of a live view for a run, and frame rate of the view.

    python benchmarks/bench_live.py [--duration 5] [--blocks 5]

The slowdown is the processor time of a run as fast as possible with a view, against the same run alone,
interleaved. Frames per second are counted at real time: those sent to the server process, those that reached
a client, with the time from their tick on, and, if playwright and a Chromium are installed, those that
a browser drew. Printed, never asserted.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import struct
import threading
import time
from pathlib import Path

import common
import numpy as np
from tornado.websocket import websocket_connect

import coop_pin as cp
from coop_pin import open_view
from coop_pin.base.errors import BrowserError
from coop_pin.viz import LiveView
from coop_pin.viz.browser import find_browser, launch


def slowdown(scenario: cp.Scenario, blocks: int) -> None:
    """Print the cost of a view for a run."""
    view, every = open_view(scenario), open_view(scenario)
    print(f"served at {view.url} and {every.url}")
    tasks = {
        "alone": lambda: cp.run(scenario),
        "with a view, 30 frames per second of wall time": lambda: cp.run(
            scenario, view=view, realtime_rate=math.inf
        ),
        "with a view that is sent every tick": lambda: cp.run(
            scenario, view=every.show, realtime_rate=math.inf
        ),
    }
    seconds = common.interleaved(tasks, blocks, 1)
    view.close()
    every.close()
    ticks = scenario.duration * scenario.clock.rate_hz
    print(
        f"processor time of {scenario.duration:g} s of {scenario.name} as fast as possible;"
        " median (min .. max) of alone"
    )
    for name, values in seconds.items():
        tick = 1e6 * np.median(values) / ticks
        print(f"  {name:50s} {common.ratio(values, seconds['alone'])}   {tick:6.0f} us per tick")
    share = (np.median(seconds["with a view that is sent every tick"]) - np.median(seconds["alone"])) / ticks
    print(
        f"  a frame costs the run {1e6 * share:.0f} us;"
        f" 30 per second take {100 * 30 * share:.1f} % of one core"
    )


def frames(scenario: cp.Scenario) -> None:
    """Print the frame rates of sender, client and browser at real time."""
    view = open_view(scenario)
    print(f"served at {view.url}")
    arrived, ready = dict[float, float](), threading.Event()
    client = threading.Thread(target=lambda: asyncio.run(receive(view, arrived, ready)), daemon=True)
    client.start()
    ready.wait(10.0)
    sent = dict[float, float]()

    def watch(snapshot: cp.results.Snapshot) -> None:
        sent[float(np.float32(snapshot.time))] = time.monotonic()
        view(snapshot)

    start = time.monotonic()
    result = cp.run(scenario, view=watch)
    wall = time.monotonic() - start
    time.sleep(1.0)
    late = 1e3 * np.array([when - sent[frame] for frame, when in arrived.items()])
    print(
        f"{result.end:g} s at real time took {wall:.2f} s: {view.sent / wall:.1f} frames per second sent,"
        f" {view.dropped} dropped,"
    )
    print(f"  {len(arrived) / wall:.1f} reached a client,", end="")
    print(f" {np.median(late):.1f} ms after their tick (99 %: {np.quantile(late, 0.99):.0f} ms)", end="")
    view.close()
    drawn = in_browser(scenario)
    print(
        f", {drawn:.1f} per second were drawn by Chromium without a graphics card"
        if drawn is not None
        else "; no browser here"
    )


async def receive(view: LiveView, arrived: dict[float, float], ready: threading.Event) -> None:
    """Note when each frame reaches the client, by the frame's time."""
    connection = await websocket_connect(view.url.replace("http", "ws") + "frames")
    ready.set()
    while (frame := await connection.read_message()) is not None:
        arrived[struct.unpack_from("<f", frame)[0]] = time.monotonic()


def in_browser(scenario: cp.Scenario) -> float | None:
    """Return the frames per second that a browser draws; None if there is none."""
    try:
        from playwright.sync_api import sync_playwright

        chromium = find_browser(Path())
    except (ImportError, BrowserError):
        return None

    view = open_view(scenario)
    with sync_playwright() as driver:
        browser = launch(driver, chromium)
        page = browser.new_page(viewport={"width": 1200, "height": 720})
        page.goto(view.url)
        page.wait_for_function("window.coopPin !== undefined")
        page.evaluate(
            "() => { const viewer = coopPin.viewer, draw = viewer.render.bind(viewer); window.drawn = 0;"
            " viewer.render = () => { window.drawn += 1; draw(); }; }"
        )
        start = time.monotonic()
        run = threading.Thread(target=cp.run, args=(scenario,), kwargs={"view": view})
        run.start()
        while run.is_alive():
            page.wait_for_timeout(100)
        drawn = page.evaluate("window.drawn") / (time.monotonic() - start)
        browser.close()
    view.close()
    return float(drawn)


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--blocks", type=int, default=5)
    parser.add_argument(
        "--duration", type=float, default=5.0, help="of each run, s; shorter ones have no events"
    )
    options = parser.parse_args(arguments)
    scenario = common.shortened(cp.Scenario.load("adept-paper"), options.duration)
    slowdown(scenario, options.blocks)
    frames(scenario)


if __name__ == "__main__":
    main()
