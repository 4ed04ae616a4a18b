"""Root locus: eigenvalues of the sampled closed loop over a gain or another number of a scenario."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, as_positive, typed
from coop_pin.base.errors import ArgumentError, FieldError
from coop_pin.description.scenario import Scenario
from coop_pin.stability.closed_loop import ClosedLoop, eigenvalues
from coop_pin.stability.modes import NEUTRAL

_ACCURACY = 1e-4
"""Of a factor at which an eigenvalue crosses the unit circle."""


class RootLocus(NamedTuple):
    """Eigenvalues of the sampled closed loop over factors of a field.

    Attributes:
        field: dotted path of the field.
        value: the field in the scenario, shape () or that of a row of gains.
        factors: factors by which it is multiplied, rising, shape (n,).
        loops: closed loop at each of them.
        bounds: factors between them at which the loop becomes stable or unstable, rising.
    """

    field: str
    value: Array
    factors: Array
    loops: tuple[ClosedLoop, ...]
    bounds: tuple[float, ...]

    def summary(self) -> str:
        """Return the stable ranges as text, in one line."""
        ends = [*self.bounds]
        if self.loops[0].ok:
            ends.insert(0, float(self.factors[0]))
        if self.loops[-1].ok:
            ends.append(float(self.factors[-1]))
        ranges = [f"{low:.4g} to {high:.4g}" for low, high in zip(ends[::2], ends[1::2], strict=True)]
        stable = f"stable at {' and '.join(ranges)} times" if ranges else "unstable at all factors of"
        growing = dict.fromkeys(loop.slowest.name for loop in self.loops if not loop.ok)
        text = f"{self.field}: {stable} its value {np.array2string(self.value, separator=', ')}"
        return f"{text}; elsewhere {' and '.join([*growing][:2])} grows" if growing else text


@typed
def root_locus(scenario: Scenario, field: str, factors: Iterable[float], *, time: float = 0.0) -> RootLocus:
    """Return the eigenvalues of the sampled closed loop over factors of a gain, and where it is stable.

    Bounds are searched between factors of which one is stable, by Brent's method.

    Args:
        scenario: Scenario, as of ``eigenvalues``.
        field: Dotted path of a number or a row of numbers, for example "controller.gains.sliding_gain" or
            "actuators.lag".
        factors: Factors of its value, positive.
        time: Time of the state, s.

    Raises:
        FieldError: the field is no number or row of numbers other than 0, or does not allow a value.
        ArgumentError: there are no factors; or as ``eigenvalues``.
        CoopPinError: as ``eigenvalues``.
    """
    ordered = np.unique([as_positive("factors", factor) for factor in factors])
    if not ordered.size:
        raise ArgumentError("factors is empty; give at least one")
    value, free = _value(scenario, field), scenario.replace(beyond_bound=True)

    def loop(factor: float) -> ClosedLoop:
        return eigenvalues(free.override({field: (factor * value).tolist()}), time=time)

    from scipy.optimize import brentq  # slow to load

    loops = {factor: loop(factor) for factor in ordered.tolist()}

    def growth(factor: float) -> float:
        return (loops.get(factor) or loop(factor)).radius - 1.0 - NEUTRAL

    bounds = tuple(
        float(brentq(growth, low, high, xtol=_ACCURACY * low))
        for low, high in pairwise(loops)
        if loops[low].ok != loops[high].ok
    )
    return RootLocus(field, value, ordered, tuple(loops.values()), bounds)


def _value(scenario: Scenario, field: str) -> Array:
    """Return the number or numbers of a field."""
    node: Any = scenario.model_dump()
    for key in field.split("."):
        node = node.get(key) if isinstance(node, dict) else None
    try:
        value = np.array(node, dtype=np.float64)
    except (TypeError, ValueError):
        value = np.array(np.nan)
    if not np.isfinite(value).all() or not value.any() or value.ndim > 1:
        raise FieldError(
            f"is {node!r}; a root locus needs a number or a row of numbers other than 0 to multiply", field
        )
    return value
