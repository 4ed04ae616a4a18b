"""Run one of the studies, print its numbers and save its figure in docs/images.

Finished runs are kept in out/studies/NAME. Usage: python studies/draw.py NAME, for example force_gain.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import bias
import force_gain
import one_millimetre
import payload
from matplotlib.figure import Figure
from pages import IMAGES, save_image

import coop_pin as cp

HERE = Path(__file__).parent
Results = Mapping[str, cp.SweepResult]


class Study(NamedTuple):
    """One study.

    Attributes:
        image: file name of its figure, without the suffix.
        figure: returns the figure of its sweeps, which are given by name.
        numbers: returns the numbers that the README quotes, as text.
    """

    image: str
    figure: Callable[[Results], Figure]
    numbers: Callable[[Results], str]


STUDIES = {
    "force_gain": Study("study-force-gain", force_gain.figure, force_gain.numbers),
    "payload": Study("study-payload", payload.figure, payload.numbers),
    "bias": Study("study-bias", bias.figure, bias.numbers),
    "one_millimetre": Study("printed-and-anchored", one_millimetre.figure, one_millimetre.numbers),
}


def plans(name: str) -> dict[str, cp.SweepPlan]:
    """Return the plans of a study by the names of their files: one file, or a folder of them."""
    files = sorted((HERE / name).glob("*.toml")) or [HERE / f"{name}.toml"]
    return {file.stem: cp.SweepPlan.load(file) for file in files}


def run(name: str, folder: Path) -> dict[str, cp.SweepResult]:
    """Run the missing runs of a study and return its sweeps."""
    return {part: cp.sweep(plan, out=folder / part) for part, plan in plans(name).items()}


def main() -> None:
    """Run the study that the command names, print its numbers and save its figure."""
    if len(sys.argv) != 2 or sys.argv[1] not in STUDIES:
        sys.exit(f"usage: python {sys.argv[0]} {{{' | '.join(STUDIES)}}}")
    name = sys.argv[1]
    results = run(name, Path("out") / "studies" / name)
    for result in results.values():
        print(result.summary())
    print(STUDIES[name].numbers(results))
    save_image(STUDIES[name].figure(results), IMAGES / STUDIES[name].image)


if __name__ == "__main__":
    main()
