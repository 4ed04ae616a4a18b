"""A quantity of a run: its samples, and how those that follow from others are computed."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.arrays import Array

Samples: TypeAlias = dict[str, Any]
"""Arrays by names of quantities, n samples along the first axis.

Besides, for sources: ``load_share``, the c_i, shape (m,); and in lists, of each arm: ``angles`` and ``rates``
of its joints, shape (n, k), ``drive``, T, shape (k, k), and its payload ``jacobian``, shape (n, k_0, k). Of a
batch, ``pose_entries`` has the first three rows of X_WP, an array for each entry. Axes before that of the
samples, such as the runs of a batch, are allowed.
"""
Arrays: TypeAlias = Mapping[Any, Any]
"""Arrays of a run by name: numpy's, or labelled ones."""
_FIXED_SIZES = {
    "axis": 6,
    "position": 3,
    "quaternion": 4,
    "row": 4,
    "column": 4,
    "load_row": 6,
    "load_column": 6,
}


class Quantity(NamedTuple):
    """A quantity of a run.

    Attributes:
        name: name of the samples, and of the variable in the dataset.
        dims: dimensions after time, separated by blanks.
        unit: unit, or several where entries differ: of linear, then of angular ones.
        text: meaning; the variable's ``long_name``.
        source: computes it from the samples of quantities above it and of the joints, see Samples; None where
            it is recorded: by ``read``, the plant (Observation has a field of this name) or the recorder.
        read: reads it at a tick from the measurements and torques (``Applied``) of all arms, as a value for
            each arm, or a single one if it has no dimension "arm"; None if it is none of these.
        fill: value where nothing is recorded, for example beyond the joints of an arm.
        stored: whether it is a variable of the dataset; the others serve to compute such variables.
        group: one of ``GROUPS``, which says in which runs it is recorded; "" in all.
    """

    name: str
    dims: str
    unit: str
    text: str
    source: Callable[[Any], Array] | None = None
    read: Callable[[Any, Any], Sequence[Any]] | None = None
    fill: float | bool = np.nan
    stored: bool = True
    group: str = ""

    def shape(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """Return its shape at a tick, given the sizes of the dimensions that cells differ in."""
        return tuple({**_FIXED_SIZES, **sizes}[dim] for dim in self.dims.split())


def bytes_per_sample(table: Sequence[Quantity], sizes: Mapping[str, int]) -> int:
    """Return the memory that one sample takes in a finished run, bytes.

    Stored quantities count twice: their netCDF file is made in memory.

    Args:
        table: Quantities of the run.
        sizes: Sizes of the dimensions q, v, arm, joint and patch.
    """
    return sum(8 * (1 + quantity.stored) * math.prod(quantity.shape(sizes)) for quantity in table)


def allocate(table: Sequence[Quantity], count: int, sizes: Mapping[str, int]) -> Samples:
    """Return empty samples of every recorded quantity.

    Args:
        table: Quantities of the run.
        count: Number of samples.
        sizes: Sizes of the dimensions q, v, arm, joint and patch.
    """
    return {
        quantity.name: np.full((count, *quantity.shape(sizes)), quantity.fill)
        for quantity in table
        if quantity.source is None
    }


def computed(
    table: Sequence[Quantity], samples: Samples, load_shares: Array, names: Collection[str] | None = None
) -> Samples:
    """Return samples with the computed quantities added.

    Args:
        table: Quantities of the run.
        samples: Samples of every recorded quantity.
        load_shares: c_i where they are not recorded, shape (m,).
        names: Names of the quantities to add, without those that need another; None for all.
    """
    values = {"load_share": load_shares} | samples
    for quantity in table:
        if quantity.source is not None and (names is None or quantity.name in names):
            values[quantity.name] = quantity.source(values)
    return values
