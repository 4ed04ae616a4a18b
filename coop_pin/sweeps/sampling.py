"""Sampling of several fields at once: Sobol' sequences, Latin hypercubes, random and Saltelli's points."""

from __future__ import annotations

import functools
from typing import Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator
from scipy.stats import qmc

from coop_pin.arrays import Array
from coop_pin.errors import FieldError
from coop_pin.schema.base import Description

_BLOCK = 1024


class Span(Description):
    """The range of one field.

    Attributes:
        low: lower end.
        high: upper end.
        scale: "linear", or "log" to sample evenly in the logarithm.
    """

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="after")
    def _with_valid_ends(self) -> Self:
        if not self.high > self.low:
            raise FieldError(f"is {self.high:g}; it must be above low = {self.low:g}", "high")
        if self.scale == "log" and self.low <= 0.0:
            wanted = "a logarithmic scale needs positive ends"
            raise FieldError(f"is 'log', but low is {self.low:g}; {wanted}", "scale")
        return self

    def at(self, fraction: float) -> float:
        """Return the value at a fraction of the range."""
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** fraction)
        return float(self.low + fraction * (self.high - self.low))


class Sample(Description):
    """Sample of points over the ranges of several fields; one dimension of a sweep plan.

    Sobol' points are computed in blocks of 1024 and a Latin hypercube as a whole (8 bytes for each point and
    field) on first use; neither is stored in the plan.

    Attributes:
        fields: the range of each field.
        count: number of points; a power of two for "sobol" and "saltelli".
        method: "sobol" (scrambled), "latin-hypercube", "random", or "saltelli": count (2 + number of fields)
            points, from which Sobol' indices are computed.
        seed: of the sampling.
    """

    fields: dict[str, Span] = Field(min_length=1)
    count: int = Field(ge=1)
    method: Literal["sobol", "latin-hypercube", "random", "saltelli"] = "sobol"
    seed: int = Field(default=0, ge=0)

    @field_validator("method")
    @classmethod
    def _balanced(cls, method: str, earlier: ValidationInfo) -> str:
        count = earlier.data.get("count", 1)
        if method in ("sobol", "saltelli") and count & (count - 1):
            wanted = f"must be a power of two; {count} is not (next: {1 << count.bit_length()})"
            raise FieldError(f"is {method!r}, whose count {wanted}")
        return method

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return "sample"

    @property
    def size(self) -> int:
        """Number of points."""
        return self.count * (2 + len(self.fields)) if self.method == "saltelli" else self.count

    def changes(self, place: int) -> dict[str, float]:
        """Return the value of each field at one point."""
        return {
            name: span.at(float(u))
            for (name, span), u in zip(self.fields.items(), self.fractions(place), strict=True)
        }

    def labels(self, place: int) -> dict[str, float]:
        """Return the coordinates of one point: its number and the value of each field."""
        return {"sample": place, **self.changes(place)}

    def summary(self) -> str:
        """Return the method and the ranges on one line."""
        ranges = (f"{name} in [{span.low:g}, {span.high:g}]" for name, span in self.fields.items())
        return f"{self.size} {self.method} points over {', '.join(ranges)}"

    def fractions(self, place: int) -> Array:
        """Return one point of the unit cube, shape (number of fields,)."""
        d = len(self.fields)
        if self.method in ("sobol", "saltelli"):
            row, width = place % self.count, 2 * d if self.method == "saltelli" else d
            u = _sobol_block(width, self.seed, row // _BLOCK)[row % _BLOCK]
            return _saltelli(u, place // self.count, d) if self.method == "saltelli" else u
        return _matrix(self.method, d, self.count, self.seed)[place]


def _saltelli(u: Array, block: int, d: int) -> Array:
    """Return a row of A (block 0), of B (block 1), or of A with column block - 2 from B."""
    a, b = u[:d], u[d:]
    if block < 2:
        return (a, b)[block]
    mixed = a.copy()
    mixed[block - 2] = b[block - 2]
    return mixed


@functools.lru_cache(maxsize=8)
def _sobol_block(d: int, seed: int, block: int) -> Array:
    """Return points 1024 b to 1024 (b + 1) of a scrambled Sobol' sequence, shape (1024, d)."""
    sequence = qmc.Sobol(d, scramble=True, rng=np.random.default_rng(seed))
    if block:
        sequence.fast_forward(block * _BLOCK)
    return np.asarray(sequence.random(_BLOCK))


@functools.lru_cache(maxsize=2)
def _matrix(method: str, d: int, count: int, seed: int) -> Array:
    random = np.random.default_rng(seed)
    return (
        np.asarray(qmc.LatinHypercube(d, rng=random).random(count))
        if method == "latin-hypercube"
        else random.random((count, d))
    )
