"""The values that one field takes: a list, a range, or numbers evenly spaced on a linear or logarithmic scale."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from coop_pin.errors import FieldError

_SPACINGS = ("linspace", "logspace", "range")


def linspace(first: float, last: float, count: int) -> dict[str, list[float]]:
    """Say ``count`` numbers evenly spaced from first to last, both included."""
    return {"linspace": [first, last, count]}


def logspace(first: float, last: float, count: int) -> dict[str, list[float]]:
    """Say ``count`` numbers in equal ratios from first to last, both included (the numbers themselves, not their exponents)."""
    return {"logspace": [first, last, count]}


def _values(given: Any) -> tuple[Any, ...]:
    """Return the values as written, or those that ``{linspace = [first, last, count]}`` and its kind stand for."""
    if isinstance(given, Mapping):
        return _spaced(given)
    if isinstance(given, np.ndarray | range):
        given = given.tolist() if isinstance(given, np.ndarray) else list(given)
    if isinstance(given, str) or not isinstance(given, Sequence) or not given:
        raise FieldError(f"is {given!r}; it must be a list with at least one value, or one of {', '.join(_SPACINGS)} = [...]")
    return tuple(given)


def _spaced(given: Mapping[str, Any]) -> tuple[Any, ...]:
    kind, numbers = next(iter(given.items())) if len(given) == 1 else ("", ())
    if kind not in _SPACINGS:
        raise FieldError(f"is {dict(given)!r}; it must be one of {{{' = [...]}, {'.join(_SPACINGS)} = [...]}}")
    if not isinstance(numbers, Sequence) or len(numbers) != 3 or not all(isinstance(n, int | float) for n in numbers):
        wanted = "[start, stop, step]" if kind == "range" else "[first, last, count]"
        raise FieldError(f"is {numbers!r}; it must be three numbers {wanted}", kind)
    first, last, third = numbers
    if kind == "range":
        return _range(first, last, third)
    if not isinstance(third, int) or third < 1:
        raise FieldError(f"counts {third!r}; the count must be a whole number of at least 1", kind)
    if kind == "linspace":
        return tuple(np.linspace(first, last, third).tolist())
    if first <= 0.0 or last <= 0.0:
        raise FieldError(f"goes from {first:g} to {last:g}; a logarithmic scale needs positive ends", kind)
    return tuple(np.geomspace(first, last, third).tolist())


def _range(start: float, stop: float, step: float) -> tuple[Any, ...]:
    """Return start, start + step, ... up to stop, which is not included."""
    count = math.ceil((stop - start) / step - 1e-9) if step else 0
    if count < 1:
        raise FieldError(f"from {start:g} to {stop:g} in steps of {step:g} is empty; its step must lead from start to stop", "range")
    return tuple(start + i * step for i in range(count))


Values = Annotated[tuple[Any, ...], BeforeValidator(_values)]
"""What one field takes, one after the other."""


def label(value: Any) -> Any:
    """Return a value as it can stand on an axis: numbers, texts and truth values themselves, others as JSON text."""
    if isinstance(value, str | int | float | bool):
        return value
    return json.dumps(value, default=lambda entry: entry.model_dump(mode="json") if hasattr(entry, "model_dump") else str(entry))
