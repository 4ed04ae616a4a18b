"""Forward and inverse dynamics of a closed chain: closure wrenches, and the torques of a motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coop_pin.base.arrays import Array, Mask, as_array
from coop_pin.base.errors import ArgumentError, ConstraintSolveError
from coop_pin.chain.closure_set import ClosureState
from coop_pin.chain.kkt_solver import ConstraintSVD

_ALLOWED = 1e-6
"""Largest accepted remainder, as a part of 1 and the largest entry of what must be balanced."""
_RANK = 1e-10
"""Singular values below this part of the largest are zero in the least-squares problems."""


Count: TypeAlias = int | NDArray[np.intp]
Result = TypeVar("Result", bound=tuple[Any, ...])


class InverseDynamics(NamedTuple):
    """Torques of a motion of a closed chain, of one state or of n states.

    Attributes:
        torque: generalised force tau, shape (..., nv); zero at joints without a motor.
        closure_wrenches: wrench on body a of each closure at frame a, in axes of a, shape (..., closures, 6).
        rank: number of independent closure rows, of n states shape (n,). Where it is less than the rows of
            ``constraint_jacobian``, other wrenches have the same torques.
    """

    torque: Array
    closure_wrenches: Array
    rank: Count


def over_states(
    function: Callable[..., Result], *arguments: tuple[str, ArrayLike | None, tuple[int, ...]]
) -> Result:
    """Return a named tuple of arrays and numbers at one state, or those of n states, stacked.

    Args:
        function: function of one state.
        arguments: name, value and shape at one state of each argument. The first one is of one state or of n,
            then with n as its first size; each other value is of all states, of each, or None.

    Raises:
        ArgumentError: n is 0.
        ShapeError: a shape differs.
        OutOfRangeError: an entry is not finite.
    """
    (name, first, shape), *others = arguments
    assert first is not None
    is_single = np.ndim(first) <= len(shape)
    states = [as_array(name, first, *shape)] if is_single else as_array(name, first, "n", *shape)
    if not len(states):
        raise ArgumentError(f"{name} has no states; give at least one")

    def of_each(name: str, value: ArrayLike | None, size: tuple[int, ...]) -> Any:
        if value is not None and np.ndim(value) > len(size) and not is_single:
            return as_array(name, value, len(states), *size)
        return [None if value is None else as_array(name, value, *size)] * len(states)

    results = [function(*state) for state in zip(states, *(of_each(*other) for other in others), strict=True)]
    stacked = type(results[0])(*map(np.array, zip(*results, strict=True)))
    return results[0] if is_single else stacked


def residual_allowed(a: Array) -> float:
    """Return the largest accepted residual of the closures at an acceleration, m/s^2 or rad/s^2."""
    return _ALLOWED * (1.0 + float(np.abs(a).max(initial=0.0)))


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
        motors: mask of the entries of tau with a motor, shape (nv,); the others are zero.

    Raises:
        ArgumentError: without motors at the other joints there is no such tau.
    """
    JT = state.jacobian.T
    passive = JT[~motors]
    unpowered = force[~motors]
    multipliers = _least_squares(passive, unpowered)
    _require_small(passive @ multipliers - unpowered, unpowered, "the motors cannot cause this motion")
    values, rows = np.linalg.svd(passive, full_matrices=True)[1:]
    free = np.asarray(rows[int(np.count_nonzero(values > _RANK * values[:1])) :].T)  # of their null space
    driven = JT[motors] @ free
    driven[np.abs(driven) < _RANK * np.abs(JT).max(initial=0.0)] = 0.0  # rounding, which would be divided by
    multipliers = multipliers + free @ _least_squares(driven, force[motors] - JT[motors] @ multipliers)
    return motors * (force - JT @ multipliers), multipliers


def torque_of_motion(
    state: ClosureState,
    a: Array,
    force: Array,
    wrenches: Array | None,
    applied: Array | None,
    motors: Mask,
    rank: int,
) -> InverseDynamics:
    """Return the torques at one state.

    Args:
        state: closures of the state.
        a: acceleration, shape (nv,).
        force: M a + h, shape (nv,).
        wrenches: stated closure wrenches, shape (closures, 6); None for those of least torque.
        applied: generalised force of everything but motors and closures, shape (nv,); None is zero.
        motors: mask of the entries of tau with a motor, shape (nv,).
        rank: number of independent closure rows.

    Raises:
        ArgumentError: the acceleration opens the closures, or as of multipliers_of and least_torque.
    """
    opening, allowed = float(np.abs(state.jacobian @ a + state.drift).max(initial=0.0)), residual_allowed(a)
    if not opening <= allowed:
        raise ArgumentError(
            f"a opens the closures: J a + gamma is {opening:.3g} m/s^2 or rad/s^2 (allowed"
            f" {allowed:.3g}); take one that forward_dynamics returns"
        )
    force = force - (0.0 if applied is None else applied)
    if wrenches is None:
        tau, multipliers = least_torque(state, force, motors)
    else:
        multipliers = multipliers_of(state, wrenches)
        tau = force - state.jacobian.T @ multipliers
    return InverseDynamics(tau, state.wrench_map @ multipliers, rank)


def _least_squares(A: Array, b: Array) -> Array:
    """Return the x of least norm among those of least |A x - b|, shape (n,)."""
    return np.asarray(np.linalg.lstsq(A, b, rcond=_RANK)[0], dtype=np.float64)


def _require_small(remainder: Array, target: Array, reason: str) -> None:
    largest = float(np.abs(remainder).max(initial=0.0))
    allowed = residual_allowed(target)
    if not largest <= allowed:
        raise ArgumentError(f"{reason}: {largest:.3g} N or N m remain (allowed {allowed:.3g})")


class ChainDynamics(NamedTuple):
    """Forward dynamics of a closed chain.

    Attributes:
        acceleration: a, shape (nv,).
        closure_wrenches: wrench on body a of each closure at frame a, in axes of a, N and N m, shape
            (closures, 6).
            If rows are redundant, it is not unique for rigid bodies; this is the one of least multipliers.
        rank: number of independent closure rows.
        residual: largest entry of J a + gamma + stabilisation, m/s^2 or rad/s^2.
    """

    acceleration: Array
    closure_wrenches: Array
    rank: int
    residual: float


def checked_dynamics(
    state: ClosureState, svd: ConstraintSVD, a: Array, wrenches: Array, residual: Array
) -> ChainDynamics:
    """Return accelerations and closure wrenches of a solver, these with least multipliers.

    Args:
        state: closures of the state.
        svd: singular value decomposition of the constraint Jacobian.
        a: acceleration, shape (nv,).
        wrenches: closure wrenches of the solver, shape (closures, 6).
        residual: J a + gamma + stabilisation, shape (r,).

    Raises:
        ConstraintSolveError: the residual is too large.
    """
    largest = float(np.abs(residual).max(initial=0.0))
    # Near a singular pose the truncated rows add to it.
    allowed = residual_allowed(a) + 10.0 * svd.dropped * float(np.linalg.norm(svd.factor.T @ a))
    if not largest <= allowed:
        raise ConstraintSolveError(largest, allowed)
    if svd.rank < len(state.position):
        # Each proximal step adds rounding / mu along null(J^T): 1e-5 of a Bennett linkage's wrenches.
        wrenches = state.wrench_map @ (svd.left @ (svd.left.T @ multipliers_of(state, wrenches)))
    return ChainDynamics(a, wrenches, svd.rank, largest)
