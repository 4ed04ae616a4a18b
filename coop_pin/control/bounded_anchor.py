"""The bounded anchor: measured wrenches move an integral as far as a stated bias may ask for."""

from __future__ import annotations

from typing import Any, NamedTuple

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
        centre: C, the bias that the start has shown, m and rad, shape (k_0,).
    """

    moved: Array
    centre: Array


class BoundedAnchor(NamedTuple):
    """Bound of what the anchor of an integral moves, in the biases of the kinematics that would ask for it.

    ::

        y        = G^-1 (A + a)                              a is what the anchor asks for at this tick
        goal     = y min(max(2 |y| / b_0 - 1, 0), 1)         0 for |y| < b_0 / 2, y for |y| > b_0
        C       <- C + (goal - C) min(1, d / |goal - C|)     d = T nu (b_max - b_0) exp(-nu (t - t_0))
        off      = y - C min(max(y.C / |C|^2, 0), 1)         from the nearest point between 0 and C
        anchored = a - G off (1 - b_0 / max(|off|, b_0))     exactly a while |off| <= b_0
        A       <- (I - T K k_I K^-1) (A + anchored)         while measurements are recent
        A       <- A + what else changes the integral        while they are not: the next ones take it back

    Norms and products are those of positions and those of rotations, each by itself. A constant bias moves A
    only while it takes effect after the start, and C follows it; later, what moves A is no bias.

    Attributes:
        gain: G = c K gamma, shape (k_0, k_0).
        gain_inverse: G^-1.
        same_kind: 1.0 between two positions or two rotations, else 0.0, shape (k_0, k_0).
        free: b_0 of each row, m and rad, shape (k_0,).
        further: b_max - b_0 of each row, likewise.
        rate: nu, 1/s.
        kept: I - T K k_I K^-1, shape (k_0, k_0).
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
        biases: tuple[tuple[float, float], tuple[float, float]],
        *,
        gain: Array,
        forget: Array,
        largest: Array,
        rate: float,
        period: float,
    ) -> BoundedAnchor:
        """Return the bound on task rows.

        Args:
            rows: The task rows.
            biases: b_0 and b_max, m and rad each.
            gain: G.
            forget: K k_I K^-1, 1/s, shape (k_0, k_0).
            largest: Largest errors within the layer of the integral, m and rad, shape (k_0,).
            rate: nu, 1/s.
            period: T, s.
        """
        positions, angles = (rows.select(np.repeat(pair, 3)) for pair in ((1.0, 0.0), (0.0, 1.0)))
        same_kind = np.outer(positions, positions) + np.outer(angles, angles)
        edge = np.array([largest[row > 0.0].min() for row in same_kind])
        free, most = (rows.select(np.repeat(bias, 3)) for bias in biases)
        free, most = within_layer(free, most, edge)
        kept = np.eye(rows.size) - period * forget
        return cls(gain, inverse(gain)[0], same_kind, free, most - free, rate, kept, period)

    def start(self) -> AnchorState:
        """Return the memory at t_0."""
        return AnchorState(np.zeros_like(self.free), np.zeros_like(self.free))

    def step(
        self, state: AnchorState, asked: Array, age: float, fresh: float, may_follow: float
    ) -> tuple[Array, AnchorState]:
        """Return what the anchor moves the integral by, N and N m, shape (k_0,), and the memory with it.

        Args:
            state: Memory.
            asked: a, N and N m, shape (k_0,).
            age: t - t_0, s.
            fresh: 1.0 where the measurement is new, else 0.0: then nothing is asked, and no bound acts.
            may_follow: 1.0 where C may move, else 0.0.
        """
        y, C = self.gain_inverse.dot(state.moved + asked), state.centre
        goal = y * _part(2.0 * self._norm(y) / self.free - 1.0) - C
        allowed = may_follow * self.period * self.rate * np.exp(-self.rate * age) * self.further
        C = C + goal * np.minimum(1.0, allowed / np.maximum(self._norm(goal), _TINY))
        off = y - C * _part(self._sum(y * C) / np.maximum(self._sum(C * C), _TINY))
        beyond = off * (1.0 - self.free / np.maximum(self._norm(off), self.free))
        anchored = asked - fresh * self.gain.dot(beyond)
        return anchored, AnchorState(state.moved + anchored, C)

    def after(self, state: AnchorState, stale: float, change: Array) -> AnchorState:
        """Return the memory after a tick.

        Args:
            state: Memory with what the anchor has moved.
            stale: 1.0 where no measurement is recent, else 0.0.
            change: What else changes the integral, N and N m, shape (k_0,).
        """
        A = state.moved
        return state._replace(moved=np.where(stale, A + change, self.kept.dot(A)))

    def _sum(self, values: Array) -> Array:
        """Return for each row the sum over the rows of its kind, shape (k_0,)."""
        return self.same_kind.dot(values)

    def _norm(self, values: Array) -> Array:
        """Return for each row the norm of the rows of its kind, shape (k_0,)."""
        return self._sum(values * values) ** 0.5


def within_layer(free: Any, most: Any, largest: Any) -> tuple[Any, Any]:
    """Return b_0, at most half of the largest error within the layer, and b_max, at most that error."""
    return np.minimum(free, largest / 2.0), np.minimum(most, largest)


def _part(values: Array) -> Array:
    """Return values limited to [0, 1]."""
    return np.minimum(np.maximum(values, 0.0), 1.0)
