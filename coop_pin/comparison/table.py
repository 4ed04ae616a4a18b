"""Table of a comparison: medians with bootstrap intervals, ranks, and the table as text, CSV and page."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from coop_pin.base.arrays import Array, as_count, require_path, require_type
from coop_pin.base.errors import FileReadError, InvalidStateError, NameNotFoundError
from coop_pin.base.user_files import read_user_file
from coop_pin.comparison.measures import DROPPED, MEASURES
from coop_pin.results.run_result import RunResult
from coop_pin.sweeps.heat_map import cell_names, cell_text, wanted_squeeze, write_heat_map
from coop_pin.sweeps.result import SweepResult

COLUMNS = MEASURES | {"settling_time_s": "settling time (s)"}
"""Measures of the table, with their texts."""
CELL = ("scenario", "controller", "trial")
"""What names a cell of the table."""
_FORCES = ("axial_rms_N", "shear_rms_N")
_RESAMPLES = 1000
_VERDICTS = ("sound", "kept")
"""Numbers of good verdicts; NaN in a table of runs that had none."""
_COUNTS = ("runs", "finished", DROPPED, "merged")
_TEXTS = (*CELL, "information", "gains", "engine", "failure")
_BYTES = 1 << 28
"""Largest table that is read."""


class Comparison:
    """Table of controllers by scenarios and trials.

    Attributes:
        data: table with ``<measure>`` of each measure, the median over the seeds, with ``<measure>_low`` and
            ``<measure>_high``, the bootstrap interval of the median at 95 %; numbers of ``runs``, of those
            ``finished``, of ``sound`` simulations, of tasks ``kept``, ``dropped`` those that lost a payload
            held by friction, ``merged`` those taken over from other folders; ``information`` is what the law
            has besides its own arm's joints, ``gains`` is "tuned", "untuned" or "given", ``engine`` what
            computed the runs, ``failure`` the first failed run's error; dimensions scenario, controller,
            trial. A failed run has the measure inf, a cell that was not run nan.
        folder: folder of the runs; None if there is only the table.
    """

    def __init__(self, data: xr.Dataset, folder: Path | None = None) -> None:
        self.data, self.folder = data, folder

    @classmethod
    def of_cells(cls, cells: pd.DataFrame, folder: Path | None = None) -> Comparison:
        """Return the comparison of some cells, one row for each; the order of names is that of the rows."""
        order = {name: list(dict.fromkeys(cells.index.get_level_values(name))) for name in CELL}
        return cls(cells.to_xarray().reindex(order), folder)

    @classmethod
    def load(cls, path: str | Path) -> Comparison:
        """Read a comparison from its folder, or from the CSV of one.

        Raises:
            FileReadError: there is no such table, or it is not one of a comparison.
        """
        require_path("path", path)
        folder = Path(path) if Path(path).is_dir() else None
        file = Path(path) if folder is None else folder / "comparison.csv"
        content = read_user_file(file, limit=_BYTES, kind="the table of a comparison")
        try:
            cells = pd.read_csv(io.BytesIO(content), keep_default_na=False, dtype=dict.fromkeys(_TEXTS, str))
            absent = {"engine": "", **dict.fromkeys(_VERDICTS, np.nan)}
            cells = cells.assign(**{name: value for name, value in absent.items() if name not in cells})
            cells = cells.astype(dict.fromkeys((*_COUNTS, *_VERDICTS, *COLUMNS), float))
            return cls.of_cells(cells.set_index(list(CELL)), folder)
        except (KeyError, ValueError) as error:
            reason = f"is not a table of this version ({error}); repeat it with coop-pin compare"
            raise FileReadError(reason, str(file)) from None

    def open(self, scenario: str, controller: str, trial: str, *, seed: int = 0) -> RunResult:
        """Return one run as a full result; it is simulated again, as the folder's plan says.

        Args:
            scenario: name.
            controller: name.
            trial: name.
            seed: seed of a random trial.

        Raises:
            InvalidStateError: only the table is known, not the folder of the runs.
            NameNotFoundError: there is no such scenario, controller or trial, or it was not run.
            OutOfRangeError: the trial has fewer seeds.
            CoopPinError: the run fails; ``error.result`` holds what was computed.
        """
        if self.folder is None:
            raise InvalidStateError("only the table of this comparison is known; load the folder of its runs")
        for kind, name in zip(CELL, (scenario, controller, trial), strict=True):
            self._require_name(kind, name)
        case = cell_text((controller, trial))
        for file in sorted((self.folder / scenario).glob("*/plan.json")):
            whole = SweepResult.load(file.parent)
            if case in whole.plan.cases["run"]:
                return SweepResult(whole.plan.part([case], whole.plan.engine), whole.store).open(seed)
        raise NameNotFoundError("run", case, [], str(self.folder / scenario))

    @property
    def table(self) -> pd.DataFrame:
        """One row for each scenario, controller and trial that was run."""
        frame = self.data.to_dataframe().dropna(subset=["runs"])
        return frame.astype(dict.fromkeys(_COUNTS, int))

    def write_csv(self, path: str | Path) -> None:
        """Write the table; the same runs give the same bytes."""
        require_path("path", path)
        self.table.to_csv(path, float_format="%.9g", lineterminator="\n")

    def write_html(self, path: str | Path, *, squeezes: Mapping[str, float] | None = None) -> None:
        """Write the table as one page that is explored: a heat map with filters, which loads nothing.

        Args:
            path: the page.
            squeezes: desired internal force by scenario, N, of which errors of the force are shown as shares;
                where it is omitted, and for others, that of the folder's runs.
        """
        require_path("path", path)
        table = self.table.reset_index()
        table["unsound"], table["unkept"] = table["sound"] < table["runs"], table["kept"] < table["runs"]
        command = "coop-pin compare {scenario} --controllers {controller} --trials {trial}"
        if self.folder is not None:
            command = f'coop-pin compare --out "{self.folder.as_posix()}" --replay {{cells}}'
        several = {"merged": table["merged"].any(), "engine": table["engine"].nunique() > 1}
        first = {name: text for name, text in COLUMNS.items() if name in _FORCES}  # what the motion hides
        desired = self._wanted(table["scenario"].unique())
        stated = squeezes or {}
        tuned = ", each with gains tuned for its cell" * bool((table["gains"] == "tuned").all())
        write_heat_map(
            table,
            Path(path),
            title=f"{self.data.sizes['controller']} controllers compared{tuned}",
            names=CELL,
            rivals=["controller"],
            measures=first | COLUMNS,
            forces=_FORCES,
            squeezes=[
                stated.get(cell[0], desired.get(tuple(cell), np.nan)) for cell in table[list(CELL)].to_numpy()
            ],
            filters=["information", *(name for name, is_told in several.items() if is_told)],
            notes=("gains", "engine", *_COUNTS, *_VERDICTS),
            command=command,
        )

    def _wanted(self, scenarios: Sequence[str]) -> dict[tuple[str, ...], float]:
        """Return the squeeze that is wanted in each cell whose scenario is known, N."""
        squeezes = dict[tuple[str, ...], float]()
        for name in scenarios:
            plans = [] if self.folder is None else sorted((self.folder / name).glob("*/plan.json"))
            for file in plans:
                plan = SweepResult.load(file.parent).plan
                base = wanted_squeeze(next(iter(plan.base.values())))
                for case, changes in plan.cases["run"].items():
                    is_other = any(path.split(".")[0] == "squeeze" for path in changes)
                    part = plan.part([case], plan.engine) if is_other else None
                    squeezes[name, *cell_names(case)] = wanted_squeeze(part.scenario(0)) if part else base
        return squeezes

    def ranks(self, measure: str = "tracking_rms_mm", *, seed: int = 0) -> pd.DataFrame:
        """Return the mean rank of each controller over all scenarios and trials, with its 95 % interval.

        Controllers with equal values share their mean rank; trials are resampled for the interval.

        Args:
            measure: a measure.
            seed: seed of the bootstrap.

        Raises:
            NameNotFoundError: there is no such measure.
        """
        require_type("measure", measure, str)
        seed = as_count("seed", seed)
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

        A star marks cells with a simulation that is not sound, a dagger those with a task that is not kept, #
        cells with merged runs; failures are listed.
        "dropped" stands where half of the runs or more lost the payload.
        """
        force = (self.data["axial_rms_N"] ** 2 + self.data["shear_rms_N"] ** 2) ** 0.5
        lines = []
        for scenario in self.data["scenario"].values:
            data = self.data.sel(scenario=scenario)
            texts = {
                str(trial): [
                    _cell_text(data, force.sel(scenario=scenario), controller, trial)
                    for controller in self.data["controller"].values
                ]
                for trial in self.data["trial"].values
            }
            frame = pd.DataFrame(texts, index=self.labels(scenario))
            lines += [f"{scenario}: tracking mm / internal force N", frame.T.to_string(), ""]
            classes = dict[str, list[str]]()
            for name, kind in zip(self.data["controller"].values, self.information(scenario), strict=True):
                classes.setdefault(kind, []).append(str(name))
            lines += [f"{kind}: {', '.join(names)}" for kind, names in classes.items()]
            lines.append("")
        return "\n".join(lines + self._failures())

    __repr__ = summary

    def _require_name(self, kind: str, name: str) -> None:
        """Refuse a scenario, controller or trial that is none of the comparison."""
        require_type(kind, name, str)
        if name not in (known := self.data[kind].values.tolist()):
            raise NameNotFoundError(kind, name, known, "the comparison")

    def information(self, scenario: str) -> list[str]:
        """Return what each controller has in a scenario besides its own arm's joints.

        Raises:
            NameNotFoundError: there is no such scenario.
        """
        self._require_name("scenario", scenario)
        information = self.data["information"].sel(scenario=scenario).transpose("controller", "trial").values
        return [next((name for name in row if isinstance(name, str)), "") for row in information]

    def _failures(self) -> list[str]:
        """Return a line for each error of a controller in a scenario, with the trials in which it occurs."""
        failed = self.table.query("finished < runs").reset_index()
        return [
            f"{scenario} | {controller} failed in {', '.join(part['trial'])} "
            f"({part['runs'].sum() - part['finished'].sum()} of {part['runs'].sum()} runs): {reason}"
            for (scenario, controller, reason), part in failed.groupby([*CELL[:2], "failure"], sort=False)
        ]

    def labels(self, scenario: str) -> list[str]:
        """Return the names of the controllers, with a mark where one runs untuned in a scenario.

        Raises:
            NameNotFoundError: there is no such scenario.
        """
        self._require_name("scenario", scenario)
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


def _cell_text(data: xr.Dataset, force: xr.DataArray, controller: Any, trial: Any) -> str:
    cell = data.sel(controller=controller, trial=trial)
    if not np.isfinite(cell["runs"]):
        return "-"
    if not np.isfinite(cell["tracking_rms_mm"]):
        return "failed"
    marks = {" *": cell["sound"] < cell["runs"], " †": cell["kept"] < cell["runs"], " #": cell["merged"] > 0}
    mark = "".join(text for text, applies in marks.items() if applies)
    if 2.0 * cell[DROPPED] >= cell["finished"]:
        return f"dropped{mark}"
    newtons = float(force.sel(controller=controller, trial=trial))
    return f"{float(cell['tracking_rms_mm']):.2g} / {newtons:.2g}{mark}"
