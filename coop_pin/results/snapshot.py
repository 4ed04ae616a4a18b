"""What a run shows of itself while it is under way."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

from coop_pin.arrays import Array, Mask


class Snapshot(NamedTuple):
    """A run at one tick, as it will stand in the result; all arrays are read-only. m arms, at most k joints each.

    Attributes:
        time: s.
        configuration: q of the tree, shape (nq,).
        payload_pose: X_WP, shape (4, 4).
        desired_pose: X_WP_d, shape (4, 4).
        tip_position: m, shape (m, 3).
        interaction_wrench: on each arm by the payload, about P in world axes; NaN in rows that rigid bodies
            do not determine, shape (m, 6).
        internal_wrench: f_i = F_i - c_i sum_j F_j, likewise.
        desired_internal_wrench: f_d_i turned by the payload, likewise.
        external_wrench: on the payload, about P in world axes, shape (6,).
        torque: drive torques as applied, N m, shape (m, k); NaN beyond an arm's joints.
        saturated: whether a torque was cut at its limit, shape (m, k).
        jacobian_condition: of each payload Jacobian, shape (m,).
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


Observer = Callable[[Snapshot], None]
"""Sees a run after every tick; it changes nothing."""


@runtime_checkable
class ThrottledObserver(Protocol):
    """An Observer that leaves moments out where they come too fast; it is shown the last one of a run in any case."""

    def __call__(self, moment: Snapshot) -> None:
        """See a moment, or leave it out."""

    def show(self, moment: Snapshot) -> None:
        """Show a moment now."""
