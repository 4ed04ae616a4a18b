"""Results of a sweep, finished or not: a table with named dimensions, and its analysis."""

from __future__ import annotations

import functools
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import xarray as xr

from coop_pin.arrays import as_count, as_number, require_path, require_type
from coop_pin.errors import (
    ArgumentError,
    FieldError,
    FileReadError,
    InvalidStateError,
    NameNotFoundError,
    OutOfRangeError,
)
from coop_pin.results import RunResult
from coop_pin.results.metrics import NO_STEADY_METRICS
from coop_pin.run_scenario import run
from coop_pin.sweeps import sensitivity
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.table import MISSING, OK, dataset, point_key, rows, write_csv, write_times

_NOT_METRICS = ("status", "failure", "failed_at_s")


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


class SweepResult:
    """Results of a sweep.

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
    def data(self) -> xr.Dataset:
        """Dataset with the plan's dimensions: all metrics, ``status``, ``failure`` and ``failed_at_s``."""
        return dataset(self.plan, self.store)

    @property
    def metric_names(self) -> list[str]:
        """Names of the metrics that the runs have."""
        return [str(name) for name in self.data.data_vars if name not in _NOT_METRICS]

    @property
    def failures(self) -> list[PointFailure]:
        """The failed runs with their errors."""
        return [
            PointFailure(row.point.number, row.point.parameters, failure.kind, failure.message)
            for row in rows(self.plan, self.store)
            if row.record is not None and (failure := row.record.failure) is not None
        ]

    def counts(self) -> dict[str, int]:
        """Return the number of runs by status: "ok", "failed", "missing"."""
        names, counts = np.unique(self.data["status"].values, return_counts=True)
        return {"ok": 0, "failed": 0, "missing": 0} | {
            str(name): int(count) for name, count in zip(names, counts, strict=True)
        }

    def write_tables(self) -> None:
        """Write table.csv and table.nc, and times.csv apart from them, into the sweep's folder.

        Raises:
            FileWriteError: the disk is full.
        """
        names = self.metric_names
        self.store.write_with("table.csv", lambda part: write_csv(part, self.plan, self.store, names))
        self.store.write_with("table.nc", lambda part: self.data.to_netcdf(part, engine="h5netcdf"))
        self.store.write_with("times.csv", lambda part: write_times(part, self.plan, self.store))

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
        return [self.point(int(index)) for index in order if np.isfinite(values[index])][:n]

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
        return [self.point(int(index)) for index in sensitivity.pareto_front(a, b)]

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

    def point(self, number: int) -> PointResult:
        """Return the parameters and metrics of one run."""
        point = self.plan[self._number(number)]
        metrics = {name: float(self.data[name].values.ravel()[point.number]) for name in self.metric_names}
        return PointResult(point.number, point.parameters, metrics)

    def open(self, number: int) -> RunResult:
        """Return one run as a full result, which is simulated again unless it was stored.

        Raises:
            CoopPinError: the run fails.
        """
        number = self._number(number)
        try:
            record = self.store.read(point_key(self.plan, number))
        except FileReadError:
            record = None
        kept = self.store.read_result(record) if record is not None else None
        return kept if kept is not None else run(self.plan.scenario(number))

    def _number(self, number: int) -> int:
        """Return the number of a run, if there is one; negative ones count from the end."""
        require_type("number", number, int, np.integer)
        if not -len(self.plan) <= number < len(self.plan):
            nearest = max(-sys.maxsize, min(number, sys.maxsize))
            raise OutOfRangeError("number", nearest, f"a run of the plan, which has {len(self.plan)}")
        return int(number)

    def summary(self) -> str:
        """Return the plan, the number of runs by status, the failures and the metrics' ranges as text."""
        counts = self.counts()
        lines = [self.plan.summary(), ", ".join(f"{count} {status}" for status, count in counts.items())]
        failures = self.failures
        numbers = Counter(failure.kind for failure in failures)
        for kind, first in sorted({failure.kind: failure for failure in reversed(failures)}.items()):
            reason = f"{numbers[kind]} {kind}; run {first.number}: {first.message}"
            lines.append("  " + reason.replace("\n", "\n    "))
        lines += self._warnings()
        for name in self.metric_names:
            values = self.data[name].values[np.isfinite(self.data[name].values)]
            if values.size:
                span = f"{values.min():>11.4g} .. {values.max():<11.4g}"
                lines.append(f"  {name:<30} {span} median {np.median(values):.4g}")
        return "\n".join(lines)

    def _warnings(self) -> list[str]:
        """Return how many finished runs are not trustworthy, and how many have no steady metrics."""
        names, lines = self.metric_names, []
        finished = self.data["status"] == OK  # the failed ones are listed with their errors
        untrusted = int((finished & (self.data["trustworthy"] == 0.0)).sum()) if "trustworthy" in names else 0
        if untrusted:
            lines.append(f"  {untrusted} NOT TRUSTWORTHY: trustworthy = 0; open(number).verdict() says why")
        if "window_end_s" in names:
            short = int((self.data["window_end_s"] <= self.data["window_start_s"]).sum())
            if short:
                lines.append(f"  {short} without steady metrics: {NO_STEADY_METRICS}")
        return lines
