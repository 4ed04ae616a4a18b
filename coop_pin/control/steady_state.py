"""Law near rest: its model there, and the force that it holds at rest by an error of the position."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

LARGEST_SAG = 1.0
"""A load that is not carried within it counts as dropped, m."""


class NearRest(NamedTuple):
    """Model of a law near rest on the reference.

    Attributes:
        integral: Kind of its integral of the error; that of a sign has no linear model.
        linear_speed: Speed up to which the damping is linear, m/s or rad/s; of laws that add signs, beyond
            which.
        is_zeroed: Whether the arms place their payload frames at the start pose, once.
    """

    integral: Literal["none", "linear", "sign"] = "none"
    linear_speed: float = 1.0
    is_zeroed: bool = False


class SteadyDirection(NamedTuple):
    """A law at rest in one direction of the position, for an arm with the whole load share.

    Attributes:
        spring: Force by an error x, m, as a function of it, N; zero where an anchor takes its part out of the
            internal force or the load.
        integral: Rate of the integral by an error, N/s, as a function of it.
        internal_rate: Rate at which the integral loses internal force, 1/s.
        load_rate: Rate at which the integrals' sum loses the load, 1/s; 0 if it does not.
        free: b_0 of an anchor's bound, m; inf without one.
        most: Largest ``|b_i - bbar|`` from the start on that an anchor follows, m; inf without a bound.
        force_gain: K_f of a measured internal wrench.
        apart: Part of a bias by which the arms' views differ: 0 where all arms see the mean of their views.
        rests: delta, half width of a dead zone of the integral, m; 0 without one.
    """

    spring: Callable[[float], float]
    integral: Callable[[float], float] = lambda _: 0.0
    internal_rate: float = 0.0
    load_rate: float = 0.0
    free: float = np.inf
    most: float = np.inf
    force_gain: float = 0.0
    apart: float = 1.0
    rests: float = 0.0

    def held(self, error: float, rate: float) -> float:
        """Return spring(x) + integral(x) / rate, N: what an arm with the whole share holds."""
        integral = self.integral(error)
        return self.spring(error) + (integral / rate if rate else np.inf if integral else 0.0)

    def force(self, share: float, bias: float) -> float:
        """Return the internal force in an arm whose view is b off, (1 - c) b off the mean, N.

        What an error holds at once, K_f divides by 1 + K_f; what an integral holds, it does not.
        """
        x = (1.0 - share) * self.apart * bias
        if self.rests:
            return self.after_slow_load(share, bias, 0.0)
        if self.growth(share, bias) > 0.0 and self.internal_rate > 0.0:
            return np.inf
        divided = self.spring(x) * (1.0 - 1.0 / (1.0 + self.force_gain))
        return share * (self.held(x, self.internal_rate) - divided)

    def growth(self, share: float, bias: float) -> float:
        """Return the rate at which that force grows where it has no bound, N/s."""
        held = min(bias, self.limit(share)) if self.internal_rate or self.rests else 0.0
        off = (1.0 - share) * self.apart
        rate = self.integral(off * bias) - self.integral(off * held)
        return share * rate / (1.0 + self.force_gain)

    def after_slow_load(self, share: float, bias: float, load: float) -> float:
        """Return the force in that arm after a load that came slowly, N, of an integral with a dead zone.

        The arm that is further off takes all that the springs do not hold where its integral begins, at
        x + b = delta: (1 - c) (L - spring(delta - b)). Inf for views that differ by more than the zone.
        """
        b = self.apart * bias
        if b > 2.0 * self.rests:
            return np.inf
        held = np.sign(self.rests - b) * self.spring(abs(self.rests - b))
        return max(share * self.spring((1.0 - share) * b), (1.0 - share) * (load - held))

    def limit(self, share: float) -> float:
        """Return the largest bias of an arm, m, that is sure to come to rest.

        Either every anchor follows its part, the arm's own and that of an arm with the other share, or half
        of it is within b_0 or a dead zone: the payload then comes to rest between the views.
        """
        if self.rests:
            return 2.0 * self.rests
        return max(self.most / max(share, 1.0 - share), 2.0 * self.free)

    def unreachable(self, share: float) -> float:
        """Return the force error that an arm cannot change, N, against which the payload is held."""
        if np.isfinite(self.free) or not self.internal_rate:
            return np.inf
        return share * self.integral(LARGEST_SAG) / self.internal_rate
