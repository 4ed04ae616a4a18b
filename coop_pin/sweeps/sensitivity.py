"""Sensitivity analysis of a table of runs: Pareto front, stability boundary, Sobol' indices."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from coop_pin.arrays import Array


class SobolIndices(NamedTuple):
    """Sobol' indices: share of a metric's variance due to each field, with bootstrap confidence intervals.

    Attributes:
        fields: names.
        first: first-order indices, shape (d,).
        first_low: lower ends of their confidence intervals, shape (d,).
        first_high: upper ends.
        total: total indices, shape (d,).
        total_low: lower ends of their confidence intervals.
        total_high: upper ends.
    """

    fields: tuple[str, ...]
    first: Array
    first_low: Array
    first_high: Array
    total: Array
    total_low: Array
    total_high: Array


def pareto_front(a: Array, b: Array) -> Array:
    """Return the indices of the non-dominated runs, sorted by rising ``a``.

    A run is dominated if another one is no worse in both metrics and better in one. Smaller is better; runs
    with a value that is not finite are left out.

    Args:
        a: values of one metric, shape (n,).
        b: values of the other metric, shape (n,).
    """
    front: list[int] = []
    lowest = np.inf
    for place in np.lexsort((b, a)):
        if np.isfinite(a[place]) and np.isfinite(b[place]) and b[place] < lowest:
            front.append(int(place))
            lowest = float(b[place])
    return np.array(front, dtype=int)


def stability_boundary(stable: xr.DataArray, field: str) -> xr.Dataset:
    """Return, for each place along the other dimensions, the values of a field where stability ends.

    Args:
        stable: whether each run is stable.
        field: a dimension with numeric coordinates, searched from its smallest value.

    Returns:
        ``last_stable`` (NaN if the smallest value is unstable) and ``first_unstable`` (NaN if all are
        stable), with the dimensions other than the field's.
    """
    stable = stable.sortby(field)
    values = np.asarray(stable[field].values, dtype=float)
    good = stable.transpose(..., field).values.astype(bool)
    count = np.where(good.all(axis=-1), len(values), np.argmin(good, axis=-1))
    padded = np.concatenate(([np.nan], values, [np.nan]))
    rest = stable.isel({field: 0}, drop=True)
    rest = rest.transpose(*[dim for dim in stable.transpose(..., field).dims if dim != field])
    return xr.Dataset(
        {"last_stable": (rest.dims, padded[count]), "first_unstable": (rest.dims, padded[count + 1])},
        coords=rest.coords,
    )


def sobol_indices(
    values: Array, fields: tuple[str, ...], confidence: float, resamples: int, seed: int
) -> SobolIndices:
    """Return the Sobol' indices of a metric at Saltelli's points.

    Args:
        values: the metric at the points of A, of B, and of A with one column from B for each field,
            shape (n (d + 2),).
        fields: the d fields.
        confidence: confidence level of the intervals.
        resamples: number of bootstrap samples.
        seed: seed of the bootstrap.
    """
    from scipy.stats import sobol_indices as indices  # slow to load

    blocks = values.reshape(len(fields) + 2, -1)
    given: dict[str, Any] = {"f_A": blocks[:1], "f_B": blocks[1:2], "f_AB": blocks[2:, None, :]}
    found = indices(func=given, n=blocks.shape[1], rng=np.random.default_rng(seed))
    spread = found.bootstrap(confidence_level=confidence, n_resamples=resamples)
    first, total = spread.first_order.confidence_interval, spread.total_order.confidence_interval
    return SobolIndices(
        fields,
        *map(np.ravel, (found.first_order, first.low, first.high, found.total_order, total.low, total.high)),
    )
