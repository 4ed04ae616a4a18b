"""Results of a sweep, finished or not: the files of its table, and its single runs."""

from __future__ import annotations

import contextlib
import functools
import json
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np

from coop_pin.base.arrays import require_path, require_type
from coop_pin.base.errors import CodeChangedError, FieldError, OutOfRangeError
from coop_pin.base.loaded_code import edited_files, loaded_digests
from coop_pin.base.source_code import file_digest
from coop_pin.description.scenario import Scenario
from coop_pin.results.metrics import METRIC_TEXTS, SIMULATION_SOUND, TASK_KEPT, measure_text
from coop_pin.results.netcdf import written_netcdf
from coop_pin.results.run_result import RunResult
from coop_pin.running.run_scenario import run
from coop_pin.sweeps.analysis import SweepTable
from coop_pin.sweeps.heat_map import wanted_squeeze, write_heat_map
from coop_pin.sweeps.run_key import code_for, require_unchanged, run_key
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.table import MISSING, OK, TIMES, PointResult, describe

_LOG = logging.getLogger("coop_pin.sweeps")
_EDITED = (
    "%s changed after the runs, or cannot be found here: start the sweep again for runs of the new code, or"
    " undo the edit"
)


class SweepResult(SweepTable):
    """Results of a sweep, or of a part of it: its table, its files, and its runs."""

    @classmethod
    def load(cls, folder: str | Path) -> Self:
        """Read the folder of a sweep, finished or not; another process may be writing it.

        Raises:
            FileReadError: the folder is not that of a sweep of this version of coop_pin.
        """
        require_path("folder", folder)
        store = SweepStore(folder)
        if edited := store.edited():
            _LOG.warning(_EDITED, ", ".join(edited))
        return cls(store.read_plan(), store)

    # ------------------------------------------------------------ tables

    def write_tables(self) -> None:
        """Write table.csv and table.nc, and times.csv apart from them; FileWriteError on a full disk.

        tables.json has digests of the tables and of what they were made from; while they hold, nothing is
        read but for these.
        """
        folder = self.store.folder
        seal = folder / "tables.json"
        if seal.is_file() and seal.read_bytes() == self._seal():
            return
        without_times = self.table.drop(columns=TIMES)
        for name, table in (("times.csv", self.table[[*TIMES, "key"]]), ("table.csv", without_times)):
            self.store.write_with(folder / name, functools.partial(table.to_csv, lineterminator="\n"))
        write_table = functools.partial(Path.write_bytes, data=written_netcdf(self.data).getbuffer())
        self.store.write_with(folder / "table.nc", write_table)
        self.store.write_changed(seal, self._seal())

    def _seal(self) -> bytes:
        """Return the digests of the tables, the plan and the stored runs, as JSON."""
        names = ("plan.json", "table.csv", "table.nc", "times.csv")
        paths = [path for path in (self.store.folder / name for name in names) if path.is_file()]
        return json.dumps({path.name: file_digest(path) for path in paths + self.store.segments()}).encode()

    def write_html(self, path: str | Path, metric: str = "internal_force_error_max_N") -> None:
        """Write all runs as one page that is explored: a heat map with filters, which loads nothing.

        Args:
            path: the page.
            metric: metric that it shows first, if the runs have it; the others can be chosen.

        Raises:
            FieldError: no field varies.
        """
        require_path("path", path)
        dims = list(map(str, self.data["number"].dims))
        if not dims:
            raise FieldError("has one run only; a map needs a field that varies", "the sweep")
        command = f'coop-pin sweep-show "{self.store.folder.as_posix()}" --page "{path}" --replay {{numbers}}'
        names = sorted(self.metric_names, key=lambda name: name != metric)
        runs = self.table.reset_index()
        for mark, verdict in (("unsound", SIMULATION_SOUND), ("unkept", TASK_KEPT)):
            runs[mark] = (runs["status"] == OK) & (runs.get(verdict, 1.0) == 0.0)
        runs["failure"] = runs["failure"].where(
            runs["failure"] == "", runs["failure"] + ": " + runs["message"]
        )
        shown = [name for name in names if np.isfinite(runs[name]).any()]
        for name in shown:
            runs[name] = runs[name] * METRIC_TEXTS[name][2] if name in METRIC_TEXTS else runs[name]
        write_heat_map(
            runs,
            Path(path),
            title=f"sweep of {', '.join(self.plan.base)}",
            names=dims,
            rivals=dims,
            measures={name: measure_text(name) for name in shown},
            forces=[
                name for name in shown if "internal" in name and name.endswith(("error_N", "error_max_N"))
            ],
            squeezes=self._wanted(runs["number"].to_list()),
            notes=(
                *(str(name) for name in self.data.coords if name not in dims),
                "number",
                "status",
                "merged",
            ),
            command=command,
            replay="run-{numbers}",
        )

    def _wanted(self, numbers: Sequence[int]) -> list[float]:
        """Return the squeeze that is wanted in each run, N."""
        base = {name: wanted_squeeze(scenario) for name, scenario in self.plan.base.items()}
        points = [self.plan[number] for number in numbers]
        varied = [any(path.split(".")[0] == "squeeze" for path in point.changes) for point in points]
        scenarios = [
            self.plan.resolved(point) if is_varied else None
            for point, is_varied in zip(points, varied, strict=True)
        ]
        return [
            wanted_squeeze(scenario) if isinstance(scenario, Scenario) else base[point.base]
            for point, scenario in zip(points, scenarios, strict=True)
        ]

    # ------------------------------------------------------------ single runs

    def point(self, number: int) -> PointResult:
        """Return the parameters and metrics of one run; negative numbers count from the end of the plan."""
        return self._points([self._number(number)])[0]

    def open(self, number: int) -> RunResult:
        """Return one run as a full result, which is simulated again unless it was stored.

        Raises:
            CodeChangedError: the user's code that would run is not that of the table.
            CoopPinError: the run fails.
        """
        number, plan = self._number(number), self.plan
        key = self.table["key"][number]
        if (result := self.store.read_result(key)) is not None:
            return result
        scenario = plan.scenario(number)
        code = code_for(scenario, plan.metrics, loaded_digests)
        require_unchanged(code)
        if code and run_key(scenario, plan.metrics, code, engine=plan.engine) != key:
            (name, _), *_ = code
            raise CodeChangedError(name, edited_files(name) or self.store.edited())
        return run(scenario, warn=False)

    def _number(self, number: int) -> int:
        require_type("number", number, int, np.integer)
        with contextlib.suppress(IndexError, OverflowError):
            if (point := self.plan[int(number)].number) in self.table.index:
                return point
        nearest = max(-sys.maxsize, min(number, sys.maxsize))
        raise OutOfRangeError("number", nearest, f"a run of this table, of the plan's {len(self.plan)}")

    def summary(self) -> str:
        """Return the plan, the number of runs by status, the failures and the metrics' ranges as text."""
        lines = describe(self.table, self.metric_names)
        if self.counts()[MISSING] and (edited := self.store.edited()):
            lines.insert(1, f"  {_EDITED % ', '.join(edited)}")
        if idle := self.fields_without_effect():
            lines.insert(1, f"  no effect on any metric here: {', '.join(idle)}")
        return "\n".join([self.plan.summary(), *lines])

    __repr__ = summary
