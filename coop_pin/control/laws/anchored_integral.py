"""Anchored integral: an integral of the motion's error that measured wrenches correct, and that leaks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial.generic_numbers import where
from coop_pin.control.laws.bounded_anchor import AnchorState, BoundedAnchor
from coop_pin.control.measurement import ArmMeasurement
from coop_pin.control.terms import is_new


class IntegralState(NamedTuple):
    """Memory of an anchored integral.

    Attributes:
        value: Z, N and N m, shape (k_0,).
        anchored: Z_hold, Z at the last new measurement, at first Z(t_0), shape (k_0,).
        wrench_age: age of the measured wrench at the last tick, in ticks; inf before the first sample.
        anchor: memory of the bounded anchor; None without a bound.
    """

    value: Array
    anchored: Array
    wrench_age: float
    anchor: AnchorState | None


class AnchoredIntegral(NamedTuple):
    """Integral Z of the error of the motion, which measured wrenches anchor, and which leaks without them.

    ::

        cut      Z <- Z - w,  Z_hold <- Z_hold - w           w is what drives cut of the last command
        anchor   Z <- Z - g (fhat - f_r),  Z_hold <- Z       once for each new measurement; Z of the torque
        leak     Z <- Z - lambda T (Z - Z_hold)              while no measurement is recent
        integral Z <- Z + T c K alpha phi(s)                 while no torque of the arm is saturated

    With a bound, see BoundedAnchor, the anchor moves no further than a stated bias explains. While
    measurements are recent the integral then takes over what drives cut, where they report it, and does not
    wait.

    Attributes:
        gain: g.
        leak: lambda, 1/s.
        share: c.
        period: T, s.
        stale_after: age in ticks beyond which a measurement is no longer recent.
        bound: bound of the anchor; None without.
    """

    gain: float
    leak: float
    share: float
    period: float
    stale_after: float = 3.0
    bound: BoundedAnchor | None = None

    def start(self, Z: Array) -> IntegralState:
        """Return the memory at t_0 with a first Z."""
        return IntegralState(Z, Z, np.inf, None if self.bound is None else self.bound.start())

    def step(
        self,
        state: IntegralState,
        measurement: ArmMeasurement,
        *,
        error: Array,
        age: float,
        push: Array,
        cut: Array | None,
        grip: float,
    ) -> tuple[Array, IntegralState]:
        """Return Z of the torque, N and N m, shape (k_0,), and the next memory.

        Args:
            state: Memory.
            measurement: Measurement of the arm.
            error: fhat - f_r, shape (k_0,).
            age: Age of fhat, ticks.
            push: K alpha phi(s), shape (k_0,).
            cut: w, shape (k_0,); None for none.
            grip: 0.0 where the arm has lost its grip and the anchor rests, else 1.0.
        """
        (Z, Z_hold, last, anchor), pose = state, measurement.payload_pose
        fresh, stale = is_new(age, last), age > self.stale_after
        uncut, recent = 1.0 - measurement.saturated.any(), 1.0 - stale
        a = fresh * (-grip * self.gain) * error
        if self.bound is not None and anchor is not None:
            if cut is not None:
                Z, Z_hold = Z - recent * cut, Z_hold - recent * cut
            a, anchor = self.bound.step(anchor, a, fresh, uncut * recent, pose)
        Z = Z + a
        Z_hold = where(fresh, Z, Z_hold)

        waits = self.bound is None or measurement.reported_torque is None
        goes_on = uncut if waits else where(stale, uncut, 1.0)
        change = self.period * (goes_on * self.share * push - stale * self.leak * (Z - Z_hold))
        if self.bound is not None and anchor is not None:
            anchor = self.bound.after(anchor, np.logical_not(stale), change, pose)
        return Z, IntegralState(Z + change, Z_hold, age, anchor)
