"""Validation of array arguments: shape, finiteness, sign and pose, with the argument's name in the error."""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coop_pin.errors import NotAPoseError, OutOfRangeError, ShapeError

Array: TypeAlias = NDArray[np.float64]
"""A float64 array."""

Entry = TypeVar("Entry", bound=np.generic)

Mask: TypeAlias = NDArray[np.bool_]
"""A boolean array."""

POSE_ALLOWED = 1e-6
"""Largest accepted entry of R^T R - I: poses typed to seven digits pass."""


def as_array(name: str, value: ArrayLike, *shape: int | str) -> Array:
    """Return value as a new float64 array of a stated shape with finite entries.

    Args:
        name: the argument's name, for the error message.
        value: anything numpy can convert.
        shape: the expected sizes; a string accepts any size and documents it.

    Raises:
        ShapeError: the shape differs.
        OutOfRangeError: an entry is NaN or infinite.
    """
    try:
        array: NDArray[Any] = np.array(value, dtype=np.float64)
    except (ValueError, TypeError):
        raise ShapeError(name, np.shape(np.array(value, dtype=object)), shape) from None
    sizes_match = all(
        isinstance(want, str) or have == want for have, want in zip(array.shape, shape, strict=False)
    )
    if array.ndim != len(shape) or not sizes_match:
        raise ShapeError(name, array.shape, shape)
    finite = np.isfinite(array)
    if not finite.all():
        index = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise OutOfRangeError(name, float(array[index]), "a finite number", index)
    return array


def as_positive(name: str, value: ArrayLike) -> float:
    """Return value as a finite float greater than zero.

    Raises:
        ShapeError: it is not a single number.
        OutOfRangeError: it is NaN or infinite; it is zero or less.
    """
    number = float(as_array(name, value))
    if number <= 0.0:
        raise OutOfRangeError(name, number)
    return number


def as_pose(name: str, value: ArrayLike) -> Array:
    """Return value as a new pose, a 4x4 homogeneous matrix.

    Raises:
        ShapeError: the shape differs.
        OutOfRangeError: an entry is NaN or infinite.
        NotAPoseError: the 3x3 block is not a rotation matrix or the last row is not 0 0 0 1.
    """
    X = as_array(name, value, 4, 4)
    R, last_row = X[:3, :3], np.array((0.0, 0.0, 0.0, 1.0))
    deviation = float(max(np.abs(R.T @ R - np.eye(3)).max(), np.abs(X[3] - last_row).max()))
    if deviation > POSE_ALLOWED:
        raise NotAPoseError(name, deviation, POSE_ALLOWED)
    if np.linalg.det(R) < 0.0:
        raise NotAPoseError(f"{name} (a mirror image)", 2.0, POSE_ALLOWED)
    return X


def frozen(array: NDArray[Entry]) -> NDArray[Entry]:
    """Return the array itself, made read-only."""
    array.flags.writeable = False
    return array
