"""What the figures of a sweep show: one metric with repeats joined."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
import xarray as xr

from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.table import FAILED


class MetricTable(NamedTuple):
    """One metric with repeats joined.

    Attributes:
        metric: its name.
        values: the median of repeats; not a number where a run failed, is missing, or has no finite value.
        failed: where any repeat failed.
    """

    metric: str
    values: xr.DataArray
    failed: xr.DataArray

    @classmethod
    def of(cls, result: SweepResult, metric: str) -> Self:
        """Return the table of a sweep.

        Raises:
            EntryNotFoundError: no run has the metric.
        """
        values, failed = result.values(metric), result.data["status"] == FAILED
        values = values.where(np.isfinite(values))
        if "repeat" in values.dims:
            values, failed = values.median("repeat"), failed.any("repeat")
        return cls(metric, values, failed)

    @property
    def numbered(self) -> list[str]:
        """The dimensions with numbers on them."""
        names = map(str, self.values.dims)
        return [name for name in names if name != "sample" and self.values[name].dtype.kind in "iuf"]
