"""The printed law over its sign gain alpha: what it tracks, what it squeezes, and what it carries.

Runs the paper's experiment, a load, a lighter payload and a bias at three control rates, from six starts, and
at two force gains; finished runs are kept in out/studies/alpha. Writes studies/alpha.csv, the tables of
docs/studies/alpha.md and docs/images/study-alpha.png.

Usage: python studies/alpha.py [--draw]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import claims_tables
import numpy as np
import pandas as pd
import paper_claims
from claims_tables import DYNAMICS, written
from matplotlib.figure import Figure
from pages import IMAGES, markdown, save_image, write_block

import coop_pin as cp
from coop_pin.comparison.trials import friction_changes
from coop_pin.figures import palette
from coop_pin.figures.style import label, styled

HERE = Path(__file__).parent
DATA = HERE / "alpha.csv"
PAGE = HERE.parent / "docs" / "studies" / "alpha.md"
METRIC = "claims_window:judged"
ALPHA, FORCE_GAIN = "controller.gains.sign_gain", "controller.gains.force_gain"
ALPHAS = (0.0, *(float(f"{digit}e{power}") for power in range(-5, 0) for digit in (1, 2, 5)), 1.0)
STEPS = {80.0: 5, 400.0: 1, 2000.0: 1}
"""Steps of the plant in a tick, by control rate, Hz."""
LOAD = 100.0
"""Unknown constant force along y from the time of the event on, N."""
LOAD_END = {80.0: 300.0, 400.0: 80.0, 2000.0: 20.0}
"""End of a run with the load, s, by control rate."""
STARTS = {80.0: 6, 400.0: 3, 2000.0: 2}
"""Starts by control rate: the paper's, and others that are off by up to 3 mm along x and y and 3 mrad."""
FORCE_GAINS = (0.0, 9.0)
SHOWN = {
    "quiet": ("position_mm", "force_N", "end_force_N"),
    "event": (
        "settled_s",
        "settled_narrow_s",
        "settled_again_s",
        "settled_again_narrow_s",
        "end_force_N",
        "end_axial_N",
    ),
    "load": ("event_peak_mm", "settled_again_narrow_s"),
    "mass": ("event_peak_mm", "end_force_N"),
    "bias 0.1 mm": ("force_N", "end_force_N"),
    "bias 1 mm": ("force_N", "end_force_N"),
    **dict.fromkeys(DYNAMICS, ("position_mm", "force_N")),
    **{f"{name}, K_f 9": ("position_mm", "force_N") for name in DYNAMICS[:-1]},
    **{
        f"K_f {gain:g}": ("force_N", "end_force_N", "force_in_band_s", "force_converged_s")
        for gain in FORCE_GAINS
    },
}
"""Measures that are kept, by trial."""
ON_PAGE = (0.0, 1e-4, 0.001, 0.002, 0.02, 0.2, 1.0)
"""Alphas of the page's table."""
ROWS = (
    ("position error, 4 to 10 s, mm rms", "quiet", "position_mm"),
    ("internal-force error, 4 to 10 s, N rms", "quiet", "force_N"),
    ("the same, last second of 20 s", "quiet", "end_force_N"),
    ("the same after the event", "event", "end_force_N"),
    ("settles to 5 mm and 5 mrad after the start, s", "event", "settled_s"),
    ("and after the event, s", "event", "settled_again_s"),
    ("100 N: largest position error, mm", "load", "event_peak_mm"),
    ("100 N: back within 1 mm after, s (of 290)", "load", "settled_again_narrow_s"),
    ("half of the mass: largest position error, mm", "mass", "event_peak_mm"),
    ("bias 0.1 mm: internal-force error after 20 s, N", "bias 0.1 mm", "end_force_N"),
    ("bias 1 mm: internal-force error after 20 s, N", "bias 1 mm", "end_force_N"),
)
"""Rows of the page's table: text, trial and measure."""
NEVER_S = 289.0
"""Times to take a load up from which a run counts as never: in the last of its 290 s it was still outside."""
PANELS = (
    ("quiet", "position_mm", "position error, 4 to 10 s", "mm rms"),
    ("quiet", "force_N", "internal-force error, 4 to 10 s", "N rms"),
    ("load", "settled_again_narrow_s", "100 N taken up, to 1 mm, after", "s"),
    ("bias 1 mm", "end_force_N", "the same after 20 s, 1 mm of bias", "N"),
)
"""Panels of the figure: trial, measure, title and unit."""


def trials(rate: float) -> dict[str, dict[str, Any]]:
    """Return what is changed in the paper's experiment, by name."""
    halved, push = (event.model_dump() for event in cp.Scenario.load("adept-paper").events)
    wrench, lasts = [0.0, LOAD, 0.0, 0.0, 0.0, 0.0], LOAD_END[rate] - push["time"]
    load = {**push, "duration": lasts, "wrench": wrench}

    def bias(metres: float) -> dict[str, Any]:
        return {"events": [], "cell.arms.left.calibration_error.tip.xyz": [metres, 0.0, 0.0]}

    return {
        "quiet": {"events": []},
        "event": {},
        "load": {"events": [load], "duration": LOAD_END[rate]},
        "mass": {"events": [halved]},
        "bias 0.1 mm": bias(1e-4),
        "bias 1 mm": bias(1e-3),
    }


def dynamics(paper: cp.Scenario) -> dict[str, dict[str, Any]]:
    """Return other masses and friction, and a load from the start on, as the study of the claims has them."""
    return {
        name: trial.changes | (friction_changes(paper, trial.friction) if trial.friction != 1.0 else {})
        for name, trial in paper_claims.trials(paper).items()
        if name in DYNAMICS
    }


def force_gains() -> dict[str, dict[str, Any]]:
    """Return the trials of the force gain, measured through a low-pass filter."""
    path = {"controller.force_path": {"kind": "low-pass", "pole": 0.9}, "events": []}
    return {f"K_f {gain:g}": path | {FORCE_GAIN: gain} for gain in FORCE_GAINS}


def starts(count: int) -> dict[str, dict[str, Any]]:
    """Return the starts by name."""
    start, named = cp.Scenario.load("adept-paper").start, {"0": {}}
    for seed in range(1, count):
        x, y, turned = np.random.default_rng(seed).uniform(-3e-3, 3e-3, 3)
        xyz, rpy = np.add(start.xyz, (x, y, 0.0)), np.add(start.rpy, (0.0, 0.0, turned))
        named[str(seed)] = {"start.xyz": xyz.tolist(), "start.rpy": rpy.tolist()}
    return named


def plans() -> Iterator[tuple[str, float, dict[str, cp.SweepPlan]]]:
    """Yield name and control rate of each trial, and its plans by start, one after the other for memory."""
    paper = cp.Scenario.load("adept-paper", {"sensors.wrist": {}})
    others, with_gain = dynamics(paper), force_gains()["K_f 9"]
    fed = {f"{name}, K_f 9": with_gain | others[name] for name in DYNAMICS[:-1]}
    for rate, steps in STEPS.items():
        clock = {"clock": {"rate_hz": rate, "steps_per_tick": steps}}
        more = force_gains() | others | fed if rate == paper.clock.rate_hz else {}
        for name, changes in (trials(rate) | more).items():
            yield (
                name,
                rate,
                {
                    start: cp.SweepPlan(
                        base=paper,
                        changes=moved | changes | clock,
                        axes={ALPHA: ALPHAS},
                        metrics=(METRIC,),
                        engine="compiled",
                    )
                    for start, moved in starts(STARTS[rate]).items()
                },
            )


def run(folder: Path) -> pd.DataFrame:
    """Run what is missing and return median, least and most over the starts."""
    rows = []
    for name, rate, by_start in plans():
        tables = []
        for start, plan in by_start.items():
            out = folder / f"{name} {rate:g}".replace(" ", "-") / start
            tables.append(cp.sweep(plan, out=out, execution=cp.Execution(workers=0, quiet=True)).table)
        for alpha, runs in pd.concat(tables).groupby(ALPHA):
            for measure in SHOWN[name]:
                values = runs[measure].fillna(np.inf)
                rows.append((rate, name, alpha, measure, values.median(), values.min(), values.max()))
        print(f"{name}, {rate:g} Hz", flush=True)
    return pd.DataFrame(rows, columns=["rate_hz", "trial", "alpha", "measure", "median", "least", "most"])


def at(table: pd.DataFrame, rate: float, trial: str, measure: str) -> pd.DataFrame:
    """Return median, least and most of a measure, a row for each alpha."""
    chosen = (table["rate_hz"] == rate) & (table["trial"] == trial) & (table["measure"] == measure)
    return table[chosen].set_index("alpha")[["median", "least", "most"]]


def ramp(table: pd.DataFrame, rate: float, trial: str) -> pd.Series:
    """Return growth of the internal force under a bias, N/s, from 4 to 10 s to the last second of 20 s."""
    early, late = (at(table, rate, trial, measure)["median"] for measure in ("force_N", "end_force_N"))
    return (late - early) / (19.5 - 7.0)


def page_table(table: pd.DataFrame) -> str:
    """Return the medians at the scenario's rate that the page shows."""

    def shown(alpha: float, trial: str, measure: str) -> str:
        median = at(table, 80.0, trial, measure).loc[alpha, "median"]
        return written(median if measure != "settled_again_narrow_s" or median < NEVER_S else np.inf)

    rows = [[text, *(shown(alpha, trial, measure) for alpha in ON_PAGE)] for text, trial, measure in ROWS]
    return markdown(["α", *(f"{alpha:g}" for alpha in ON_PAGE)], rows)


def figure(table: pd.DataFrame) -> Figure:
    """Return four panels over alpha, a line for each control rate: median, and the range over the starts."""
    with styled():
        drawn = Figure(figsize=(12.0, 3.4), layout="constrained")
        for panel, (trial, measure, title, unit) in zip(drawn.subplots(1, 4), PANELS, strict=True):
            for rate, colour, marker in zip(STEPS, palette.SERIES, "osD", strict=False):
                line = at(table, rate, trial, measure)
                line = line[(line.index > 0.0) & np.isfinite(line["median"])]
                style: Any = {"color": colour, "marker": marker, "markersize": 3.5, "linewidth": 1.1}
                panel.plot(line.index, line["median"], label=f"{rate:g} Hz", **style)
                panel.fill_between(line.index, line["least"], line["most"], color=colour, alpha=0.2)
            without = at(table, 80.0, trial, measure).loc[0.0, "median"]
            if np.isfinite(without):
                panel.axhline(
                    without, color=palette.LIMIT, linestyle=":", linewidth=1.0, label="α = 0, 80 Hz"
                )
            panel.set(xscale="log", yscale="log", xlabel="sign gain α")
            for alpha in claims_tables.SHOWN:
                panel.axvline(alpha, color=palette.FREE, linewidth=1.0, zorder=0.5)
            label(panel, title, unit)
        panel.legend(fontsize=7.0)
    return drawn


def main() -> None:
    """Run what is missing, unless only told to draw; write table, page and figure."""
    if "--draw" not in sys.argv[1:]:
        run(Path("out") / "studies" / "alpha").to_csv(
            DATA, index=False, float_format="%.4g", lineterminator="\n"
        )
    table = pd.read_csv(DATA)
    print(page_table(table))
    for trial in ("bias 0.1 mm", "bias 1 mm"):
        for rate in STEPS:
            product = ramp(table, rate, trial) * at(table, rate, "load", "settled_again_narrow_s")["median"]
            print(f"{trial}, {rate:g} Hz: ramp times time to take up {LOAD:g} N")
            print(product[np.isfinite(product)].map(written).to_string())
    write_block(PAGE, "alpha", page_table(table))
    save_image(figure(table), IMAGES / "study-alpha")


if __name__ == "__main__":
    main()
