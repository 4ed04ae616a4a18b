"""Table of all runs of a plan: an xarray Dataset with the plan's dimensions, and CSV files."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from coop_pin.errors import FileReadError, ScenarioError
from coop_pin.sweeps.dimensions import Dimension
from coop_pin.sweeps.plan import Point, SweepPlan
from coop_pin.sweeps.record import Record
from coop_pin.sweeps.run_key import run_key, unresolved_key
from coop_pin.sweeps.store import SweepStore

OK, FAILED, MISSING = "ok", "failed", "missing"
_TIMES = ("wall_s", "cpu_s")


class Row(NamedTuple):
    """One point of a plan with its record.

    Attributes:
        point: the point.
        key: key of its run.
        record: None if it is missing or its file is damaged.
    """

    point: Point
    key: str
    record: Record | None

    @property
    def status(self) -> str:
        """Status of the run: "ok", "failed" or "missing"."""
        if self.record is None:
            return MISSING
        return OK if self.record.failure is None else FAILED

    @property
    def metrics(self) -> dict[str, float]:
        """Metrics of the run; a failed one has none but that it is not trustworthy."""
        if self.record is None:
            return {}
        return self.record.metrics if self.record.failure is None else {"trustworthy": 0.0}


def point_key(plan: SweepPlan, index: int) -> str:
    """Return the key of a point's run."""
    try:
        return run_key(plan.scenario(index), plan.metrics)
    except ScenarioError:
        point = plan[index]
        return unresolved_key(plan.base[point.base], point.changes)


def rows(plan: SweepPlan, store: SweepStore) -> Iterator[Row]:
    """Yield the runs in the order of the plan; damaged files count as missing and are left alone."""
    for point in plan.points():
        key = point_key(plan, point.number)
        try:
            record = store.read(key)
        except FileReadError:
            record = None
        yield Row(point, key, record)


def dataset(plan: SweepPlan, store: SweepStore) -> xr.Dataset:
    """Return all runs with the plan's dimensions.

    Variables: every metric of the finished runs (not a number where a run failed or is missing, but the
    ``trustworthy`` of a failed one is 0), ``status`` ("ok", "failed", "missing"), ``failure`` (name of the
    error) and ``failed_at_s`` (simulated time of a divergence).
    """
    n = len(plan)
    metrics: dict[str, np.ndarray] = {}
    status, failure = np.full(n, MISSING, dtype="<U7"), np.full(n, "", dtype=object)
    failed_at = np.full(n, np.nan)
    for row in rows(plan, store):
        place, record = row.point.number, row.record
        status[place] = row.status
        if record is None:
            continue
        for name, value in row.metrics.items():
            metrics.setdefault(name, np.full(n, np.nan))[place] = value
        if record.failure is not None:
            failure[place] = record.failure.kind
            failed_at[place] = record.failure.numbers.get("time", np.nan)
    if OK not in status:
        metrics = {}
    dims = [dimension.name for dimension in plan.dimensions]
    columns = {**metrics, "status": status, "failure": failure.astype(str), "failed_at_s": failed_at}
    data = xr.Dataset({name: (dims, values.reshape(plan.shape)) for name, values in columns.items()})
    for dimension in plan.dimensions:
        data = data.assign_coords(_coordinates(dimension))
    return data


def _coordinates(dimension: Dimension) -> dict[str, tuple[str, Any]]:
    """Return the coordinates along a dimension: its own labels, and those of fields that vary with it."""
    labels = [dimension.labels(place) for place in range(dimension.size)]
    return {name: (dimension.name, np.array([place[name] for place in labels])) for name in labels[0]}


def write_csv(path: Path, plan: SweepPlan, store: SweepStore, metrics: list[str]) -> None:
    """Write one line for each run in the order of the plan; numbers read back exactly."""
    lines: list[list[Any]] = [["point", *plan[0].parameters, "status", "failure", "message", *metrics, "key"]]
    for row in rows(plan, store):
        failure = row.record.failure if row.record else None
        reason = (failure.kind, failure.message) if failure else ("", "")
        values = [row.metrics.get(name) for name in metrics]
        lines.append(
            [row.point.number, *row.point.parameters.values(), row.status, *reason, *values, row.key]
        )
    _write_lines(path, lines)


def write_times(path: Path, plan: SweepPlan, store: SweepStore) -> None:
    """Write the duration of each run; metrics, unlike durations, are the same on every machine."""
    lines: list[list[Any]] = [["point", *_TIMES, "key"]]
    for row in rows(plan, store):
        times = row.record.times if row.record else {}
        lines.append([row.point.number, *map(times.get, _TIMES), row.key])
    _write_lines(path, lines)


def _write_lines(path: Path, lines: list[list[Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(map(_text, line) for line in lines)


def _text(value: Any) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)
