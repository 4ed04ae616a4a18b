"""Checks at the door of the references, and how a checked value is kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array, frozen
from coop_pin.errors import NotAPoseError, NotIncreasingError, NotPositiveError

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
        NotFiniteError: it is NaN or infinite.
    """
    return float(as_array(name, value))


def as_positive(name: str, value: ArrayLike) -> float:
    """Return value as a finite float greater than zero.

    Raises:
        ShapeError: it is not a single number.
        NotFiniteError: it is NaN or infinite.
        NotPositiveError: it is zero or less.
    """
    number = as_number(name, value)
    if number <= 0.0:
        raise NotPositiveError(name, number)
    return number


def as_pose(name: str, value: ArrayLike) -> Array:
    """Return value as a pose, shape (4, 4).

    Raises:
        ShapeError: the shape differs.
        NotFiniteError: an entry is NaN or infinite.
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
        NotFiniteError: an entry is NaN or infinite.
        NotPositiveError: its length is zero.
    """
    vector = as_array(name, value, 3)
    unit: Array = vector / as_positive(f"length of {name}", float(np.linalg.norm(vector)))
    return unit


def as_times(name: str, value: ArrayLike) -> Array:
    """Return value as strictly increasing times, s, shape (n,).

    Raises:
        ShapeError: it is not a list of numbers.
        NotFiniteError: an entry is NaN or infinite.
        NotIncreasingError: an entry is not greater than the one before it.
    """
    times = as_array(name, value, "n")
    backward = np.flatnonzero(np.diff(times) <= 0.0)
    if backward.size:
        index = int(backward[0]) + 1
        raise NotIncreasingError(name, index, float(times[index]), float(times[index - 1]))
    return times
