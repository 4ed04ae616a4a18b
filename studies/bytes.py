"""Bytes that arms send against newtons that remain, over rate, threshold and loss of their messages.

A planar pair goes round a circle with one arm's tip 1 mm off, thirty seeds each. Finished rows are kept in
studies/bytes.csv, and an interrupted command continues there; ``--fresh`` begins anew. Writes the tables of
docs/studies/bytes.md and docs/images/study-bytes.png.

Usage: python studies/bytes.py [--fresh | --draw]
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pages import IMAGES, markdown, save_image, write_block

import coop_pin as cp
from coop_pin.figures import palette
from coop_pin.figures.style import styled

HERE = Path(__file__).parent
DATA, PAGE = HERE / "bytes.csv", HERE.parent / "docs" / "studies" / "bytes.md"
CELL, BIAS, SEEDS, DURATION, FROM = "adept-anchored", 1e-3, 30, 20.0, 5.0
"""Cell, error of a tip, m, seeds, length of a run, s, and time from which errors count, s."""
RADIUS, ANGULAR_RATE = 0.04, 1.5
"""Circle of the payload, m and rad/s."""
LOSSES = (0.0, 0.05, 0.2)
COLORS = palette.ACTUAL, palette.MEASURED, palette.INTERNAL
RATES = (80.0, 40.0, 20.0, 16.0, 10.0, 5.0, 2.5, 1.25)
LEVER, ANY = 0.1, 1e4
"""Newton metres for a newton, and a threshold that the age of a wrench never reaches, ticks."""
PI_GAIN = 7.19894
"""Pose gain of the law payload-pi of the benchmark on this cell, 1/s."""
MEAN_GAINS = {"pose_gain": PI_GAIN, "sign_gain": 115.522, "anchor_gain": 0.0, "transient_rate": 5.0}

LAWS: dict[str, tuple[tuple[float, ...], tuple[float, ...], str]] = {
    "wrist wrenches": ((0.1, 0.3, 0.5, 0.7, 1.0, 2.0, 5.0, 10.0), (1.0, 1.0, LEVER, ANY), "N"),
    "views": ((1e-5, 1e-4, 2e-4, 3e-4, 5e-4, 1e-3, 2e-3), (1.0,) * 6 + (PI_GAIN,) * 3, "m"),
}
"""By what is sent: thresholds, their scale for each number of a message, and their unit."""
COLUMNS = ["law", "way", "value", "loss", "bytes_per_s", "force_N", "least_N", "largest_N", "diverged"]


def changes(law: str) -> dict[str, Any]:
    """Return what makes a scenario of the cell one with a law, of those of LAWS."""
    if law == "views":
        K = list(cp.Scenario.load(CELL).controller.gains.sliding_gain)
        gains = MEAN_GAINS | {"sliding_gain": K}
        return {
            "controller": {
                "kind": "mean-pose",
                "gains": gains,
                "switching": {"kind": "saturation", "width": 10.0},
            }
        }
    wrist = {"noise": {"force": 0.2, "moment": 0.01}}
    return {"controller.force_path": {"kind": "messages"}, "sensors.wrist": wrist}


def scenarios(law: str, way: str, loss: float) -> list[tuple[float, cp.Scenario]]:
    """Return the runs of a law at a loss over the rates or thresholds, each with its value."""
    thresholds, scale, _ = LAWS[law]
    base = cp.Scenario.load(CELL, {"events": []})
    arm = next(iter(base.cell.arms))
    circle = {"kind": "circle", "pose": base.start, "radius": RADIUS, "angular_rate": ANGULAR_RATE}
    common = {
        f"cell.arms.{arm}.calibration_error.tip.xyz": [BIAS, 0.0, 0.0],
        "motion": circle,
        "duration": DURATION,
        "clock.record_every": 8,
        "beyond_bound": True,
    }
    runs = list[tuple[float, cp.Scenario]]()
    for value in RATES if way == "rate" else thresholds:
        timing = {"rate_hz": value} if way == "rate" else {"threshold": [value * each for each in scale]}
        run = base.override(common | {"network": {"loss": loss} | timing} | changes(law))
        runs += [(value, run.replace(seed=seed)) for seed in range(SEEDS)]
    return runs


def rows(law: str, way: str, loss: float) -> pd.DataFrame:
    """Return the rows of the table for a law at a loss, a value each."""
    values, runs = zip(*scenarios(law, way, loss), strict=True)
    batch = cp.compiled.simulate_batch(runs)
    counted = batch.samples["time"][0] > FROM
    error = np.asarray(batch.samples["internal_axial_error"])[:, counted].reshape(len(runs), -1)
    force = np.where(batch.is_valid, np.sqrt(np.mean(error**2, axis=1)), np.inf)
    sent = np.asarray(batch.samples["bytes_sent"])[:, -1].sum(axis=-1) / DURATION
    table = list[list[Any]]()
    for value in dict.fromkeys(values):
        of_value = np.array(values) == value
        f, is_lost = force[of_value], np.isinf(force[of_value])
        bytes_per_s = np.nan if is_lost.any() else np.median(sent[of_value])
        table.append([law, way, value, loss, bytes_per_s, np.median(f), f.min(), f.max(), int(is_lost.sum())])
    return pd.DataFrame(table, columns=COLUMNS)


def simulate(
    data: pd.DataFrame, rows: Callable[[str, str, float], pd.DataFrame] = rows, file: Path = DATA
) -> pd.DataFrame:
    """Return the table with the rows that it lacks, each batch written when it is done."""
    for law in LAWS:
        for way in ("rate", "threshold"):
            for loss in LOSSES:
                if not ((data.law == law) & (data.way == way) & (data.loss == loss)).any():
                    data = pd.concat([data, rows(law, way, loss)]) if len(data) else rows(law, way, loss)
                    data.to_csv(file, index=False, float_format="%.4g")
                    print(law, way, loss, flush=True)
    return pd.read_csv(file)


def figure(data: pd.DataFrame) -> Figure:
    """Return the figure: bytes a second against newtons, medians of the seeds with their spans."""
    with styled():
        drawing, axes = plt.subplots(1, 2, figsize=(7.2, 3.2), sharey=True, layout="constrained")
        for ax, law in zip(axes, LAWS, strict=True):
            for color, loss in zip(COLORS, LOSSES, strict=True):
                for way, style in (("rate", "o--"), ("threshold", "s-")):
                    rows = data[(data.law == law) & (data.way == way) & (data.loss == loss)]
                    kept = rows[rows.diverged == 0]
                    ax.plot(
                        kept.bytes_per_s,
                        kept.force_N,
                        style,
                        color=color,
                        markersize=3,
                        label=f"{way}, {100 * loss:g} % lost",
                    )
                    ax.fill_between(
                        kept.bytes_per_s, kept.least_N, kept.largest_N, alpha=0.15, color=color, linewidth=0
                    )
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_title(f"{law} are sent", fontsize=8)
            ax.set_xlabel("bytes a second, both arms")
        axes[0].set_ylabel("internal-force error, rms, N")
        axes[1].legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return drawing


def table(data: pd.DataFrame, law: str) -> str:
    """Return the table of a law: bytes a second and newtons at each value, by loss."""
    unit, lines = LAWS[law][2], list[list[str]]()
    for way in ("rate", "threshold"):
        for value in data[(data.law == law) & (data.way == way)].value.drop_duplicates():
            cells = [f"{value:g} Hz" if way == "rate" else f"threshold {value:g} {unit}"]
            for loss in LOSSES:
                (row,) = data[
                    (data.law == law) & (data.way == way) & (data.value == value) & (data.loss == loss)
                ].itertuples()
                is_lost = row.diverged > 0
                cells += [
                    "" if is_lost else f"{row.bytes_per_s:.0f}",
                    f"{row.diverged} of {SEEDS} diverge"
                    if is_lost
                    else f"{row.force_N:.3g} ({row.least_N:.3g} to {row.largest_N:.3g})",
                ]
            lines.append(cells)
    header = ["sent"] + [part for loss in LOSSES for part in (f"B/s, {100 * loss:g} % lost", "N")]
    return markdown(header, lines)


def least_bytes(data: pd.DataFrame, law: str, factor: float = 1.5) -> str:
    """Return the sentences on the fewest bytes that keep the error below a factor of that of all messages."""
    sentences = list[str]()
    for loss in LOSSES:
        at_loss = data[(data.law == law) & (data.loss == loss)]
        full = at_loss[(at_loss.way == "rate") & (at_loss.value == RATES[0])].iloc[0]
        kept = at_loss[(at_loss.diverged == 0) & (at_loss.force_N <= factor * full.force_N)]
        parts = [
            f"{100 * kept[kept.way == way].bytes_per_s.min() / full.bytes_per_s:.3g} % by the {way}"
            for way in ("rate", "threshold")
            if (kept.way == way).any()
        ]
        sentences.append(f"- {100 * loss:g} % lost: {full.force_N:.3g} N; {', '.join(parts)}.")
    head = f"All messages, and the part of their bytes that keeps the error below {factor:g} times that:"
    return "\n".join([head, "", *sentences])


def main() -> None:
    """Simulate what is missing, and write tables, image and page."""
    is_new = "--fresh" in sys.argv or not DATA.exists()
    data = pd.DataFrame(columns=COLUMNS) if is_new else pd.read_csv(DATA)
    data = data if "--draw" in sys.argv else simulate(data)
    for law in LAWS:
        write_block(PAGE, law, f"{least_bytes(data, law)}\n\n{table(data, law)}")
    print(save_image(figure(data), Path(IMAGES) / "study-bytes"))


if __name__ == "__main__":
    main()
