"""Anchored integral: an integral of the motion's error that measured wrenches correct, and that leaks."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial.generic_numbers import identity, known, where
from coop_pin.control.laws.bounded_anchor import AnchorState, BoundedAnchor
from coop_pin.control.measurement import ArmMeasurement
from coop_pin.control.terms import is_new, jacobian_inverse


class IntegralState(NamedTuple):
    """Memory of an anchored integral.

    Attributes:
        value: Z, N and N m, shape (k_0,).
        anchored: Z_hold, Z at the last new measurement, at first Z(t_0), shape (k_0,).
        wrench_age: age of the measured wrench at the last tick, in ticks; inf before the first sample.
    """

    value: Array
    anchored: Array
    wrench_age: float


Memories: TypeAlias = tuple[IntegralState, AnchorState | None]
"""Memories of the integral and of its bounded anchor, which there is with a bound."""


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
        stale_after: age in ticks beyond which a measurement is no longer recent.
        bound: bound of the anchor; None without.
    """

    gain: float
    leak: float
    stale_after: float = 3.0
    bound: BoundedAnchor | None = None

    def anchored(
        self,
        memories: Memories,
        measurement: ArmMeasurement,
        *,
        error: Array,
        age: float,
        grip: float,
        command: Array,
        J_plus: Array | None,
        uncut: float,
    ) -> Memories:
        """Return the memories with Z of the torque.

        Args:
            memories: Memories after the last tick.
            measurement: Measurement of the arm.
            error: fhat - f_r, shape (k_0,).
            age: Age of fhat, ticks.
            grip: 0.0 where the arm has lost its grip and the anchor rests, else 1.0.
            command: Torque of the last tick, N m, shape (k,).
            J_plus: J^+ where it is at hand, shape (k, k_0).
            uncut: 0.0 where a torque of the arm is saturated, else 1.0.
        """
        (Z, Z_hold, last), anchor = memories
        fresh, stale = is_new(age, last), age > self.stale_after
        recent = 1.0 - stale
        a = fresh * (-grip * self.gain) * error
        if self.bound is not None and anchor is not None:
            cut = _cut(measurement, command, J_plus)
            if cut is not None:
                Z, Z_hold = Z - recent * cut, Z_hold - recent * cut
            a, anchor = self.bound.step(anchor, a, fresh, uncut * recent, measurement.payload_pose)
        Z = Z + a
        return IntegralState(Z, where(fresh, Z, Z_hold), age), anchor

    def rates(self, state: IntegralState, measurement: ArmMeasurement, uncut: float) -> tuple[float, Array]:
        """Return 1.0 where the integral goes on and 0.0 where it waits, and the leak lambda (Z - Z_hold).

        Args:
            state: Z of the torque.
            measurement: Measurement of the arm.
            uncut: 0.0 where a torque of the arm is saturated, else 1.0.
        """
        Z, Z_hold, age = state
        stale = age > self.stale_after
        leak = stale * self.leak * (Z - Z_hold)
        waits = self.bound is None or measurement.reported_torque is None
        return uncut if waits else where(stale, uncut, 1.0), leak

    def following(self, memories: Memories, change: Array, pose: Array) -> Memories:
        """Return the memories for the next tick.

        Args:
            memories: Memories with Z of the torque.
            change: Change of Z after the torque, N and N m, shape (k_0,).
            pose: Payload pose as this arm measures it, shape (4, 4).
        """
        state, anchor = memories
        if self.bound is not None and anchor is not None:
            is_recent = np.logical_not(state.wrench_age > self.stale_after)
            anchor = self.bound.after(anchor, is_recent, change, pose)
        return state._replace(value=state.value + change), anchor


def _cut(measurement: ArmMeasurement, command: Array, J_plus: Array | None) -> Array | None:
    """Return w, the wrench that drives added to the last command, shape (k_0,); None if zero or unknown."""
    reported = measurement.reported_torque
    if reported is None:
        return None
    change = reported - command
    is_uncut = change.dot(change) == 0.0
    if known(is_uncut):
        return None
    if J_plus is None:  # only where it is used may a Jacobian not be singular
        J = measurement.payload_jacobian
        J_plus = jacobian_inverse(where(is_uncut, identity(len(J)), J), measurement.time)
    return J_plus.T.dot(change)
