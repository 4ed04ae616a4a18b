"""Table of all runs of a plan, read from the store in one pass: columns, an xarray Dataset, and CSV files."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from coop_pin.arrays import Array
from coop_pin.errors import ScenarioError
from coop_pin.results.metrics import NO_STEADY_METRICS
from coop_pin.sweeps.dimensions import Dimension
from coop_pin.sweeps.job import Record
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.run_key import run_key, unresolved_key
from coop_pin.sweeps.store import SweepStore

OK, FAILED, MISSING = "ok", "failed", "missing"
_TRUSTWORTHY = "trustworthy"


def point_key(plan: SweepPlan, index: int) -> str:
    """Return the key of a point's run."""
    try:
        return run_key(plan.scenario(index), plan.metrics)
    except ScenarioError:
        point = plan[index]
        return unresolved_key(plan.base[point.base], point.changes)


class PointResult(NamedTuple):
    """One run of a sweep.

    Attributes:
        number: its place in the plan, counted from 0; ``open`` takes it.
        parameters: values of the varied fields.
        metrics: metrics by name.
    """

    number: int
    parameters: dict[str, Any]
    metrics: dict[str, float]


class PointFailure(NamedTuple):
    """One run of a sweep that failed.

    Attributes:
        number: its place in the plan, counted from 0.
        parameters: values of the varied fields.
        kind: name of the error's class.
        message: its message.
    """

    number: int
    parameters: dict[str, Any]
    kind: str
    message: str


class Table(NamedTuple):
    """Columns with one entry for each point of a plan, in its order.

    Attributes:
        plan: the plan.
        keys: keys of the runs.
        status: "ok", "failed" or "missing".
        reasons: kind and message of the errors of failed runs, by the number of the point.
        failed_at: simulated time of a divergence, s; otherwise NaN.
        metrics: metrics by name; NaN where a run has none.
        times: wall_s and cpu_s.
    """

    plan: SweepPlan
    keys: list[str]
    status: Any
    reasons: dict[int, tuple[str, str]]
    failed_at: Array
    metrics: dict[str, Array]
    times: dict[str, Array]

    @classmethod
    def read(cls, plan: SweepPlan, store: SweepStore) -> Table:
        """Read the runs of a plan; those whose lines are damaged count as missing."""
        n = len(plan)
        keys = [point_key(plan, number) for number in range(n)]
        places: dict[str, list[int]] = {}
        for number, key in enumerate(keys):
            places.setdefault(key, []).append(number)
        times = {"wall_s": np.full(n, np.nan), "cpu_s": np.full(n, np.nan)}
        table = cls(plan, keys, np.full(n, MISSING, dtype="<U7"), {}, np.full(n, np.nan), {}, times)
        ranks: dict[str, tuple[int, int]] = {}
        for record in store.records():
            for place in places.get(record.key, ()):
                table._enter(place, record)
                for rank, name in enumerate(record.metrics):
                    ranks[name] = min(ranks.get(name, (n, 0)), (place, rank))
        if _TRUSTWORTHY in table.metrics:
            table.metrics[_TRUSTWORTHY][table.status == FAILED] = 0.0
        # in the order of the first run that has them, whichever run ended first
        return table._replace(
            metrics={name: table.metrics[name] for name in sorted(ranks, key=ranks.__getitem__)}
        )

    def _enter(self, place: int, record: Record) -> None:
        """Enter a record; a later one of the same run replaces it."""
        self.status[place] = OK if record.failure is None else FAILED
        self.reasons.pop(place, None)
        if record.failure is not None:
            self.reasons[place] = record.failure.kind, record.failure.message
            self.failed_at[place] = record.failure.numbers.get("time", np.nan)
        for name, value in record.metrics.items():
            if name not in self.metrics:
                self.metrics[name] = np.full(len(self.keys), np.nan)
            self.metrics[name][place] = value
        for name, column in self.times.items():
            column[place] = record.times.get(name, np.nan)

    def dataset(self) -> xr.Dataset:
        """Return all runs with the plan's dimensions.

        Variables: every metric of the finished runs (not a number where a run failed or is missing, but the
        ``trustworthy`` of a failed one is 0), ``status`` ("ok", "failed", "missing"), ``failure`` (name of
        the error), ``failed_at_s`` (simulated time of a divergence) and ``number`` (place in the plan).
        """
        kinds = np.full(len(self.keys), "", dtype=object)
        for place, (kind, _) in self.reasons.items():
            kinds[place] = kind
        columns = {
            **self.metrics,
            "status": self.status,
            "failure": kinds.astype(str),
            "failed_at_s": self.failed_at,
            "number": np.arange(len(self.keys)),
        }
        dims = [dimension.name for dimension in self.plan.dimensions]
        data = {name: (dims, values.reshape(self.plan.shape)) for name, values in columns.items()}
        coordinates = [_coordinates(dimension) for dimension in self.plan.dimensions]
        return xr.Dataset(data, {name: label for each in coordinates for name, label in each.items()})

    def write_csv(self, path: Path) -> None:
        """Write one line for each run; numbers read back exactly."""
        head = ["point", *self.plan[0].parameters, "status", "failure", "message", *self.metrics, "key"]
        _write_lines(path, head, map(self._line, range(len(self.keys))))

    def _line(self, place: int) -> list[Any]:
        is_ok, is_missing = self.status[place] == OK, self.status[place] == MISSING
        values = [
            float(column[place]) if is_ok or (name == _TRUSTWORTHY and not is_missing) else ""
            for name, column in self.metrics.items()
        ]
        reason = self.reasons.get(place, ("", ""))
        parameters = self.plan[place].parameters.values()
        return [place, *parameters, self.status[place], *reason, *values, self.keys[place]]

    def write_times(self, path: Path) -> None:
        """Write the duration of each run; metrics, unlike durations, are the same on every machine."""
        columns = zip(
            range(len(self.keys)), *(c.tolist() for c in self.times.values()), self.keys, strict=True
        )
        _write_lines(path, ["point", *self.times, "key"], columns)


def describe(metrics: Mapping[str, Array]) -> list[str]:
    """Return lines about the metrics of finished runs: doubtful runs, values that are none, and ranges."""
    none = np.empty(0)
    starts, ends = (metrics.get(f"window_{end}_s", none) for end in ("start", "end"))
    doubts = {
        "NOT TRUSTWORTHY: trustworthy = 0; open(number).verdict() says why": metrics.get("trustworthy", none)
        == 0,
        "never settled: settling_time_s is infinite": np.isposinf(metrics.get("settling_time_s", none)),
        f"without steady metrics: {NO_STEADY_METRICS}": ends <= starts,
    }
    lines = [f"  {np.count_nonzero(runs)} {text}" for text, runs in doubts.items() if runs.any()]
    empty = {name: np.count_nonzero(np.isnan(values)) for name, values in metrics.items()}
    if any(empty.values()):
        named = ", ".join(f"{name} ({count})" for name, count in empty.items() if count)
        lines.append(f"  not a number, by the number of finished runs: {named}")
    for name, values in metrics.items():
        if (finite := values[np.isfinite(values)]).size:
            span = f"{finite.min():>11.4g} .. {finite.max():<11.4g}"
            lines.append(f"  {name:<30} {span} median {np.median(finite):.4g}")
    return lines


def _coordinates(dimension: Dimension) -> dict[str, tuple[str, Any]]:
    """Return the coordinates along a dimension: its own labels, and those of fields that vary with it."""
    labels = [dimension.labels(place) for place in range(dimension.size)]
    return {name: (dimension.name, np.array([place[name] for place in labels])) for name in labels[0]}


def _write_lines(path: Path, head: list[str], lines: Iterable[Iterable[Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *(map(_text, line) for line in lines)])


def _text(value: Any) -> str:
    return repr(value) if isinstance(value, float) else str(value)
