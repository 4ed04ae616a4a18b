"""Delays in ticks, or as times that become ticks once the control rate is known."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from typing import Annotated, Any

from pydantic import BaseModel, Field, PlainSerializer, WrapValidator

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.parts import fields_of, refilled

_SLACK = 1e-9
"""Part of a tick by which a time may be beyond it."""
_TIME = re.compile(r"(\d+\.?\d*|\.\d+)(?:[eE]([-+]?\d+))?\s*(s|ms|us)")
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


class StatedDelay(int):
    """Delay that was stated as a time, "2.5 ms": a number of ticks once the control rate is known, before 0.

    Attributes:
        text: the time as it was stated, with its unit: s, ms or us.
    """

    text: str

    @classmethod
    def of(cls, text: str, rate_hz: float = 0.0) -> StatedDelay:
        """Return the first tick of a control rate, Hz, at or after a time."""
        if (match := _TIME.fullmatch(text.strip())) is None:
            raise FieldError(
                f"is {text!r}; it must be a number of ticks, or a time such as '2.5 ms' or '0.01 s'"
            )
        digits, power, unit = match.groups()
        time = float(f"{digits}e{power or 0}") * _UNITS[unit]
        delay = cls(math.ceil(time * rate_hz - _SLACK))
        delay.text = text
        return delay


def _stated(value: Any, validated: Callable[[Any], int]) -> int:
    """Return a delay of a number of ticks, or of a time."""
    if isinstance(value, StatedDelay):
        return value
    return StatedDelay.of(value) if isinstance(value, str) else validated(value)


Delay = Annotated[
    int,
    Field(ge=0),
    WrapValidator(_stated),
    PlainSerializer(lambda delay: getattr(delay, "text", delay), return_type=int | str),
]
"""Delay in ticks, or as a time with its unit, "2.5 ms", which is rounded up to ticks."""


def in_ticks(node: Any, rate_hz: float) -> Any:
    """Return a value in which delays that are stated as times have their ticks of a control rate, Hz."""
    kind = type(node)  # which may be read of stand-ins for numbers, too
    if kind is StatedDelay:
        ticks = StatedDelay.of(node.text, rate_hz)
        return node if ticks == node else ticks
    if kind is tuple:
        parts = tuple([in_ticks(part, rate_hz) for part in node])
        return node if all(map(operator.is_, parts, node)) else parts
    fields = fields_of(node) if issubclass(kind, BaseModel) else node
    if type(fields) is not dict:
        return node
    changed = {name: in_ticks(part, rate_hz) for name, part in fields.items()}
    if all(changed[name] is part for name, part in fields.items()):
        return node
    return refilled(node, changed) if kind is not dict else changed
