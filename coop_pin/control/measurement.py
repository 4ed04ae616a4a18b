"""What one arm's controller may know at a tick: arrays and floats, nothing that could be asked for dynamics."""

from __future__ import annotations

from typing import NamedTuple

from coop_pin.arrays import Array, Mask


class ArmMeasurement(NamedTuple):
    """One arm at one tick, in drive coordinates and the cell's k_0 task rows. The arrays are read-only.

    Attributes:
        time: t_k, s.
        q: drive angles, rad, shape (nq,).
        v: drive rates, rad/s, shape (k,).
        payload_pose: X_WP as this arm's own forward kinematics sees it, shape (4, 4).
        payload_twist: V_WP likewise, in world axes, shape (k_0,).
        payload_jacobian: J_phi with V_WP = J_phi v, shape (k_0, k).
        internal_wrench: measured internal wrench on this arm about P in world axes, shape (k_0,), or None where the
            scenario's force path provides none.
        saturated: which drive torques were cut at their limits over the last tick, shape (k,); all false at the first.
    """

    time: float
    q: Array
    v: Array
    payload_pose: Array
    payload_twist: Array
    payload_jacobian: Array
    internal_wrench: Array | None
    saturated: Mask
