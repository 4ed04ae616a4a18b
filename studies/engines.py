"""The comparison and the paper's experiment on both engines: medians side by side, and why they differ.

Runs what is missing in out/studies/engines, and writes studies/engines.csv (medians by engine) and the blocks
of docs/studies/engines.md. With --draw, only the blocks, from the CSV. Held by palms is left out: MuJoCo's
plant has no patches.

Usage: python studies/engines.py [--duration SECONDS] [--seeds N] [--out FOLDER] [--only ENGINE] [--draw]
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pages import markdown, write_block
from paper_claims import laws, trials

import coop_pin as cp
from coop_pin.comparison import benchmark_scenario, standard_trials
from coop_pin.comparison.trials import changes_of

HERE = Path(__file__).parent
DATA = HERE / "engines.csv"
PAGE = HERE.parent / "docs" / "studies" / "engines.md"
ENGINES = {"auto": "Pinocchio", "mujoco": "MuJoCo"}
"""Engines as asked for, and what computes the motion."""
CELLS = ("adept-anchored", "two-pandas-box", "three-ur5-plate")
LAWS = ("printed", "zeroed-leaky", "anchored", "computed-torque")
PAPER = ("printed, α = 0.002", "printed, α = 0.2", "zeroed leaky", "anchored")
MEASURES = {"tracking_rms_mm": "tracking, mm", "axial_rms_N": "axial force, N", "shear_rms_N": "shear, N"}
PAPER_MEASURES = {"tracking_rms_mm": "position_rms_mm", "axial_rms_N": "internal_force_rms_N"}
ALIKE = 0.01
"""Part by which medians may differ without a reason."""
PATCHED = "held by palms"


def compared(engine: str, out: Path, duration: float | None, seeds: int) -> pd.DataFrame:
    """Return the medians of the comparison on an engine: a row for each scenario, law and trial."""
    known = {
        name: None
        for cell in CELLS
        for name in standard_trials(benchmark_scenario(cp.Scenario.load(cell)))
        if name != PATCHED
    }
    execution = cp.Execution(workers=0, engine=engine, quiet=True)
    options: dict[str, Any] = {"duration": duration, "seeds": seeds, "execution": execution}
    table = cp.compare(CELLS, LAWS, list(known), out=out / engine, **options).table.reset_index()
    return table[["scenario", "controller", "trial", *MEASURES, "runs", "finished"]].assign(
        engine=ENGINES[engine]
    )


def main() -> None:
    """Run what is missing, unless only told to draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, help="of every run, s; the scenarios' own when omitted")
    parser.add_argument("--seeds", type=int, default=5, help="of random trials")
    parser.add_argument("--out", type=Path, default=Path("out") / "studies" / "engines")
    parser.add_argument("--only", choices=list(ENGINES), help="run one engine, and write nothing")
    asked = parser.parse_args()
    if asked.only:
        print(compared(asked.only, asked.out, asked.duration, asked.seeds).to_string())


if __name__ == "__main__":
    main()
