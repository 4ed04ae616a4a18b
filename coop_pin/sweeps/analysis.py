"""Table of the runs of a sweep with named dimensions, and its analysis."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import numpy as np
import pandas as pd
import xarray as xr

from coop_pin.base.arrays import as_count, as_number, require_type
from coop_pin.base.errors import (
    ArgumentError,
    FieldError,
    InvalidStateError,
    NameNotFoundError,
    OutOfRangeError,
)
from coop_pin.results.metrics import SIMULATION_SOUND, TASK_KEPT
from coop_pin.sweeps.plan import COLUMNS, SweepPlan
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.table import FAILED, MISSING, OK, TIMES, Columns, PointResult, read_runs

_APART = ["message", *TIMES, "key"]
"""Columns that are not in the dataset."""


class SweepTable:
    """Table of the runs of a sweep, or of a part of it.

    Attributes:
        plan: plan of the sweep.
        store: folder of the sweep.
    """

    def __init__(
        self,
        plan: SweepPlan,
        store: SweepStore,
        keys: Sequence[str] | None = None,
        columns: Columns | None = None,
    ) -> None:
        """Read nothing yet; keys of all points and columns of all records may be known, see ``read_runs``."""
        require_type("plan", plan, SweepPlan)
        require_type("store", store, SweepStore)
        self.plan, self.store, self._known = plan, store, (keys, columns)

    @functools.cached_property
    def _runs(self) -> xr.Dataset:
        runs = read_runs(self.plan, self.store, *self._known)
        self._known = None, None
        return runs

    @functools.cached_property
    def data(self) -> xr.Dataset:
        """Dataset of all runs: metrics, ``status``, ``failure``, ``failed_at_s``, ``number``."""
        return self._runs.drop_vars(_APART)

    @functools.cached_property
    def table(self) -> pd.DataFrame:
        """Table of all runs by number: varied fields, status, error, metrics, durations and key."""
        runs: Any = self._runs
        sizes, names = runs["number"].sizes, (*runs.coords, *runs.data_vars)
        columns = {name: runs.variables[name].set_dims(sizes).values.ravel() for name in names}
        return pd.DataFrame(columns).set_index("number")

    def at(self, fields: Mapping[str, Any]) -> Self:
        """Return the part of the sweep in which fields have given values.

        Args:
            fields: a value for each of some varied fields, or its text.

        Raises:
            NameNotFoundError: a field does not vary.
            FieldError: no run has the value.
        """
        require_type("fields", fields, Mapping)
        part = type(self)(self.plan, self.store)
        part._runs = self._runs
        for field, value in fields.items():
            labels = np.atleast_1d(part._coordinate(field).values).tolist()
            indices = [i for i, label in enumerate(labels) if _is_same(label, value)]
            if not indices:
                allowed = ", ".join(map(str, labels[:20]))
                raise FieldError(f"never is {value!r}; it must be one of {allowed}", field)
            if dims := part._runs[field].dims:
                part._runs = part._runs.isel({dims[0]: indices if len(indices) > 1 else indices[0]})
        return part

    def _coordinate(self, field: str) -> xr.DataArray:
        require_type("field", field, str)
        if field not in self._runs.coords:
            raise NameNotFoundError("field", field, map(str, self._runs.coords), "the sweep")
        return self._runs[field]

    @property
    def metric_names(self) -> list[str]:
        """Names of the metrics that the runs have."""
        return [str(name) for name in self._runs.data_vars if name not in COLUMNS]

    @property
    def failures(self) -> list[PointResult]:
        """The failed runs with their errors."""
        return self._points(self.table.index[self.table["status"] == FAILED])

    def counts(self) -> dict[str, int]:
        """Return the number of runs by status: "ok", "failed", "missing"."""
        return {status: int((self.table["status"] == status).sum()) for status in (OK, FAILED, MISSING)}

    def fields_without_effect(self) -> list[str]:
        """Return the dimensions along which all metrics are the same, as the posture of six-joint arms."""
        if not self.metric_names or (self.table["status"] != OK).any():
            return []
        metrics = self.data[self.metric_names]
        varied = [dim for dim, size in metrics.sizes.items() if size > 1]
        return [str(dim) for dim in varied if metrics.equals(metrics.roll({dim: 1}))]

    # ------------------------------------------------------------ analysis

    def values(self, metric: str) -> xr.DataArray:
        """Return one metric of all runs.

        Raises:
            NameNotFoundError: no run has it.
        """
        require_type("metric", metric, str)
        if metric not in self.metric_names:
            known = [SIMULATION_SOUND, TASK_KEPT] if metric == "trustworthy" else self.metric_names
            raise NameNotFoundError("metric", metric, known, "the sweep")
        return self.data[metric]

    def _finite(self, *metrics: str) -> pd.DataFrame:
        """Return the table of the runs in which metrics are finite."""
        columns = self.table[[str(self.values(name).name) for name in metrics]]
        return self.table[np.isfinite(columns).all(axis="columns")]

    def best(self, metric: str, n: int = 1, *, largest: bool = False) -> list[PointResult]:
        """Return the n runs with the smallest (or largest) values of a metric; values must be finite."""
        n = as_count("n", n)
        require_type("largest", largest, bool)
        rows = self._finite(metric).sort_values(metric, ascending=not largest, kind="stable")
        return self._points(rows.index[:n])

    def marginal(
        self, field: str, metric: str, *, average: str | Callable[[Any], Any] = "mean"
    ) -> xr.DataArray:
        """Return a metric along one field, averaged over everything else that varies, without failed runs.

        Args:
            field: a dimension, or a field that varies along one.
            metric: name.
            average: averaging function, for example np.median, or its name in pandas.

        Raises:
            NameNotFoundError: there is no such metric or field.
            ArgumentError: pandas cannot average so.
        """
        require_type("average", average, str, Callable)  # type: ignore[arg-type]
        labels = pd.Index(np.atleast_1d(self._coordinate(field).values), name=field).unique()
        try:
            return self._finite(metric).groupby(field)[metric].agg(average).reindex(labels).to_xarray()
        except (TypeError, ValueError, AttributeError) as error:
            raise ArgumentError(f"average cannot be used: {error}") from None

    def pareto(self, metric_a: str, metric_b: str) -> list[PointResult]:
        """Return the Pareto front of two metrics, sorted by the first one; smaller is better.

        No other run is as good in both metrics; of equal ones the first counts.
        """
        rows = self._finite(metric_a, metric_b).sort_values([metric_a, metric_b], kind="stable")
        return self._points(rows.index[rows[metric_b] < rows[metric_b].cummin().shift(fill_value=np.inf)])

    def stability_boundary(
        self, field: str, *, by: str | Sequence[str] | None = None, stable: xr.DataArray | None = None
    ) -> xr.Dataset:
        """Return, along other dimensions, the last stable and the first unstable value of a field.

        Args:
            field: a dimension with numbers, searched from its smallest value.
            by: the dimensions to keep, all when omitted; along the others all runs must be stable.
            stable: mask of the stable runs, for example ``result.values("position_error_max_m") < 0.01``;
                those that finished, are sound and keep their task when omitted.

        Returns:
            ``last_stable``, NaN if the smallest value is unstable, and ``first_unstable``, NaN if none is.

        Raises:
            InvalidStateError: runs are missing.
            NameNotFoundError: the field is not a dimension with numbers.
        """
        require_type("by", by, str, Sequence, type(None))
        require_type("stable", stable, xr.DataArray, type(None))
        self._require_all(self.table["status"] == MISSING, "a stability boundary")
        numeric = [str(dim) for dim in self.data.dims if self.data[dim].dtype.kind in "iuf"]
        if self._coordinate(field).name not in numeric:
            raise NameNotFoundError("dimension with numbers", field, numeric, "the sweep")
        if stable is None:
            stable = self.data["status"] == OK
            for verdict in {SIMULATION_SOUND, TASK_KEPT} & {*self.metric_names}:
                stable = stable & (self.data[verdict] == 1.0)
        dims = stable.dims if by is None else (field, *([by] if isinstance(by, str) else by))
        good = stable.all([dim for dim in stable.dims if dim not in dims]).sortby(field).cumprod(field) > 0
        values = good[field].astype(float)
        return xr.Dataset(
            {"last_stable": values.where(good).max(field), "first_unstable": values.where(~good).min(field)}
        )

    def sobol_indices(self, metric: str, *, confidence: float = 0.95, resamples: int = 999) -> pd.DataFrame:
        """Return the Sobol' indices of a metric: the share of its variance due to each sampled field.

        Args:
            metric: name.
            confidence: confidence level of the intervals.
            resamples: number of bootstrap samples.

        Returns:
            For each field ``first`` and ``total``, with the ends ``first_low``, ... of bootstrap intervals.

        Raises:
            FieldError: the plan's only dimension is not a sample with method "saltelli".
            InvalidStateError: runs failed, are missing, or have no finite value.
        """
        from scipy import stats  # slow to load

        if not 0.0 < as_number("confidence", confidence) < 1.0:
            raise OutOfRangeError("confidence", confidence, "between 0 and 1")
        sample = self.plan.sample
        is_whole = len(self.plan.dimensions) == 1 and len(self.table) == len(self.plan)
        if sample is None or sample.method != "saltelli" or not is_whole:
            form = "must be the only dimension and have method = 'saltelli' for Sobol' indices"
            raise FieldError(form, "sample")
        values = self.values(metric).values
        self._require_all(~np.isfinite(values), "Sobol' indices")
        A, B, *AB = values.reshape(-1, 1, sample.count)
        samples, random = {"f_A": A, "f_B": B, "f_AB": np.array(AB)}, np.random.default_rng(sample.seed)
        analysis = stats.sobol_indices(func=samples, n=sample.count, rng=random)
        spread = analysis.bootstrap(
            confidence_level=confidence, n_resamples=as_count("resamples", resamples, 1)
        )
        first, total = spread.first_order.confidence_interval, spread.total_order.confidence_interval
        indices = {"first": analysis.first_order, "first_low": first.low, "first_high": first.high}
        indices |= {"total": analysis.total_order, "total_low": total.low, "total_high": total.high}
        return pd.DataFrame({name: np.ravel(x) for name, x in indices.items()}, list(sample.fields))

    def _require_all(self, unusable: Any, what: str) -> None:
        if count := int(np.count_nonzero(unusable)):
            runs = f"all {len(self.plan)} runs, but {count} of them failed or are missing"
            raise InvalidStateError(f"{what} needs {runs}; see result.failures")

    def _points(self, numbers: Sequence[int]) -> list[PointResult]:
        names = self.metric_names
        rows = self.table.loc[list(numbers), ["failure", "message", *names]]
        return [
            PointResult(
                number, self.plan[number].parameters, dict(zip(names, row, strict=True)), kind, message
            )
            for number, kind, message, *row in rows.itertuples(name=None)
        ]


def _is_same(label: Any, value: Any) -> bool:
    """Return whether a value is a coordinate, or its text."""
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        return float(label) == float(value)
    return str(label) == str(value)
