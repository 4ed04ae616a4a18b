"""Snapshot of a run at one tick, and the observers that are called with it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

from coop_pin.base.arrays import Array, Mask


class Snapshot(NamedTuple):
    """Quantities of a run at one tick, as its result will hold them; m arms, at most k joints each.

    All arrays are read-only; ``coop_pin.results.quantities.QUANTITIES`` declares what they are.

    Attributes:
        time: s.
        configuration: q of the tree, shape (nq,).
        payload_pose: X_WP, shape (4, 4).
        desired_pose: X_WP_d, shape (4, 4).
        tip_position: m, shape (m, 3).
        interaction_wrench: N and N m, shape (m, 6); NaN in rows that rigid bodies do not determine.
        internal_wrench: internal wrenches likewise.
        desired_internal_wrench: N and N m, shape (m, 6).
        external_wrench: N and N m, shape (6,).
        torque: drive torques, N m, shape (m, k); NaN beyond an arm's joints.
        saturated: mask of the torques that were cut, shape (m, k).
        jacobian_condition: condition number of each payload Jacobian, shape (m,).
        measured_internal_wrench: internal wrenches that the controllers get, N and N m, shape (m, 6); None
            where they are not recorded.
        partner_deflection: deflection of the partner's handle from its point, in axes of the point, m and
            rad, shape (6,); None in runs without a partner.
    """

    time: float
    configuration: Array
    payload_pose: Array
    desired_pose: Array
    tip_position: Array
    interaction_wrench: Array
    internal_wrench: Array
    desired_internal_wrench: Array
    external_wrench: Array
    torque: Array
    saturated: Mask
    jacobian_condition: Array
    measured_internal_wrench: Array | None = None
    partner_deflection: Array | None = None


Observer = Callable[[Snapshot], None]
"""Function that is called with a Snapshot after every tick; it does not change the run."""


@runtime_checkable
class ThrottledObserver(Protocol):
    """Rate-limited observer: it may drop snapshots, but the final one of a run is always shown."""

    def __call__(self, snapshot: Snapshot, /) -> None:
        """Show a snapshot, or drop it because the last one was shown too short a time ago."""

    def show(self, snapshot: Snapshot, /) -> None:
        """Show a snapshot now."""
