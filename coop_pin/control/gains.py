"""Gains of laws: validated numbers that become matrices or vectors of an arm's drives or of the task rows."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, number_or_row, number_row_or_rows
from coop_pin.base.schema.parts import fields_of, refilled
from coop_pin.base.spatial.generic_numbers import identity

MatrixGain = Annotated[Any, BeforeValidator(number_row_or_rows)]
"""A gain matrix: a number times the identity, a diagonal, or rows; of sized gains an array."""
RowGain = Annotated[Any, BeforeValidator(number_or_row)]
"""A diagonal gain: a number for all entries, or one for each; of sized gains an array."""

OptionalRow = Annotated[Any, BeforeValidator(lambda value: None if value is None else number_or_row(value))]
"""A diagonal gain, or None for the law's own; of sized gains an array, or None."""


def _diagonal(alpha: float | tuple[Any, ...]) -> float | tuple[Any, ...]:
    """Refuse an alpha that is not diagonal or has a negative entry."""
    if isinstance(alpha, float) and alpha >= 0.0:
        return alpha
    rows = np.array(alpha)
    if rows.ndim == 2 and not np.array_equal(rows, np.diag(np.diag(rows))):
        raise FieldError(
            f"is {rows.tolist()}; alpha must be diagonal, otherwise s^T alpha sgn(s) can be negative"
        )
    if np.min(rows) < 0.0:
        raise FieldError(f"is {rows.tolist()}; alpha must not be negative")
    return alpha


def _positive_definite(gain: float | tuple[Any, ...]) -> float | tuple[Any, ...]:
    """Refuse a gain that is not positive, or a matrix whose symmetric part is not positive definite."""
    if isinstance(gain, float) and gain > 0.0:
        return gain
    rows = np.array(gain, dtype=float)
    if rows.ndim == 2 and rows.shape[0] != rows.shape[1]:
        raise FieldError(f"has shape {rows.shape}; a gain matrix is square")
    smallest = float(np.linalg.eigvalsh((rows + rows.T) / 2)[0]) if rows.ndim == 2 else float(np.min(rows))
    if smallest <= 0.0:
        expected = (
            "positive",
            "positive in every entry",
            f"positive definite (smallest eigenvalue {smallest:g})",
        )
        raise FieldError(f"is {rows.tolist()}; it must be {expected[rows.ndim]}")
    return gain


PositiveGain = Annotated[MatrixGain, AfterValidator(_positive_definite)]
PositiveRow = Annotated[RowGain, AfterValidator(_positive_definite)]
SignGain = Annotated[MatrixGain, AfterValidator(_diagonal)]


def gain_matrix(gain: Any, size: int, path: str = "") -> Array:
    """Return a gain as a (size, size) matrix: a number times the identity, a diagonal, or the rows as given.

    Raises:
        FieldError: its number of entries does not fit.
    """
    if not isinstance(gain, tuple | list | np.ndarray):
        return gain * identity(size)
    rows = np.array(gain, dtype=float)
    if rows.ndim and len(rows) != size:
        raise FieldError(f"has {len(rows)} entries; it must be a number or have {size}", path)
    return rows * identity(size) if rows.ndim < 2 else rows


def gain_vector(gain: Any, size: int, path: str = "") -> Array:
    """Return the diagonal of a gain, shape (size,); raises as ``gain_matrix``."""
    return gain_matrix(gain, size, path).diagonal().copy()


class Gains(Description):
    """Gains of a law; those that act on task rows or drives can be numbers, or have an entry for each."""

    on_rows: ClassVar[tuple[str, ...]] = ()
    """Gains that act on the k_0 task rows."""
    on_drives: ClassVar[tuple[str, ...]] = ()
    """Gains that act on the k drives of an arm."""
    are_matrices: ClassVar[bool] = False

    def sized(self, rows: int, drives: int, path: str = "controller.gains") -> Self:
        """Return the gains with those of rows and drives as arrays.

        Args:
            rows: Number k_0 of task rows.
            drives: Number k of drives of the arm.
            path: Dotted path of these gains, for errors.

        Raises:
            FieldError: a gain has a wrong number of entries.
        """
        sizes = dict.fromkeys(self.on_rows, rows) | dict.fromkeys(self.on_drives, drives)
        array = gain_matrix if self.are_matrices else gain_vector
        gains = {name: gain for name, gain in fields_of(self).items() if name in sizes and gain is not None}
        arrays = {name: array(gain, sizes[name], f"{path}.{name}") for name, gain in gains.items()}
        return refilled(self, arrays)
