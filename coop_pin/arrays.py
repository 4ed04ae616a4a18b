"""Shape and finiteness checks at the door, by argument name."""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coop_pin.errors import OutOfRangeError, ShapeError

Array: TypeAlias = NDArray[np.float64]
"""A float64 array."""

Entry = TypeVar("Entry", bound=np.generic)

Mask: TypeAlias = NDArray[np.bool_]
"""An array of truth values."""


def as_array(name: str, value: ArrayLike, *shape: int | str) -> Array:
    """Return value as a new float64 array of a stated shape with finite entries.

    Args:
        name: the argument's name, for the message.
        value: anything numpy can read.
        shape: the expected sizes; a string stands for any size and documents it.

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


def frozen(array: NDArray[Entry]) -> NDArray[Entry]:
    """Return the array itself, made read-only."""
    array.flags.writeable = False
    return array
