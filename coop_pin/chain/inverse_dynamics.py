"""Inverse dynamics of a closed chain: the torques of a motion, and of a wrench in its closures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.chain.closure_set import ClosureState
from coop_pin.errors import ArgumentError

_ALLOWED = 1e-6
"""Largest accepted remainder, as a part of 1 and the largest entry of what must be balanced."""
_RANK = 1e-10
"""Singular values below this part of the largest are zero in the least-squares problems."""


class InverseDynamics(NamedTuple):
    """Torques of a motion of a closed chain.

    Attributes:
        torque: generalised force tau, shape (nv,); zero at joints without a motor.
        closure_wrenches: wrench on body a of each closure at frame a, in axes of a, shape (closures, 6).
    """

    torque: Array
    closure_wrenches: Array


def multipliers_of(state: ClosureState, wrenches: Array) -> Array:
    """Return the multipliers lambda of stated closure wrenches, shape (r,).

    Args:
        state: closures of the state.
        wrenches: wrench on body a of each closure at frame a, in axes of a, shape (closures, 6).

    Raises:
        ArgumentError: a wrench has a part that the rows of its closure do not transmit.
    """
    stacked, target = state.wrench_map.reshape(wrenches.size, -1), wrenches.ravel()
    multipliers = _least_squares(stacked, target)
    _require_small(stacked @ multipliers - target, target, "the closures transmit no wrench of this kind")
    return multipliers


def least_torque(state: ClosureState, force: Array, motors: Mask) -> tuple[Array, Array]:
    """Return the tau and lambda of least tau^T tau with ``tau + J^T lambda = force``.

    Args:
        state: closures of the state.
        force: M a + h, shape (nv,).
        motors: which entries of tau have a motor, shape (nv,); the others are zero.

    Raises:
        ArgumentError: without motors at the other joints there is no such tau.
    """
    JT = state.jacobian.T
    passive = JT[~motors]
    wanted = force[~motors]
    multipliers = _least_squares(passive, wanted)
    _require_small(passive @ multipliers - wanted, wanted, "the motors cannot cause this motion")
    free = _null_space(passive)
    driven = JT[motors] @ free
    driven[np.abs(driven) < _RANK * np.abs(JT).max(initial=0.0)] = 0.0  # rounding, which would be divided by
    multipliers = multipliers + free @ _least_squares(driven, force[motors] - JT[motors] @ multipliers)
    return motors * (force - JT @ multipliers), multipliers


def _least_squares(A: Array, b: Array) -> Array:
    """Return the x of least norm among those of least |A x - b|, shape (n,)."""
    return np.asarray(np.linalg.lstsq(A, b, rcond=_RANK)[0], dtype=np.float64)


def _null_space(A: Array) -> Array:
    """Return an orthonormal basis of the null space of A, shape (n, d)."""
    values, rows = np.linalg.svd(A, full_matrices=True)[1:]
    rank = int(np.count_nonzero(values > _RANK * values[:1]))
    return np.asarray(rows[rank:].T)


def _require_small(remainder: Array, target: Array, reason: str) -> None:
    largest = float(np.abs(remainder).max(initial=0.0))
    allowed = _ALLOWED * (1.0 + float(np.abs(target).max(initial=0.0)))
    if not largest <= allowed:
        raise ArgumentError(f"{reason}: {largest:.3g} N or N m remain (allowed {allowed:.3g})")
