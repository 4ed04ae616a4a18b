"""Trust in a simulation: breaches of its trust thresholds, in all samples or while it is recorded."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array, Mask
from coop_pin.description.thresholds import TrustThresholds
from coop_pin.results.breaches import Breach, Series, in_time
from coop_pin.results.energies import energies, start_energy, unexplained_energy

STOP_SHARE = 2e-3
"""Part of the energy that end stops take which a hit may leave unexplained: steps straddle the contact."""


_KEPT = ("_gross", "_last", "_start_energy")
"""What a monitor keeps from one call to the next."""


class TrustMonitor:
    """Search for breaches in successive samples: those of a whole run at once, or of each tick as it is done.

    It keeps what the gross work allows from one call to the next.
    """

    def __init__(
        self,
        thresholds: TrustThresholds,
        joints: Sequence[tuple[str, Sequence[str]]],
        lower: Array,
        upper: Array,
    ) -> None:
        """Start before the first sample.

        Args:
            thresholds: thresholds of the scenario.
            joints: name of each arm, and names of its joints.
            lower: smallest joint positions, shape (..., m, k); NaN where there is no limit.
            upper: largest joint positions, likewise.
        """
        self._allowed, self._joints = thresholds, joints
        self._lower, self._upper = lower[..., None, :, :], upper[..., None, :, :]
        self._gross: Array | float = 0.0
        self._last: list[Array] | None = None
        self._start_energy: Array  # before the first sample

    def __deepcopy__(self, memo: dict[int, Any]) -> TrustMonitor:
        """Return a copy that goes on by itself; limits and names are shared."""
        other = copy.copy(self)
        vars(other).update(
            {name: copy.deepcopy(part, memo) for name, part in vars(self).items() if name in _KEPT}
        )
        return other

    def breaches(self, samples: Mapping[str, NDArray[Any]]) -> tuple[Breach, ...]:
        """Return the breaches in the next samples of a run, in the order of their first times.

        Args:
            samples: quantities by name, n samples that follow those of the last call.
        """
        return in_time(
            [b for series in self._series(samples) for b in series.breaches(samples["time"], self._joints)]
        )

    def exceeded(self, samples: Mapping[str, NDArray[Any]], unexplained: Array) -> Mask:
        """Return which runs have a breach, shape (...), from all their samples.

        Args:
            samples: quantities by name, with axes before that of time.
            unexplained: largest energy minus work of each run, J, up to rounding; see energy_balance.
        """
        runs, energies_too = self._lower.shape[:-3], ~(unexplained <= 0.5 * self._allowed.energy_floor)
        series = self._series(samples, bool(energies_too.any()))
        return np.any([each.beyond.reshape(*runs, -1).any(axis=-1) for each in series], axis=0)

    def _series(self, samples: Mapping[str, NDArray[Any]], energies_too: bool = True) -> list[Series]:
        """Return the series of all thresholds; samples may have axes before that of time."""
        allowed, positions = self._allowed, samples["joint_position"]
        excess = np.fmax(positions - self._upper, self._lower - positions)  # NaN without a limit
        limits = np.where(positions > self._upper, self._upper, self._lower)
        if "stop_force" in samples:  # depth in a stop is motion of the plant
            excess = np.where(np.isfinite(samples["stop_force"][..., :1, :, :]), 0.0, excess)
        errors = np.maximum(samples["closure_distance"], samples["closure_angle"])
        return [
            Series("joint limit", excess > allowed.joint_slack, positions, limits, excess),
            Series.at_most("jacobian condition", samples["jacobian_condition"], allowed.jacobian_condition),
            Series.at_most("closure error", errors, allowed.closure_error),
            *([self._energy(samples)] if energies_too else []),
        ]

    def _energy(self, samples: Mapping[str, NDArray[Any]]) -> Series:
        share, works = self._allowed.energy_share, [*energies(samples)[1], samples["potential_energy"]]
        shares = [share] * len(works)
        if "stop_energy" in samples:
            works += [samples["stop_energy"], samples["work_stops"]]
            shares += [STOP_SHARE, STOP_SHARE]
        if self._last is None:
            self._last, self._start_energy = [work[..., :1] for work in works], start_energy(samples)
        parts = zip(shares, works, self._last, strict=True)
        steps = sum(part * np.abs(np.diff(work, prepend=last)) for part, work, last in parts)
        gross = self._gross + np.cumsum(steps, axis=-1)
        self._last, self._gross = [work[..., -1:] for work in works], gross[..., -1:]
        values = np.abs(unexplained_energy(samples, self._start_energy))
        allowed = self._allowed.energy_floor + gross
        return Series.at_most("energy", values, allowed, values - allowed)
