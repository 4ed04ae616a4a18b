"""Results of a sweep, finished or not: a table with named dimensions, and its analysis."""

from __future__ import annotations

import functools
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import xarray as xr

from coop_pin.arrays import Array, as_count, as_number, require_path, require_type
from coop_pin.errors import (
    ArgumentError,
    FieldError,
    InvalidStateError,
    NameNotFoundError,
    OutOfRangeError,
)
from coop_pin.results import RunResult
from coop_pin.run_scenario import run
from coop_pin.sweeps import sensitivity
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.table import FAILED, MISSING, OK, PointFailure, PointResult, Table, describe, point_key


def _equal(label: Any, value: Any) -> bool:
    """Return whether a value is the number of a coordinate."""
    return isinstance(label, int | float) and isinstance(value, int | float) and label == value


class SweepResult:
    """Results of a sweep, or of a part of it.

    Attributes:
        plan: its plan.
        store: its folder.
    """

    def __init__(self, plan: SweepPlan, store: SweepStore) -> None:
        require_type("plan", plan, SweepPlan)
        require_type("store", store, SweepStore)
        self.plan, self.store = plan, store

    @classmethod
    def load(cls, folder: str | Path) -> Self:
        """Read the folder of a sweep, finished or not; another process may be writing it.

        Raises:
            FileReadError: the folder is not that of a sweep.
        """
        require_path("folder", folder)
        store = SweepStore(folder)
        return cls(store.read_plan(), store)

    # ------------------------------------------------------------ tables

    @functools.cached_property
    def _table(self) -> Table:
        return Table.read(self.plan, self.store)

    @functools.cached_property
    def data(self) -> xr.Dataset:
        """Dataset of all runs: metrics, ``status``, ``failure``, ``failed_at_s``, ``number``."""
        return self._table.dataset()

    def at(self, fields: Mapping[str, Any]) -> Self:
        """Return the part of the sweep in which fields have given values.

        Args:
            fields: a value for each of some varied fields, or its text.

        Raises:
            NameNotFoundError: a field does not vary.
            FieldError: no run has the value.
        """
        require_type("fields", fields, Mapping)
        for field in fields:
            require_type("a field", field, str)
        part = type(self)(self.plan, self.store)
        part._table, part.data = self._table, self.data
        for field, value in fields.items():
            if field not in part.data.coords:
                known = [str(name) for name in part.data.coords]
                raise NameNotFoundError("field", field, known, "the sweep")
            labels = np.atleast_1d(part.data[field].values).tolist()
            places = [i for i, label in enumerate(labels) if str(label) == str(value) or _equal(label, value)]
            if not places:
                wanted = ", ".join(map(str, labels[:20]))
                raise FieldError(f"never is {value!r}; it must be one of {wanted}", field)
            if dims := part.data[field].dims:
                part.data = part.data.isel({dims[0]: places if len(places) > 1 else places[0]})
        return part

    @property
    def metric_names(self) -> list[str]:
        """Names of the metrics that the runs have."""
        return list(self._table.metrics)

    @property
    def failures(self) -> list[PointFailure]:
        """The failed runs with their errors."""
        numbers = np.sort(self.data["number"].values[self.data["status"].values == FAILED]).tolist()
        reasons = self._table.reasons
        return [PointFailure(number, self.plan[number].parameters, *reasons[number]) for number in numbers]

    def counts(self) -> dict[str, int]:
        """Return the number of runs by status: "ok", "failed", "missing"."""
        status = self.data["status"].values
        return {name: int(np.count_nonzero(status == name)) for name in (OK, FAILED, MISSING)}

    def write_tables(self) -> None:
        """Write table.csv and table.nc, and times.csv apart from them, into the sweep's folder.

        Raises:
            FileWriteError: the disk is full.
        """
        self.store.write_with("table.csv", self._table.write_csv)
        self.store.write_with("table.nc", lambda part: self.data.to_netcdf(part, engine="h5netcdf"))
        self.store.write_with("times.csv", self._table.write_times)

    # ------------------------------------------------------------ analysis

    def values(self, metric: str) -> xr.DataArray:
        """Return one metric of all runs.

        Raises:
            NameNotFoundError: no run has it.
        """
        require_type("metric", metric, str)
        if metric not in self.metric_names:
            raise NameNotFoundError("metric", metric, self.metric_names, "the sweep")
        return self.data[metric]

    def best(self, metric: str, n: int = 1, *, largest: bool = False) -> list[PointResult]:
        """Return the n runs with the smallest (or largest) values of a metric; values must be finite."""
        n = as_count("n", n)
        require_type("largest", largest, bool)
        values = self.values(metric).values.ravel()
        order = np.argsort(-values if largest else values, kind="stable")
        return self._points(order[np.isfinite(values[order])][:n])

    def marginal(self, field: str, metric: str, *, average: Callable[..., Any] = np.nanmean) -> xr.DataArray:
        """Return a metric along one field, averaged over everything else that varies, without failed runs.

        Args:
            field: a dimension, or a field that varies along one.
            metric: name.
            average: averaging function, for example np.nanmedian.

        Raises:
            NameNotFoundError: there is no such metric or field.
        """
        require_type("field", field, str)
        require_type("average", average, Callable)  # type: ignore[arg-type]
        values = self.values(metric).where(np.isfinite(self.values(metric)))
        if field not in self.data.coords:
            raise NameNotFoundError("field", field, [str(name) for name in self.data.coords], "the sweep")
        with warnings.catch_warnings():
            # of places along the field where all runs failed
            warnings.filterwarnings("ignore", category=RuntimeWarning, message="Mean of empty slice|All-NaN")
            try:
                if field in values.dims:
                    return values.reduce(average, [dim for dim in values.dims if dim != field])
                return values.groupby(field).reduce(average, ...)
            except TypeError as error:
                raise ArgumentError(f"average must be called as np.nanmean is: {error}") from None

    def pareto(self, metric_a: str, metric_b: str) -> list[PointResult]:
        """Return the Pareto front of two metrics, sorted by the first one; smaller is better."""
        a, b = (self.values(metric).values.ravel() for metric in (metric_a, metric_b))
        return self._points(sensitivity.pareto_front(a, b))

    def stability_boundary(
        self, field: str, *, by: str | Sequence[str] | None = None, stable: xr.DataArray | None = None
    ) -> xr.Dataset:
        """Return, along other dimensions, the last stable and the first unstable value of a field.

        Args:
            field: a dimension with numbers.
            by: the dimensions to keep, all when omitted; along the others all runs must be stable.
            stable: which runs are stable, for example ``result.values("position_rms_m") < 0.01``; the
                finished ones when omitted.

        Raises:
            InvalidStateError: runs are missing.
            NameNotFoundError: the field is not a dimension.
        """
        require_type("field", field, str)
        require_type("by", by, str, Sequence, type(None))
        require_type("stable", stable, xr.DataArray, type(None))
        missing = self.counts()[MISSING]
        if missing:
            raise InvalidStateError(
                f"a stability boundary needs all {len(self.plan)} runs,"
                f" but {missing} of them failed or are missing; see result.failures"
            )
        if field not in self.data.dims:
            raise NameNotFoundError("dimension", field, [str(name) for name in self.data.dims], "the sweep")
        stable = self.data["status"] == OK if stable is None else stable
        kept = stable.dims if by is None else (field, *([by] if isinstance(by, str) else by))
        return sensitivity.stability_boundary(
            stable.all([dim for dim in stable.dims if dim not in kept]), field
        )

    def sobol_indices(
        self, metric: str, *, confidence: float = 0.95, resamples: int = 999
    ) -> sensitivity.SobolIndices:
        """Return the Sobol' indices of a metric: the share of its variance due to each sampled field.

        Args:
            metric: name.
            confidence: confidence level of the intervals.
            resamples: number of bootstrap samples.

        Raises:
            FieldError: the plan's only dimension is not a sample with method "saltelli".
            InvalidStateError: runs failed, are missing, or have no finite value.
        """
        if not 0.0 < as_number("confidence", confidence) < 1.0:
            raise OutOfRangeError("confidence", confidence, "between 0 and 1")
        resamples = as_count("resamples", resamples, 1)
        sample = self.plan.sample
        if sample is None or sample.method != "saltelli" or len(self.plan.dimensions) != 1:
            wanted = "must be the only dimension and have method = 'saltelli' for Sobol' indices"
            raise FieldError(wanted, "sample")
        values = self.values(metric).values
        unfinished = int(np.count_nonzero(~np.isfinite(values)))
        if unfinished:
            raise InvalidStateError(
                f"the Sobol' indices of {metric} needs all {len(self.plan)} runs,"
                f" but {unfinished} of them failed or are missing; see result.failures"
            )
        return sensitivity.sobol_indices(values, tuple(sample.fields), confidence, resamples, sample.seed)

    # ------------------------------------------------------------ single runs

    def _points(self, places: Array) -> list[PointResult]:
        """Return the runs at places of the flat data."""
        return [self.point(int(number)) for number in self.data["number"].values.ravel()[places]]

    def point(self, number: int) -> PointResult:
        """Return the parameters and metrics of one run."""
        point = self.plan[self._number(number)]
        metrics = {name: float(column[point.number]) for name, column in self._table.metrics.items()}
        return PointResult(point.number, point.parameters, metrics)

    def open(self, number: int) -> RunResult:
        """Return one run as a full result, which is simulated again unless it was stored.

        Raises:
            CoopPinError: the run fails.
        """
        number = self._number(number)
        record = self.store.read(point_key(self.plan, number))
        kept = self.store.read_result(record) if record is not None else None
        return kept if kept is not None else run(self.plan.scenario(number))

    def _number(self, number: int) -> int:
        """Return the number of a run, if there is one; negative ones count from the end."""
        require_type("number", number, int, np.integer)
        if not -len(self.plan) <= number < len(self.plan):
            nearest = max(-sys.maxsize, min(number, sys.maxsize))
            raise OutOfRangeError("number", nearest, f"a run of the plan, which has {len(self.plan)}")
        return int(number)

    def fields_without_effect(self) -> list[str]:
        """Return the dimensions along which all runs finished with the same metrics, bit for bit.

        For example the posture of arms that have no joint to spare.
        """
        if not self.metric_names or (self.data["status"] != OK).any():
            return []
        columns = [self.data[name] for name in self.metric_names]
        return [
            str(dim)
            for dim, size in self.data.sizes.items()
            if size > 1 and all(column.equals(column.roll({dim: 1})) for column in columns)
        ]

    def summary(self) -> str:
        """Return the plan, the number of runs by status, the failures and the metrics' ranges as text."""
        counts = self.counts()
        lines = [self.plan.summary(), ", ".join(f"{count} {status}" for status, count in counts.items())]
        failures = self.failures
        numbers = Counter(failure.kind for failure in failures)
        for kind, first in sorted({failure.kind: failure for failure in reversed(failures)}.items()):
            reason = f"{numbers[kind]} {kind}; run {first.number}: {first.message}"
            lines.append("  " + reason.replace("\n", "\n    "))
        if idle := self.fields_without_effect():
            lines.append(f"  no effect on any metric here: {', '.join(idle)}")
        ok = self.data["status"].values == OK
        metrics = {name: self.data[name].values[ok] for name in self.metric_names}
        return "\n".join(lines + describe(metrics))
