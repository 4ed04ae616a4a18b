"""Torque response of drives: lag and rate limit, exact between two targets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.description.scenario import Scenario
from coop_pin.model.joint_limits import per_joint

_NO_LAG, _NO_RATE_LIMIT = 1e-30, 1e300
"""Stand for none in the equations of TorqueResponse: their product is large, too."""

SAME = 1e-9
"""Two times closer than this part of a tick are the same instant."""


class ResponseState(NamedTuple):
    """Torques of drives after a target, in the letters of TorqueResponse; every row is of shape (drives,).

    Attributes:
        target: u, N m.
        sign: sgn(e).
        ramp: D, N m.
        rest: |e| - D, N m.
    """

    target: Array
    sign: Array
    ramp: Array
    rest: Array


class TorqueResponse(NamedTuple):
    """Response of drives with lag and rate limit: d tau/dt = clip((u - tau) / lag, -rate, rate).

    With e = u - tau(t_k) they first change by D = max(|e| - rate lag, 0) at the largest rate, then decay:

        tau(t_k + s) = u - sgn(e) (D - rate m + (|e| - D) exp(-(s - m) / lag)) with m = min(s, D / rate)

    Every row has one value for each drive.

    Attributes:
        at_once: mask of the drives with neither lag nor rate limit.
        lag: time constant, s.
        rate: largest rate, N m/s.
    """

    at_once: Mask
    lag: Array
    rate: Array

    @classmethod
    def of_drives(cls, lag: Array, rate: Array) -> TorqueResponse:
        """Return the response of drives, shape (drives,) each; lag 0 and rate inf where none."""
        at_once = (lag == 0.0) & np.isinf(rate)
        return cls(at_once, np.maximum(lag, _NO_LAG), np.minimum(rate, _NO_RATE_LIMIT))

    def start(self, torque: Array) -> ResponseState:
        """Return the state at rest at a torque, shape (drives,)."""
        return ResponseState(torque, *np.zeros((3, len(torque))))

    def step(self, state: ResponseState, s: float, target: Array) -> ResponseState:
        """Return the state at a new target, shape (drives,), s seconds after the last."""
        error = np.where(self.at_once, 0.0, target - self.at(state, s))
        ramp = np.maximum(np.abs(error) - self.rate * self.lag, 0.0)
        return ResponseState(target, np.sign(error), ramp, np.abs(error) - ramp)

    def at(self, state: ResponseState, s: float) -> Array:
        """Return the torques s seconds after the last target, N m, shape (drives,)."""
        m = np.minimum(s, state.ramp / self.rate)
        error = state.ramp - self.rate * m + state.rest * np.exp((m - s) / self.lag)
        return state.target - state.sign * error

    def mean(self, state: ResponseState, s: float, duration: float) -> Array:
        """Return the mean torques over a duration that begins at s: their exact impulse, shape (drives,)."""
        error = self._integrated_error(state, s + duration) - self._integrated_error(state, s)
        return state.target - state.sign * error / duration

    def _integrated_error(self, state: ResponseState, s: float) -> Array:
        """Return the integral of |u - tau| from t_k over s."""
        m = np.minimum(s, state.ramp / self.rate)
        decayed = m - self.lag * np.expm1((m - s) / self.lag)
        return (state.ramp - 0.5 * self.rate * m) * m + state.rest * decayed

    def is_limited(self, state: ResponseState, duration: float) -> Mask:
        """Return which torques still change at their largest rate after a duration, s, shape (drives,)."""
        return state.ramp > (1.0 + SAME) * self.rate * duration

    def cut(self, state: ResponseState, duration: float) -> Array:
        """Return the part of the change that the rate limit leaves out over a duration, N m, (drives,)."""
        left_out = np.where(self.is_limited(state, duration), state.ramp - self.rate * duration, 0.0)
        return state.sign * left_out


def torque_response(scenario: Scenario, drives: Mapping[str, int]) -> TorqueResponse | None:
    """Return the response of all drives; None if each delivers and holds.

    Args:
        scenario: Scenario with actuators.
        drives: Number of drives of each arm, in the order of the cell.

    Raises:
        FieldError: the number of rate limits is not that of an arm's joints.
    """
    options, rates = [scenario.actuators_of(name) for name in drives], []
    for (name, count), each in zip(drives.items(), options, strict=True):
        limit = np.inf if each.rate_limit is None else each.rate_limit
        rates.append(per_joint(np.array(limit), count, f"{scenario.actuators_path(name)}.rate_limit"))
    rate = np.concatenate(rates)
    lag = np.repeat([each.lag for each in options], list(drives.values()))
    is_lost = any(each.torque_lost_at is not None for each in options)
    if not (is_lost or lag.any() or np.isfinite(rate).any()):
        return None
    return TorqueResponse.of_drives(lag, rate)
