"""Bisection: the edge between numbers for which a condition holds and others for which it does not."""

from __future__ import annotations

import math
from collections.abc import Callable


def edge(holds: Callable[[float], bool], inside: float, outside: float, accuracy: float) -> float:
    """Return a number for which a condition holds, within an accuracy of an edge.

    Args:
        holds: Condition.
        inside: Number for which it holds.
        outside: Number for which it does not.
        accuracy: Largest distance from the edge.
    """
    while abs(outside - inside) > accuracy:
        middle = (inside + outside) / 2.0
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside


def factor_edge(holds: Callable[[float], bool], inside: float, outside: float, accuracy: float) -> float:
    """Return a factor for which a condition holds, within a part of an edge; arguments as of ``edge``."""
    by_log = edge(lambda log: holds(math.exp(log)), math.log(inside), math.log(outside), math.log1p(accuracy))
    return math.exp(by_log)
