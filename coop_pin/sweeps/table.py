"""Table of all runs of a plan, read from the store in one pass, and its summary."""

from __future__ import annotations

import itertools
import logging
import operator
import textwrap
from collections.abc import Collection, Iterable, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd
import xarray as xr

from coop_pin.base.errors import FieldError
from coop_pin.results.metrics import SIMULATION_SOUND, TASK_KEPT, verdict_text
from coop_pin.sweeps.dimensions import label
from coop_pin.sweeps.plan import COLUMNS, SweepPlan
from coop_pin.sweeps.run_key import keyed_points
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers.job import JobRecord

_LOG = logging.getLogger("coop_pin.sweeps")
OK, FAILED, MISSING = "ok", "failed", "missing"
_TEXTS, _NUMBERS = ("failure", "message"), ("failed_at_s", "merged", "wall_s", "cpu_s")
"""Parts of a record that are columns, beside its key and its metrics."""
TIMES = ["wall_s", "cpu_s"]
"""Durations, which differ from machine to machine."""
_CHUNK = 1000
"""Records that are read at once."""


class PointResult(NamedTuple):
    """One run of a sweep.

    Attributes:
        number: number in the plan, counted from 0; ``open`` takes it.
        parameters: values of the varied fields.
        metrics: metrics by name.
        kind: name of its error's class; empty if it did not fail.
        message: the error's message.
    """

    number: int
    parameters: dict[str, Any]
    metrics: dict[str, float]
    kind: str = ""
    message: str = ""

    def verdict(self) -> str:
        """Return the verdicts on task and simulation as text; "" where a run has none."""
        return f"failed: {self.kind}" if self.kind else verdict_text(self.metrics)


class Columns:
    """Columns of the records of a plan's runs: a row for each key, with what the last record of it has.

    Attributes:
        places: row of each key.
        texts: texts of records by name, None in a row without a record.
        numbers: numbers of records and metrics by name, NaN likewise.
    """

    def __init__(self, most: int) -> None:
        """Make room for so many keys, and for one row that stays empty, the last."""
        self.places, size = dict[str, int](), most + 1
        self.texts = {name: np.full(size, None, dtype=object) for name in _TEXTS}
        self.numbers = {name: np.full(size, np.nan) for name in _NUMBERS}

    @property
    def metrics(self) -> set[str]:
        """Names of metrics that some record has."""
        return {*self.numbers} - {*_NUMBERS}

    @classmethod
    def of(cls, records: Iterable[JobRecord], keys: Collection[str]) -> Self:
        """Return the columns of the records that have one of some keys."""
        columns, runs = cls(len(keys)), {*keys}
        known = (record for record in records if record.key in runs)
        while chunk := list(itertools.islice(known, _CHUNK)):
            columns.add(chunk)
        return columns

    def add(self, records: Sequence[JobRecord]) -> None:
        """Take over records."""
        at = np.array([self.places.setdefault(record.key, len(self.places)) for record in records], dtype=int)
        parts = (
            np.array([*map(operator.attrgetter(*_TEXTS, *_NUMBERS), records)], dtype=object)
            .reshape(-1, len(_TEXTS + _NUMBERS))
            .T
        )
        for texts, values in zip(self.texts.values(), parts[: len(_TEXTS)], strict=True):
            texts[at] = values
        for name, values in zip(_NUMBERS, parts[len(_TEXTS) :].astype(np.float64), strict=True):
            self.numbers[name][at] = values
        first = 0
        for names, group in itertools.groupby((record.metrics for record in records), tuple):
            runs = [*group]
            rows = at[first : first + len(runs)]
            first += len(runs)
            for name in self.metrics - {*names}:  # of an earlier record with the same key
                self.numbers[name][rows] = np.nan
            entries = itertools.chain.from_iterable(run.values() for run in runs)
            table = np.fromiter(entries, np.float64).reshape(len(runs), -1)
            for name, column in zip(names, table.T, strict=True):
                if name not in self.numbers:
                    self.numbers[name] = np.full(len(self.numbers["wall_s"]), np.nan)
                self.numbers[name][rows] = column


def read_runs(
    plan: SweepPlan, store: SweepStore, keys: Sequence[str] | None = None, columns: Columns | None = None
) -> xr.Dataset:
    """Return all runs of a plan, read from the store in one pass, with the plan's dimensions.

    Variables: COLUMNS, and every metric of the finished runs in alphabetical order, not a number where a run
    failed or is missing, but the verdicts of a failed one are 0. Runs whose lines are damaged count as
    missing.

    Args:
        plan: plan of the runs.
        store: store of their records.
        keys: keys of all points, where they are known.
        columns: columns of all records, where they are known; they are used up.
    """
    keys = [each.key for each in keyed_points(plan)] if keys is None else keys
    if columns is None:
        columns = Columns.of(store.records(), keys)
        if unread := {*keys} & {*store.known} - {*columns.places}:
            advice = "another version wrote them: choose another folder, and they are computed again"
            _LOG.warning("%d stored runs of %s cannot be read; %s", len(unread), store.folder, advice)
    texts, numbers = columns.texts, columns.numbers
    require_own_names(plan, columns.metrics)
    conditions = [texts["failure"] == None, texts["failure"] != ""]  # noqa: E711  of each entry
    status = np.array([OK, MISSING, FAILED], dtype=object)[np.select(conditions, [1, 2], 0)]
    for name in {SIMULATION_SOUND, TASK_KEPT} & {*numbers}:
        numbers[name][status == FAILED] = 0.0
    for values in texts.values():
        values[status == MISSING] = ""
    rows = np.array([columns.places.get(key, -1) for key in keys])
    columns.places.clear()
    variables = {"number": np.arange(len(plan)), "status": status[rows]}
    variables |= {name: texts.pop(name)[rows] for name in _TEXTS} | {"key": np.array(keys, dtype=object)}
    variables |= {name: numbers.pop(name)[rows] for name in sorted(numbers)}
    dims = [dimension.name for dimension in plan.dimensions]
    coordinates = {
        name: (dimension.name, np.array([*map(label, values)]))
        for dimension in plan.dimensions
        for name, values in dimension.fields.items()
    }
    return xr.Dataset({name: (dims, x.reshape(plan.shape)) for name, x in variables.items()}, coordinates)


def require_own_names(plan: SweepPlan, metrics: Iterable[str]) -> None:
    """Refuse metrics with the name of a varied field or of a column that every table has.

    Raises:
        FieldError: a metric of the user has such a name.
    """
    fields = (name for dimension in plan.dimensions for name in dimension.fields)
    if clashes := sorted({*COLUMNS, *fields} & {*metrics}):
        raise FieldError(
            f"return {clashes[0]!r}, which another column of the table has; rename it", "metrics"
        )


def describe(table: pd.DataFrame, metrics: list[str]) -> list[str]:
    """Return lines about a table: runs by status, failures, doubtful runs, empty values, and ranges."""
    counts = (f"{(table['status'] == status).sum()} {status}" for status in (OK, FAILED, MISSING))
    lines = [", ".join(counts)]
    for kind, runs in table[table["status"] == FAILED].groupby("failure"):
        reason = f"{len(runs)} {kind}; run {runs.index[0]}: {runs['message'].iloc[0]}"
        lines.append("  " + reason.replace("\n", "\n    "))
    ok = table.loc[table["status"] == OK, metrics]
    checks = ok.reindex(columns=[SIMULATION_SOUND, TASK_KEPT, "dropped_at_s", "settling_time_s"])
    dropped = np.isfinite(checks["dropped_at_s"])
    doubts = {
        "SIMULATION NOT SOUND: open(number).verdict() says why": checks[SIMULATION_SOUND] == 0.0,
        "task DROPPED: nothing holds the payload from dropped_at_s on": dropped,
        "task OFF or lost: open(number).verdict() says by how much": (checks[TASK_KEPT] == 0.0) & ~dropped,
        "never settled: settling_time_s is infinite": checks["settling_time_s"] == np.inf,
    }
    lines += [f"  {runs.sum()} {text}" for text, runs in doubts.items() if runs.any()]
    empty = ok.isna().sum()
    if none := int((empty == len(ok)).sum()) * bool(len(ok)):
        lines.append(f"  metrics without a value in any finished run: {none}")
    if named := [f"{name} ({count})" for name, count in empty.items() if 0 < count < len(ok)]:
        text = f"not a number, by the number of finished runs: {', '.join(named)}"
        lines += textwrap.wrap(text, 98, initial_indent="  ", subsequent_indent="    ")
    finite = ok.where(np.isfinite(ok)).dropna(axis="columns", how="all")
    for name, column in finite.items():
        span = f"{column.min():>11.4g} .. {column.max():<11.4g}"
        lines.append(f"  {name:<30} {span} median {column.median():.4g}")
    return lines
