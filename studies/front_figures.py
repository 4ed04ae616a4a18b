"""Figures of the front study, from its tables: laws by tracking and internal force, maps over trials."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pages import save_image

from coop_pin.base.arrays import Array
from coop_pin.figures import palette
from coop_pin.figures.style import label, styled

LAWS: dict[str, tuple[str, str, bool]] = {
    "printed, tuned": (palette.INTERNAL, "o", False),
    "printed, tuned, alpha 0": (palette.MEASURED, "o", False),
    "payload, sgn": (palette.EXTERNAL, "s", False),
    "payload, saturation": (palette.DESIRED, "s", False),
    "zeroed leaky": (palette.LOAD, "D", False),
    "dead zone": (palette.SINGULAR, "D", False),
    "printed, tuned, K_f": (palette.INTERNAL, "o", True),
    "own wrench": (palette.SINGULAR, "^", True),
    "anchored": (palette.ACTUAL, "*", True),
}
"""Colour and marker of each law, filled where it measures a wrench; those without a sensor come first."""
UNSENSED = sum(not filled for *_, filled in LAWS.values())
LIMITS: Any = {"xlim": (2e-4, 60.0), "ylim": (3e-3, 400.0)}
TITLES = {"adept": "two Adept arms", "panda": "two Pandas"}
SHOWN = ("nominal", "bias 1 mm", "unknown load", "bias 0.1 mm and load")
BIAS, LOAD = 0.1, {"adept": 100.0, "panda": 40.0}
"""Bias b, mm, and load D, N, of the trial with both: the product bound is c_1 c_2 b D / (e + b)."""
MEASURES = {"position_mm": "position error, mm rms", "force_N": "internal-force error, N rms"}


def read(data: Path, name: str) -> pd.DataFrame:
    """Return a table of all cells."""
    return pd.concat([pd.read_csv(file) for file in sorted(data.glob(f"*-{name}.csv"))])


def marker(law: str, **other: Any) -> dict[str, Any]:
    """Return how a law is drawn."""
    colour, shape, filled = LAWS[law]
    size = 9.0 if shape == "*" else 5.5
    face = colour if filled else "white"
    return {"marker": shape, "color": colour, "markerfacecolor": face, "markersize": size} | other


def pareto(points: Array) -> Array:
    """Return the points that no other point is below in both columns, by the first column."""
    ordered = points[np.lexsort(points.T[::-1])]
    return ordered[ordered[:, 1] < np.append(np.inf, np.minimum.accumulate(ordered[:, 1])[:-1])]


def front_figure(judged: pd.DataFrame, tuning: pd.DataFrame) -> Figure:
    """Return a column of panels for each cell, as wide as a page: the runs of the tuning, then trials."""
    cells = [cell for cell in TITLES if cell in set(judged["cell"])]
    rows = ("tuning", *SHOWN)
    with styled():
        figure = Figure(figsize=(7.16, 1.75 * len(rows) + 0.7), layout="constrained")
        axes = figure.subplots(len(rows), len(cells), squeeze=False, sharex=True, sharey=True)
        for cell, column in zip(cells, axes.T, strict=True):
            mine = judged[judged["cell"] == cell]
            draw_tuning(column[0], tuning[tuning["cell"] == cell])
            for trial, panel in zip(SHOWN, column[1:], strict=True):
                draw_trial(panel, mine[mine["trial"] == trial])
                label(panel, trial, "")
            errors = np.geomspace(*LIMITS["xlim"])
            bound = 0.25 * BIAS * LOAD[cell] / (errors + BIAS)
            column[-1].plot(errors, bound, color=palette.LIMIT, linestyle=":", linewidth=1.0)
            label(column[0], f"{TITLES[cell]}, tuning: 30 runs of each law", "")
            column[-1].set_xlabel(MEASURES["position_mm"])
        figure.supylabel(MEASURES["force_N"], fontsize=9.0)
        axes[0, 0].set(**LIMITS)
        handles = [Line2D([], [], linestyle="none", label=named(law), **marker(law)) for law in LAWS]
        dotted = Line2D([], [], color=palette.LIMIT, linestyle=":", label="bound on own views")
        figure.legend(handles=[*handles, dotted], loc="outside upper center", ncols=4, columnspacing=1.2)
    return figure


def draw_tuning(panel: Axes, runs: pd.DataFrame) -> None:
    """Draw all runs of the tuning of a cell, and the front of each law."""
    for law, (colour, _, filled) in LAWS.items():
        points = runs.loc[runs["law"] == law, list(MEASURES)].to_numpy()
        points = points[np.isfinite(points).all(axis=1)]
        if points.size:
            panel.plot(*points.T, ".", color=colour, markersize=2.5, alpha=0.5)
            line = "-" if filled else (0, (2, 1))
            panel.step(*pareto(points).T, where="post", color=colour, linestyle=line, linewidth=1.0)
    panel.set(xscale="log", yscale="log")


def draw_trial(panel: Axes, rows: pd.DataFrame) -> None:
    """Draw the laws in one trial."""
    for law, position, force in rows[["law", *MEASURES]].itertuples(index=False):
        if np.isfinite((position, force)).all():
            panel.plot(position, force, linestyle="none", **marker(law))
    panel.set(xscale="log", yscale="log")


def map_figure(judged: pd.DataFrame, cell: str) -> Figure:
    """Return two maps of a cell over trials and laws: tracking and internal force."""
    mine = judged[judged["cell"] == cell]
    laws = [law for law in LAWS if law in set(mine["law"])]
    most = max(
        laws, key=lambda law: (mine["law"] == law).sum()
    )  # a law with a wrist sensor is in every trial
    trials = mine.loc[mine["law"] == most, "trial"].tolist()
    refused = set(mine.loc[mine["why"] == "FieldError", ["trial", "law"]].itertuples(index=False, name=None))
    with styled():
        size = (1.9 + 1.04 * len(laws), 1.3 + 0.22 * len(trials))
        figure = Figure(figsize=size, layout="constrained")
        for panel, (name, title) in zip(figure.subplots(1, 2, sharey=True), MEASURES.items(), strict=True):
            table = mine.pivot(index="trial", columns="law", values=name).reindex(index=trials, columns=laws)
            draw_map(panel, table, refused)
            panel.set_title(f"{TITLES[cell]}: {title}", loc="left", fontsize=9.0)
    return figure


def draw_map(panel: Axes, table: pd.DataFrame, refused: set[tuple[str, str]]) -> None:
    """Draw a table as a map; values within a tenth of a row's least are bold, inf stands for failed runs."""
    values = table.to_numpy()
    shown = np.where(np.isfinite(values), values, np.nan)
    panel.set_facecolor("#f3f4f6")
    panel.imshow(shown, norm=LogNorm(1e-2, 1e2, clip=True), cmap="RdYlBu_r", aspect="auto")
    slanted: Any = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"}
    panel.set_xticks(range(table.shape[1]), map(named, table.columns), **slanted)
    panel.axvline(UNSENSED - 0.5, color="white", linewidth=4.0)
    panel.set_yticks(range(table.shape[0]), table.index)
    panel.tick_params(length=0.0)
    panel.grid(visible=False)
    for i, row in enumerate(values):
        for j, value in enumerate(row):
            best = np.isfinite(value) and value <= 1.1 * np.nanmin(row)
            failed = "refused" if (table.index[i], table.columns[j]) in refused else "fails"
            text = "–" if np.isnan(value) else failed if np.isinf(value) else written(value)
            dark = np.isfinite(value) and not 2e-2 < value < 20.0
            style: Any = {"color": "white" if dark else "black", "weight": "bold" if best else "normal"}
            panel.text(j, i, text, ha="center", va="center", fontsize=6.5, **style)


def named(law: str) -> str:
    """Return the name of a law as the figures show it."""
    return law.replace("alpha 0", "α = 0").replace("K_f", "$K_f$")


def written(value: float) -> str:
    """Return a value with two digits, at most four characters."""
    if value >= 1000.0:
        return f"{value / 1000.0:.0f}k" if value < 1e6 else ">1M"
    return f"{value:.0f}" if value >= 10.0 else f"{value:.1f}" if value >= 1.0 else f"{value:.2g}".lstrip("0")


QUOTED = (
    "nominal",
    "bias 1 mm",
    "unknown load",
    "base turned by 1 mrad",
    "friction, stiction",
    "all at once, moderate",
)


def table(judged: pd.DataFrame, cell: str) -> str:
    """Return position error, mm, and internal-force error, N, of each law in some trials, as Markdown."""
    mine = judged[judged["cell"] == cell].set_index(["law", "trial"])
    lines = [f"| {TITLES[cell]} | {' | '.join(QUOTED)} |", "| --- |" + " --- |" * len(QUOTED)]
    for law in filter(set(judged.loc[judged["cell"] == cell, "law"]).__contains__, LAWS):
        pairs = mine.loc[[(law, trial) for trial in QUOTED], list(MEASURES)].to_numpy()
        lines.append(f"| {named(law)} | {' | '.join(' / '.join(map(written, pair)) for pair in pairs)} |")
    return "\n".join(lines)


LETTERS = {
    "controller.gains.pose_gain": "$\\gamma$",
    "controller.gains.sign_gain": "$\\alpha$",
    "controller.gains.force_gain": "$K_f$",
    "controller.gains.anchor_gain": "$g$",
    "controller.gains.leak": "$\\lambda$",
    "controller.switching.width": "$w$",
}
"""Letters of the tuned fields."""


def gains_table(gains: pd.DataFrame) -> str:
    """Return the tuned gains of each law in each cell, as Markdown."""
    lines = [f"| law | {' | '.join(TITLES.values())} |", "| --- |" + " --- |" * len(TITLES)]
    for law in LAWS:
        mine = gains[gains["law"] == law]
        parts = [mine.loc[mine["cell"] == cell, ["field", "value"]] for cell in TITLES]
        cells = [
            ", ".join(f"{LETTERS[field]} {value:.3g}" for field, value in part.itertuples(index=False))
            for part in parts
        ]
        lines.append(f"| {named(law)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def numbers(data: Path) -> str:
    """Return the tables that the page of the front quotes, and the tuned gains."""
    judged, gains = read(data, "judged"), read(data, "gains")
    tables = [table(judged, cell) for cell in TITLES if cell in set(judged["cell"])]
    return "\n\n".join([*tables, gains_table(gains)])


def draw(data: Path, images: Path) -> Iterable[Path]:
    """Save the figures of the tables in a folder, and return their files."""
    judged, tuning = read(data, "judged"), read(data, "tuning")
    saved = [save_image(front_figure(judged, tuning), images / "study-front")]
    for cell in TITLES:
        if cell in set(judged["cell"]):
            saved.append(save_image(map_figure(judged, cell), images / f"study-front-{cell}"))
    return saved
