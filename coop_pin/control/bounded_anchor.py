"""Bounded anchor: how far measured wrenches may move an integral, and how fast that limit itself moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.spatial.generic_numbers import inverse
from coop_pin.spatial.task_rows import TaskRows

_TINY = 1e-300
"""Stands for 0 in a quotient of two lengths."""


class AnchorState(NamedTuple):
    """Memory of a bounded anchor.

    Attributes:
        moved: A, what the anchor has moved within about 1 / k_I, N and N m, shape (k_0,).
        centre: C, the error of the pose about which it is bounded, m and rad, shape (k_0,).
        torque: command of the last tick, N m, shape (k,).
    """

    moved: Array
    centre: Array
    torque: Array


class BoundedAnchor(NamedTuple):
    """Bound of what the anchors of an integral move, as the error of the pose that has the same effect.

    ::

        y        = G^-1 (A + a)                              a, what the anchor asks for at this tick
        off      = y - C min(max(y.C / |C|^2, 0), 1)         from the nearest point between 0 and C
        beyond   = off (1 - b_0 / max(|off|, b_0))           exactly 0 within the bound
        C       <- C + beyond min(1, d / |beyond|)           d = T nu (b_max - b_0) exp(-nu (t - t_0))
        anchored = a - G (what is left of beyond)
        A       <- (I - T forget) (A + anchored)

    Norms are those of positions and of rotations, each by itself. C moves b_max - b_0 at most, while a bias
    of the kinematics takes effect after the start; from then on a bias no longer moves the anchor.

    Attributes:
        gain: G = c K gamma, shape (k_0, k_0).
        gain_inverse: G^-1.
        same_kind: 1.0 between two positions or two rotations, else 0.0, shape (k_0, k_0).
        free: b_0 of each row, m and rad, shape (k_0,).
        further: b_max - b_0 of each row, m and rad, shape (k_0,).
        rate: nu, 1/s.
        kept: I - T K k_I K^-1, what of A is left after a tick, shape (k_0, k_0).
        period: T, s.
    """

    gain: Array
    gain_inverse: Array
    same_kind: Array
    free: Array
    further: Array
    rate: float
    kept: Array
    period: float

    @classmethod
    def of_rows(
        cls,
        rows: TaskRows,
        bias: tuple[float, float],
        answered: tuple[float, float],
        *,
        gain: Array,
        forget: Array,
        rate: float,
        period: float,
    ) -> BoundedAnchor:
        """Return the bound on task rows.

        Args:
            rows: The task rows.
            bias: b_0, m and rad.
            answered: b_max, likewise.
            gain: G.
            forget: K k_I K^-1, 1/s, shape (k_0, k_0).
            rate: nu, 1/s.
            period: T, s.
        """
        is_position = rows.select(np.repeat([1.0, 0.0], 3))
        free, most = (is_position * b[0] + (1.0 - is_position) * b[1] for b in (bias, answered))
        same_kind = np.outer(is_position, is_position) + np.outer(1.0 - is_position, 1.0 - is_position)
        kept = np.eye(rows.size) - period * forget
        return cls(gain, inverse(gain)[0], same_kind, free, most - free, rate, kept, period)

    def step(self, state: AnchorState, asked: Array, age: float, may_move: float) -> tuple[Array, Array]:
        """Return what the anchor moves the integral by, N and N m, and C, shape (k_0,) each.

        Args:
            state: Memory.
            asked: a, N and N m, shape (k_0,).
            age: t - t_0, s.
            may_move: 1.0 where C may move, else 0.0.
        """
        y, C = self.gain_inverse.dot(state.moved + asked), state.centre
        along = self._sum(y * C) / np.maximum(self._sum(C * C), _TINY)
        off = y - C * np.minimum(np.maximum(along, 0.0), 1.0)
        beyond = off * (1.0 - self.free / np.maximum(self._norm(off), self.free))
        allowed = may_move * self.period * self.rate * np.exp(-self.rate * age) * self.further
        followed = beyond * np.minimum(1.0, allowed / np.maximum(self._norm(beyond), _TINY))
        return asked - self.gain.dot(beyond - followed), C + followed

    def forgotten(self, state: AnchorState, anchored: Array, centre: Array, torque: Array) -> AnchorState:
        """Return the memory after a tick."""
        return AnchorState(self.kept.dot(state.moved + anchored), centre, torque)

    def _sum(self, values: Array) -> Array:
        """Return for each row the sum over the rows of its kind, shape (k_0,)."""
        return self.same_kind.dot(values)

    def _norm(self, y: Array) -> Array:
        """Return for each row the norm of the rows of its kind, shape (k_0,)."""
        return self._sum(y * y) ** 0.5
