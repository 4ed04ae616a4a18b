"""Bounded anchor: measured wrenches move an integral no further than a stated bias explains."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial.generic_numbers import exp, inverse, known, where
from coop_pin.control.terms import GainAxes

_TINY = 1e-300
"""Stands for 0 in a quotient of two lengths."""
_STANDS = float(np.exp(-8.0))
"""Part of its first step below which the centre stands still."""
_NEARLY = 1.02
"""Factor of y with which a bound that is nearly reached counts as reached."""
_TINY_PART, _LAGS = 1e-6, 30.0
"""Accuracy of a limit as a part of it, and time constants after which nothing moves."""


class AnchorState(NamedTuple):
    """Memory of a bounded anchor.

    Attributes:
        held: y = G^-1 A, the bias that explains A, what the anchor has moved within about 1 / k_I, m and rad,
            shape (k_0,).
        from_base: C_B, the bias that the start has shown, as of a base that is off: constant in world axes, m
            and rad, shape (k_0,).
        from_tip: C_E, the same as of a tip that is off: constant in payload axes, m and rad, shape (k_0,).
        measured_for: t_m, time with recent measurements since t_0, s.
    """

    held: Array
    from_base: Array
    from_tip: Array
    measured_for: float


class BoundedAnchor(NamedTuple):
    """Bound of what the anchor of an integral moves, in the biases of the kinematics that would explain it.

    ::

        y        = y + G^-1 a                                a is the step of an anchor without a bound
        C        = (C_B + R C_E) / 2                         R as this arm sees the payload
        goal     = y min(max(2 |y| / b_0 - 1, 0), 1)         0 for |y| < b_0 / 2, y for |y| > b_0
        step     = (goal - C) min(1, d / |goal - C|)         d = T nu (b_max - b_0) h
        h        = max(exp(-nu t_m) - exp(-8), 0)
        C_B     <- C_B + step,  C_E <- C_E + R^T step
        b        = b_0 + |C_B - R C_E| / 2                   b_0 until the payload turns
        off      = y - C min(max(y.C / |C|^2, 0), 1)         from the nearest point between 0 and C
        beyond   = off (1 - b / max(|off|, b))               exactly 0 while |off| <= b
        anchored = a - G beyond
        y       <- (1 - T k_I) (y - beyond)                  while measurements are recent
        y       <- y - beyond + G^-1 (what else changes)     while they are not: the next ones take it back

    Norms and products are those of positions and those of rotations, each by itself. A constant bias moves A
    only while it takes effect after the first measurements, and C follows it; later, what moves A is no bias.
    A bias turns with the payload as far as it is of the tip, which the start does not show: b covers both.

    Attributes:
        axes: axes of G; where they turn with the payload, A is kept as the biases that explained its
            parts at their time.
        gain: G = c K gamma, shape (k_0, k_0).
        gain_inverse: G^-1.
        same_kind: 1.0 between two positions or two rotations, else 0.0, shape (k_0, k_0).
        free: b_0 of each row, m and rad, shape (k_0,).
        first: T nu (b_max - b_0) of each row, the first step of a centre, likewise.
        rate: nu, 1/s.
        kept: 1 - T k_I, shape (k_0,).
        period: T, s.
    """

    axes: GainAxes
    gain: Array
    gain_inverse: Array
    same_kind: Array
    free: Array
    first: Array
    rate: float
    kept: Array
    period: float

    @classmethod
    def of_rows(
        cls,
        axes: GainAxes,
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
            axes: Axes of G.
            biases: b_0 and b_max, m and rad each.
            gain: G.
            forget: k_I, 1/s, shape (k_0,).
            largest: Edges of the layer of the integral as errors, m and rad, shape (k_0,).
            rate: nu, 1/s.
            period: T, s.
        """
        rows = axes.rows
        positions, angles = (rows.select(np.repeat(pair, 3)) for pair in ((1.0, 0.0), (0.0, 1.0)))
        same_kind = np.outer(positions, positions) + np.outer(angles, angles)
        b_0, b_max = (rows.select(np.repeat(bias, 3)) for bias in biases)
        edge = np.array([largest[row > 0.0].min() for row in same_kind])
        free = np.minimum(b_0, edge / 2.0)
        further = np.minimum(b_max - b_0, same_kind.dot(largest**2) ** 0.5 - free)
        first, kept = period * rate * further, 1.0 - period * forget
        return cls(axes, gain, inverse(gain)[0], same_kind, free, first, rate, kept, period)

    def start(self) -> AnchorState:
        """Return the memory at t_0."""
        nothing = np.zeros_like(self.free)
        return AnchorState(nothing, nothing, nothing, 0.0)

    def step(
        self, state: AnchorState, a: Array, fresh: float, may_follow: float, pose: Array
    ) -> tuple[Array, AnchorState]:
        """Return what the anchor moves the integral by, N and N m, shape (k_0,), and the memory with it.

        Args:
            state: Memory.
            a: step of an anchor without a bound, N and N m, shape (k_0,).
            fresh: 1.0 where the measurement is new, else 0.0: then a is 0, and no bound acts.
            may_follow: 1.0 where C may move, else 0.0.
            pose: Payload pose as this arm sees it, shape (4, 4).
        """
        y, C_B, C_E = (
            state.held + self.axes.product(self.gain_inverse, pose, a),
            state.from_base,
            state.from_tip,
        )
        part = y / self.free
        size = part.dot(part)  # (|y| / b_0)^2 of positions and rotations together
        left = exp(-self.rate * state.measured_for) - _STANDS
        h = may_follow * where(left > 0.0, left, 0.0)
        # What is known to do nothing is left out, with the same bits.
        has_none = C_B.dot(C_B) + C_E.dot(C_E) == 0.0
        stands = known(h == 0.0) or (known(size <= 0.25) and known(has_none))
        if stands and known(size <= 1.0):
            return a, AnchorState(y, C_B, C_E, state.measured_for)
        turned = self.axes.rows.turn(pose, C_E)
        if not stands:
            way = y * _part(2.0 * self._norm(y) / self.free - 1.0) - (C_B + turned) / 2.0
            step = way * np.minimum(1.0, h * self.first / np.maximum(self._norm(way), _TINY))
            C_B, C_E, turned = C_B + step, C_E + self.axes.rows.turn(pose.T, step), turned + step
        beyond = fresh * self._beyond(y, C_B, turned)
        return a - self.axes.product(self.gain, pose, beyond), AnchorState(
            y - beyond, C_B, C_E, state.measured_for
        )

    def _beyond(self, y: Array, C_B: Array, turned: Array) -> Array:
        """Return the part of y beyond the bound, with R C_E, m and rad, shape (k_0,)."""
        C, b = (C_B + turned) / 2.0, self.free + self._norm(C_B - turned) / 2.0
        off = y - C * _part(self.same_kind.dot(y * C) / np.maximum(self.same_kind.dot(C * C), _TINY))
        return off * (1.0 - b / np.maximum(self._norm(off), b))

    def centre(self, state: AnchorState, pose: Array) -> Array:
        """Return C at a payload pose, m and rad, shape (k_0,)."""
        C: Array = (state.from_base + self.axes.rows.turn(pose, state.from_tip)) / 2.0
        return C

    def is_reached(self, state: AnchorState, pose: Array) -> bool:
        """Return whether the bound acts, to 2 %, at a payload pose."""
        y, turned = state.held / self.kept, self.axes.rows.turn(pose, state.from_tip)
        return bool(self._beyond(_NEARLY * y, state.from_base, turned).any())

    def after(self, state: AnchorState, is_recent: bool, change: Array, pose: Array) -> AnchorState:
        """Return the memory after a tick.

        Args:
            state: Memory with what the anchor has moved.
            is_recent: Whether a measurement is recent.
            change: Change of the integral by all else, N and N m, shape (k_0,).
            pose: Payload pose as this arm sees it, shape (4, 4).
        """
        _, C_B, C_E, t_m = state
        held = self.kept * state.held
        if not known(is_recent):
            held = where(is_recent, held, state.held + self.axes.product(self.gain_inverse, pose, change))
        return AnchorState(held, C_B, C_E, t_m + is_recent * self.period)

    def followed_bias(self, row: int, *, part: float, transient_rate: float) -> float:
        """Return the largest ``|b_i - bbar|`` from t_0 on that the bound holds at the end, m or rad.

        Without a turn of the payload, along a row: the anchor follows it by two lags in series, and C follows
        the anchor by at most d at a tick, all the while that a bound acts::

            y[k] = |b_i - bbar| (1 - (1 - h)^k - h (q^k - (1 - h)^k) / (q - 1 + h)),  q = exp(-kappa T)
            C[k] = min(goal[k], C[k-1] + d[k]),  |b_i - bbar| <= C[inf] + b_0

        Args:
            row: Index of the task row.
            part: h, the part of a force error that the anchor takes out at a tick.
            transient_rate: kappa, 1/s.
        """
        step, b_0 = self.rate * self.period, float(self.free[row])
        ticks = np.arange(1.0, _LAGS / step)
        kept, q = 1.0 - part, np.exp(-transient_rate * self.period * (1.0 + _TINY_PART))
        y = 1.0 - kept**ticks - part * (q**ticks - kept**ticks) / (q - kept)
        path = np.cumsum(self.first[row] * np.exp(-step * ticks))

        def centre(size: float) -> float:
            goal = size * y * _part(2.0 * size * y / b_0 - 1.0)
            return float(path[-1] + min((goal - path).min(), 0.0))

        low, high = b_0, b_0 + float(self.first[row]) / step
        while high - low > _TINY_PART * high:
            middle = (low + high) / 2.0
            low, high = (middle, high) if middle <= centre(middle) + b_0 else (low, middle)
        return low

    def _norm(self, values: Array) -> Array:
        """Return for each row the norm of the rows of its kind, shape (k_0,)."""
        return self.same_kind.dot(values * values) ** 0.5


def _part(values: Array) -> Array:
    """Return values limited to [0, 1]."""
    return np.minimum(np.maximum(values, 0.0), 1.0)
