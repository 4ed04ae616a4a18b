"""Baumgarte stabilisation of loop closures."""

from __future__ import annotations

from coop_pin.arrays import Array
from coop_pin.schema.base import Description, NotNegative


class Stabilisation(Description):
    """Baumgarte stabilisation: a closure error e obeys e'' + 2 zeta omega e' + omega^2 e = 0.

    The Baumgarte terms 2 zeta omega e' + omega^2 e are added to the closures' acceleration constraint
    J a + gamma = 0, with e in m and rad (Baumgarte 1972; Featherstone 2008, chapter 8).

    Attributes:
        frequency: omega, the rate at which a closure error decays, rad/s; 0 switches the stabilisation off.
        damping_ratio: zeta; 1 is the fastest decay without overshoot.
    """

    frequency: NotNegative = 10.0
    damping_ratio: NotNegative = 1.0

    @property
    def position_gain(self) -> float:
        """Factor omega^2 of the closure error, 1/s^2."""
        return self.frequency**2

    @property
    def velocity_gain(self) -> float:
        """Factor 2 zeta omega of the closure error's rate, 1/s."""
        return 2.0 * self.damping_ratio * self.frequency

    def stabilised(self, acceleration: Array, velocity: Array, position: Array) -> Array:
        """Return e'' + 2 zeta omega e' + omega^2 e, shape (r,), which the constrained dynamics make zero.

        Args:
            acceleration: e'', or the part of it that is known, m/s^2 and rad/s^2, shape (r,).
            velocity: e', m/s and rad/s, shape (r,).
            position: e, m and rad, shape (r,).
        """
        return acceleration + self.velocity_gain * velocity + self.position_gain * position
