"""How much a search tries, and what every way of searching is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.sweeps.sampling import Sample, Span

Ranges = Mapping[str, tuple[float, float]]
"""The lowest and the highest value of each field."""
Costs = Callable[[Array], Array]
"""Runs a generation of points, shape (s, fields), and returns their costs, shape (s,)."""
_SMALLEST = 5


class Effort(NamedTuple):
    """How much is tried.

    Attributes:
        generations: after the first one.
        size: runs in a generation.
        seed: of the search.
    """

    generations: int
    size: int
    seed: int

    @classmethod
    def of(cls, generations: int, population: int, fields: int, seed: int) -> Effort:
        """Return the effort for so many runs in a generation for each field; at least five in all, which differential evolution needs."""
        return cls(generations, max(_SMALLEST, population * fields), seed)

    @property
    def runs(self) -> int:
        """Number of runs of the search."""
        return (self.generations + 1) * self.size


Search = Callable[[Costs, Ranges, Effort], None]
"""A way of searching: the points that it tries depend on its arguments and on the costs alone, never on who computes them or when."""


def first_generation(ranges: Ranges, effort: Effort) -> Array:
    """Return the points that every search begins with, a Latin hypercube: shape (s, fields)."""
    spans = {field: Span(low=low, high=high) for field, (low, high) in ranges.items()}
    sample = Sample(fields=spans, count=effort.size, method="latin-hypercube", seed=effort.seed)
    return np.array([list(sample.point(index).values()) for index in range(effort.size)])
