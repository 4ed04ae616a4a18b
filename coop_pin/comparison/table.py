"""Table of a comparison: medians with bootstrap intervals, ranks, and the table as text, CSV and page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from coop_pin.arrays import Array, require_path
from coop_pin.comparison.measures import MEASURES
from coop_pin.errors import NameNotFoundError

COLUMNS = (*MEASURES, "settling_time_s")
"""Measures of the table."""
CELL = ("scenario", "controller", "trial")
"""What names a cell of the table."""
_RESAMPLES = 1000
_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Controllers compared</title>
<style>body{font:14px sans-serif}table{border-collapse:collapse}
td,th{padding:2px 8px;text-align:right;white-space:nowrap}td:last-child{text-align:left}
th{cursor:pointer;position:sticky;top:0;background:#eee}tr:nth-child(even){background:#f7f7f7}</style>
<p>One row for each scenario, controller and trial: what the law has besides its own arm's joints, which
gains, numbers of runs, finished and trustworthy; medians and 95 % intervals of the measures.
Click a heading to sort by it; inf is a failed run.</p>
TABLE
<script>
document.querySelectorAll("th").forEach((head, column) => head.onclick = () => {
  const body = document.querySelector("tbody"), up = head.dataset.up = head.dataset.up === "1" ? "0" : "1";
  const key = row => { const t = row.cells[column].textContent.replace("inf", "Infinity");
                       return isNaN(t) ? t : Number(t); };
  [...body.rows].sort((a, b) => { const [x, y] = [key(a), key(b)];
    return (x < y ? -1 : x > y ? 1 : 0) * (up === "1" ? 1 : -1); }).forEach(row => body.append(row));
});
</script></html>
"""
"""Page of the table; TABLE stands for it."""


class Comparison:
    """Table of controllers by scenarios and trials.

    Attributes:
        data: for each measure its ``<measure>``, the median over the seeds, with ``<measure>_low`` and
            ``<measure>_high``, the bootstrap interval of the median at 95 %; ``runs``, ``finished`` and
            ``trustworthy`` count; ``information`` is what the law has besides its own arm's joints,
            ``gains`` is "tuned", "untuned" or "given", ``failure`` the first failed run's error; dimensions
            scenario, controller, trial. A failed run has the measure inf, a cell that was not run nan.
    """

    def __init__(self, data: xr.Dataset) -> None:
        self.data = data

    @classmethod
    def of_cells(cls, cells: pd.DataFrame) -> Comparison:
        """Return the comparison of some cells, one row for each; the order of names is that of the rows."""
        order = {name: list(dict.fromkeys(cells.index.get_level_values(name))) for name in CELL}
        return cls(cells.to_xarray().reindex(order))

    @property
    def table(self) -> pd.DataFrame:
        """One row for each scenario, controller and trial that was run."""
        frame = self.data.to_dataframe().dropna(subset=["runs"])
        return frame.astype(dict.fromkeys(("runs", "finished", "trustworthy"), int))

    def write_csv(self, path: str | Path) -> None:
        """Write the table; the same runs give the same bytes."""
        require_path("path", path)
        self.table.to_csv(path, float_format="%.9g", lineterminator="\n")

    def write_html(self, path: str | Path) -> None:
        """Write the table as one page that sorts by a click on a column and loads nothing from elsewhere."""
        require_path("path", path)
        body = self.table.reset_index().to_html(index=False, float_format="{:.4g}".format, border=0)
        Path(path).write_text(_PAGE.replace("TABLE", body), encoding="utf-8")

    def ranks(self, measure: str = "tracking_rms_mm", *, seed: int = 0) -> pd.DataFrame:
        """Return the mean rank of each controller over all scenarios and trials, with its 95 % interval.

        Controllers with equal values share their mean rank; trials are resampled for the interval.

        Args:
            measure: a measure.
            seed: of the bootstrap.

        Raises:
            NameNotFoundError: there is no such measure.
        """
        if measure not in COLUMNS:
            raise NameNotFoundError("measure", measure, COLUMNS, "the comparison")
        cells = self.data[measure].stack(place=("scenario", "trial")).transpose("place", "controller")
        ran = self.data["runs"].stack(place=("scenario", "trial")).transpose("place", "controller")
        complete = np.isfinite(ran.values).all(axis=1)
        ranks = pd.DataFrame(cells.values[complete]).rank(axis=1).to_numpy()
        low, high = bootstrap_interval(ranks, np.mean, seed)
        columns = {"rank": ranks.mean(axis=0), "low": low, "high": high}
        return pd.DataFrame(columns, index=cells["controller"].values).sort_values("rank", kind="stable")

    def summary(self) -> str:
        """Return for each scenario tracking in mm and internal force in N, controllers by trials, as text.

        A star marks cells whose runs are not all trustworthy; failed runs are listed below.
        """
        force = (self.data["axial_rms_N"] ** 2 + self.data["shear_rms_N"] ** 2) ** 0.5
        lines = []
        for scenario in self.data["scenario"].values:
            own = self.data.sel(scenario=scenario)
            texts = {
                str(trial): [
                    _cell_text(own, force.sel(scenario=scenario), controller, trial)
                    for controller in self.data["controller"].values
                ]
                for trial in self.data["trial"].values
            }
            frame = pd.DataFrame(texts, index=self.labels(scenario))
            lines += [f"{scenario}: tracking mm / internal force N", frame.T.to_string(), ""]
            lines += [f"{seen}: {', '.join(names)}" for seen, names in self._classes(scenario).items()]
            lines.append("")
        return "\n".join(lines + self._failures())

    def information(self, scenario: str) -> list[str]:
        """Return what each controller has in a scenario besides its own arm's joints."""
        seen = self.data["information"].sel(scenario=scenario).transpose("controller", "trial").values
        return [next((name for name in row if isinstance(name, str)), "") for row in seen]

    def _classes(self, scenario: str) -> dict[str, list[str]]:
        """Return the controllers of each class of information."""
        classes = dict[str, list[str]]()
        for name, seen in zip(self.data["controller"].values, self.information(scenario), strict=True):
            classes.setdefault(seen, []).append(str(name))
        return classes

    def _failures(self) -> list[str]:
        """Return a line for each error of a controller in a scenario, with the trials in which it occurs."""
        failed = self.table.query("finished < runs").reset_index()
        return [
            f"{scenario} | {controller} failed in {', '.join(part['trial'])} "
            f"({part['runs'].sum() - part['finished'].sum()} of {part['runs'].sum()} runs): {reason}"
            for (scenario, controller, reason), part in failed.groupby([*CELL[:2], "failure"], sort=False)
        ]

    def labels(self, scenario: str) -> list[str]:
        """Return the names of the controllers, with a mark where one runs untuned in a scenario."""
        used = self.data["gains"].sel(scenario=scenario).transpose("controller", "trial").values
        marks = (" (untuned)" if "untuned" in row else "" for row in used)
        return [f"{name}{mark}" for name, mark in zip(self.data["controller"].values, marks, strict=True)]


def bootstrap_interval(samples: Array, statistic: Any, seed: int) -> tuple[Array, Array]:
    """Return the 95 % bootstrap interval of a statistic over the first axis; resamples are seeded."""
    rng = np.random.default_rng(seed)
    drawn = rng.integers(len(samples), size=(_RESAMPLES, len(samples)))
    spread = statistic(samples[drawn], axis=1)
    # By order, not by interpolation: failed runs are infinite.
    low, high = np.quantile(spread, (0.025, 0.975), axis=0, method="nearest")
    return low, high


def _cell_text(own: xr.Dataset, force: xr.DataArray, controller: Any, trial: Any) -> str:
    cell = own.sel(controller=controller, trial=trial)
    if not np.isfinite(cell["runs"]):
        return "-"
    if not np.isfinite(cell["tracking_rms_mm"]):
        return "failed"
    mark = "" if cell["trustworthy"] == cell["runs"] else " *"
    newtons = float(force.sel(controller=controller, trial=trial))
    return f"{float(cell['tracking_rms_mm']):.2g} / {newtons:.2g}{mark}"
