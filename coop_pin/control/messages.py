"""Messages between arms."""

from __future__ import annotations

from typing import NamedTuple

from coop_pin.base.arrays import Array


class Message(NamedTuple):
    """Latest message that an arm has received from a neighbour.

    Attributes:
        numbers: numbers of the message, rounded as they were sent, shape (w,); zero before the first.
        age: ticks since it was sent; inf before the first.
    """

    numbers: Array
    age: float
