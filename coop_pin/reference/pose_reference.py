"""Is a reference's twist the derivative of its pose, and its acceleration that of its twist?"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array, as_array, frozen
from coop_pin.errors import InconsistentReferenceError, NotAPoseError, NotIncreasingError, OutOfRangeError


class PoseTarget(NamedTuple):
    """The desired motion of the payload at one time; read-only arrays."""

    X_WP_d: Array
    """Desired pose of the payload frame P in the world W, m, shape (4, 4)."""

    V_WP_d: Array
    """Desired twist of P in world axes at the origin of P, linear first, m/s and rad/s, shape (6,)."""

    A_WP_d: Array
    """Time derivative of V_WP_d: acceleration of the origin of P and angular acceleration, m/s^2 and rad/s^2, shape (6,)."""


class PoseReference(ABC):
    """A desired payload motion, defined at every time; the pose is continuous and its twist is V_WP_d."""

    @abstractmethod
    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""


NO_VECTOR: Array = frozen(np.zeros(3))
"""A vector of zeros, read-only."""


def make_target(
    R: Array,
    p: Array,
    v: Array = NO_VECTOR,
    omega: Array = NO_VECTOR,
    a: Array = NO_VECTOR,
    alpha: Array = NO_VECTOR,
) -> PoseTarget:
    """Return the target of a motion given in parts, all in world axes.

    Args:
        R: rotation matrix of P in W, shape (3, 3).
        p: position of P, m, shape (3,).
        v: its rate, m/s, shape (3,).
        omega: angular rate, rad/s, shape (3,).
        a: rate of v, m/s^2, shape (3,).
        alpha: rate of omega, rad/s^2, shape (3,).
    """
    X_WP_d = np.zeros((4, 4))
    X_WP_d[:3, :3] = R
    X_WP_d[:3, 3] = p
    X_WP_d[3, 3] = 1.0
    V_WP_d = np.concatenate((v, omega))
    A_WP_d = np.concatenate((a, alpha))
    return PoseTarget(frozen(X_WP_d), frozen(V_WP_d), frozen(A_WP_d))


POSE_ALLOWED = 1e-6
"""Largest accepted entry of R^T R - I: poses typed to seven digits pass."""

_IDENTITY = frozen(np.eye(3))
_LAST_ROW = frozen(np.array((0.0, 0.0, 0.0, 1.0)))


def keep(instance: object, **values: object) -> None:
    """Write checked values into the fields of a frozen dataclass, arrays read-only; for __post_init__ only."""
    for name, value in values.items():
        object.__setattr__(instance, name, frozen(value) if isinstance(value, np.ndarray) else value)


def as_number(name: str, value: ArrayLike) -> float:
    """Return value as a finite float.

    Raises:
        ShapeError: it is not a single number.
        OutOfRangeError: it is NaN or infinite.
    """
    return float(as_array(name, value))


def as_positive(name: str, value: ArrayLike) -> float:
    """Return value as a finite float greater than zero.

    Raises:
        ShapeError: it is not a single number.
        OutOfRangeError: it is NaN or infinite; it is zero or less.
    """
    number = as_number(name, value)
    if number <= 0.0:
        raise OutOfRangeError(name, number)
    return number


def as_pose(name: str, value: ArrayLike) -> Array:
    """Return value as a pose, shape (4, 4).

    Raises:
        ShapeError: the shape differs.
        OutOfRangeError: an entry is NaN or infinite.
        NotAPoseError: the 3x3 block is no rotation matrix or the last row is not 0 0 0 1.
    """
    pose = as_array(name, value, 4, 4)
    rotation = pose[:3, :3]
    deviation = float(max(np.abs(rotation.T @ rotation - _IDENTITY).max(), np.abs(pose[3] - _LAST_ROW).max()))
    if deviation > POSE_ALLOWED:
        raise NotAPoseError(name, deviation, POSE_ALLOWED)
    if np.linalg.det(rotation) < 0.0:
        raise NotAPoseError(f"{name} (a mirror image)", 2.0, POSE_ALLOWED)
    return pose


def as_unit_vector(name: str, value: ArrayLike) -> Array:
    """Return value scaled to length one, shape (3,).

    Raises:
        ShapeError: the shape differs.
        OutOfRangeError: an entry is NaN or infinite; its length is zero.
    """
    vector = as_array(name, value, 3)
    unit: Array = vector / as_positive(f"length of {name}", float(np.linalg.norm(vector)))
    return unit


def as_times(name: str, value: ArrayLike) -> Array:
    """Return value as strictly increasing times, s, shape (n,).

    Raises:
        ShapeError: it is not a list of numbers.
        OutOfRangeError: an entry is NaN or infinite.
        NotIncreasingError: an entry is not greater than the one before it.
    """
    times = as_array(name, value, "n")
    backward = np.flatnonzero(np.diff(times) <= 0.0)
    if backward.size:
        index = int(backward[0]) + 1
        raise NotIncreasingError(name, index, float(times[index]), float(times[index - 1]))
    return times


OFFSETS: tuple[float, ...] = (-2.0, -1.0, 1.0, 2.0)
FIRST: Array = np.array((1.0, -8.0, 8.0, -1.0)) / 12.0
SECOND: Array = np.array((-1.0, 16.0, 16.0, -1.0)) / 12.0


def displacements(pose_function: Callable[[float], Array], time: float, step: float) -> Array:
    """Return ``[p(t + o h) - p(t), log(R(t + o h) R(t)^T)]`` for the offsets o, world axes, shape (4, 6).

    Args:
        pose_function: time in s -> pose, shape (4, 4).
        time: t, s.
        step: h, s.
    """
    X = pose_function(time)
    around = np.stack([pose_function(time + offset * step) for offset in OFFSETS])
    turns = Rotation.from_matrix(around[:, :3, :3] @ X[:3, :3].T).as_rotvec()
    return np.hstack((around[:, :3, 3] - X[:3, 3], np.reshape(turns, (-1, 3))))


def twist_from(displaced: Array, step: float) -> Array:
    """Return the twist in world axes, shape (6,), from displacements: omega is the rate of the log at the identity."""
    twist: Array = FIRST @ displaced / step
    return twist


def acceleration_from(displaced: Array, step: float) -> Array:
    """Return the derivative of the twist, shape (6,), from displacements.

    ``alpha = d/dt (J(r) rdot) = rddot`` where r = 0: the derivative of the left Jacobian J there gives rdot x
    rdot / 2 = 0.
    """
    acceleration: Array = SECOND @ displaced / step**2
    return acceleration


def rate_of(function: Callable[[float], Array], time: float, step: float) -> Array:
    """Return the derivative of a function of time, of its own shape."""
    around = np.stack([function(time + offset * step) for offset in OFFSETS])
    rate: Array = np.tensordot(FIRST, around, axes=1) / step
    return rate


STEP = 1e-6
"""Of the differences, s: short, because the jerk may jump where two segments meet and first differences suffice."""
SMALLEST_SCALE = 0.1
"""Motions slower than this are compared as if they were this fast, SI: below it differences see their own round-off."""


class ConsistencyGaps(NamedTuple):
    """The largest disagreements found."""

    twist: float
    """Between V_WP_d and the differences of X_WP_d, largest entry, m/s or rad/s."""

    acceleration: float
    """Between A_WP_d and the differences of V_WP_d, largest entry, m/s^2 or rad/s^2."""


def check_consistency(reference: PoseReference, times: ArrayLike, allowed: float = 1e-3) -> ConsistencyGaps:
    """Compare a reference's twist and acceleration with central differences at given times.

    Linear and angular parts are compared apart, each with what is allowed of its largest norm over the times.

    Args:
        reference: any reference, the user's own included.
        times: where to look, s, shape (n,).
        allowed: largest accepted gap as a fraction of the largest value.

    Returns:
        the largest closure_errors, where all are accepted.

    Raises:
        ShapeError, OutOfRangeError, NotAPoseError: a target is not what PoseTarget says.
        InconsistentReferenceError: a gap is too large; it names the part, the time and the gap.
    """
    instants = as_array("times", times, "n").tolist()
    for time in instants:
        _check_target(reference, time)
    twists = np.array([reference.at(time).V_WP_d for time in instants])
    accelerations = np.array([reference.at(time).A_WP_d for time in instants])
    pose_rates = np.array(
        [twist_from(displacements(lambda t: reference.at(t).X_WP_d, time, STEP), STEP) for time in instants]
    )
    twist_rates = np.array([rate_of(lambda t: reference.at(t).V_WP_d, time, STEP) for time in instants])
    return ConsistencyGaps(
        _largest_gap("V_WP_d", instants, twists, pose_rates, allowed),
        _largest_gap("A_WP_d", instants, accelerations, twist_rates, allowed),
    )


def _check_target(reference: PoseReference, time: float) -> None:
    """Refuse a target of wrong shape, not finite, or not a pose."""
    target = reference.at(time)
    as_pose(f"X_WP_d({time})", target.X_WP_d)
    as_array(f"V_WP_d({time})", target.V_WP_d, 6)
    as_array(f"A_WP_d({time})", target.A_WP_d, 6)


def _largest_gap(
    name: str, times: Sequence[float], given: Array, differences: Array, allowed: float
) -> float:
    """Return the largest entry of given - differences, both of shape (n, 6), once each half is accepted."""
    for part, half in (("linear", slice(0, 3)), ("angular", slice(3, 6))):
        closure_errors = np.linalg.norm(given[:, half] - differences[:, half], axis=1)
        scale = max(SMALLEST_SCALE, float(np.linalg.norm(differences[:, half], axis=1).max(initial=0.0)))
        if closure_errors.max(initial=0.0) > allowed * scale:
            worst = int(closure_errors.argmax())
            raise InconsistentReferenceError(
                f"{part} part of {name}", times[worst], float(closure_errors[worst]), allowed * scale
            )
    return float(np.abs(given - differences).max(initial=0.0))
