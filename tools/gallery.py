"""Draw the loops of the gallery, and write its page of the documentation.

    python tools/gallery.py                      # every cell of the catalogue, and the four laws
    python tools/gallery.py two-pandas-box       # some of them; the page is always written
    python tools/gallery.py --page               # the page alone

A loop is a whole run in six seconds, drawn by a headless browser with the network off.
"""

from __future__ import annotations

import argparse
import html
import io
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import coop_pin as cp
from coop_pin import RunResult, scenario_names
from coop_pin.viz.export import page_images
from coop_pin.viz.replay import replay_html

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY / "studies"))
from pages import write_block  # noqa: E402

LOOPS = REPOSITORY / "docs" / "_static" / "gallery"
SECONDS, FRAMES_PER_SECOND = 6.0, 5.0
SCENE_ONLY = """html, body, main { display: block !important; height: 100% !important; }
    nav, aside, #caption, #views { display: none !important; } #view { height: 100% !important; }
    #tension { width: 170px !important; }"""
PANES_ONLY = {
    "</head>": "<style>header { height: 0; padding: 0 !important; overflow: hidden; }</style></head>",
    ".pane button.told { display: flex;": ".pane button.told { display: none;",
    ".pane .verdict { white-space": ".pane .verdict { display: none; white-space",
    '"#tension { width: 130px; }"': '"#tension { display: none; }"',
}
"""What replaces parts of a page of several runs: titles and verdicts cannot be read in a loop."""
LAWS = "laws"
BIAS: dict[str, Any] = {
    "events": [],
    "duration": 10.0,
    "cell.arms.left.calibration_error.tip.xyz": [1e-3, 0.0, 0.0],
}
FOUR_LAWS: dict[str, tuple[str, dict[str, Any]]] = {
    "printed, α = 0.2": ("adept-paper", {"controller.gains.sign_gain": 0.2}),
    "printed, α = 0.002": ("adept-paper", {}),
    "no sensor": ("adept-anchored", {"controller.force_path.kind": "none"}),
    "anchored": ("adept-anchored", {}),
}


def save_loop(name: str, *runs: RunResult, names: tuple[str, ...] = (), width: int, height: int) -> Path:
    """Draw a loop of runs and return its file, an animated WebP."""
    count = int(SECONDS * FRAMES_PER_SECOND)
    times = np.linspace(0.0, max(run.end for run in runs), count)
    page = replay_html(*runs, names=names, times=times)
    scene = {"</head>": f"<style>{SCENE_ONLY}</style></head>"}
    for part, other in (scene if len(runs) == 1 else PANES_ONLY).items():
        page = page.replace(part, other, 1)
    images = [
        Image.open(io.BytesIO(image)).convert("RGB") for image in page_images(page, times, width, height)
    ]
    LOOPS.mkdir(parents=True, exist_ok=True)
    file, pause = LOOPS / f"{name}.webp", round(1e3 / FRAMES_PER_SECOND)
    durations = [*[pause] * (count - 1), 8 * pause]  # the end is held
    images[0].save(
        file, save_all=True, append_images=images[1:], duration=durations, loop=0, quality=36, method=6
    )
    return file


def gallery() -> str:
    """Return the loops of the catalogue, robots of today first, each a link to its replay on the site."""
    figures = []
    for name in reversed(scenario_names()):
        text = html.escape(f"{cp.Scenario.load(name).summary}.".replace("..", "."))
        image = f'<img src="_static/gallery/{name}.webp" alt="replay of {name}" loading="lazy"'
        figures += [
            f'<figure id="{name}"><a href="_static/replays/{name}.html">',
            f'{image} width="480" height="320"></a>',
            f"<figcaption>{text}<br><code>coop-pin run {name}</code></figcaption></figure>",
        ]
    return "\n".join(['<div class="loops">', *figures, "</div>"])


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", choices=[*scenario_names(), LAWS, []])
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    for name in () if options.page else options.names or (*scenario_names(), LAWS):
        if name == LAWS:
            runs = [cp.run(scenario, BIAS | changes) for scenario, changes in FOUR_LAWS.values()]
            file = save_loop(name, *runs, names=tuple(FOUR_LAWS), width=800, height=860)
        else:
            file = save_loop(name, cp.run(name), width=480, height=320)
        print(f"{file.relative_to(REPOSITORY)}: {file.stat().st_size / 1e6:.2f} MB", flush=True)
    write_block(REPOSITORY / "docs" / "gallery.md", "loops", gallery())


if __name__ == "__main__":
    main()
