"""Messages between arms, and their named parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.arrays import Array


class Message(NamedTuple):
    """Latest message that an arm has received from a neighbour.

    Attributes:
        numbers: numbers of the message, rounded as they were sent, shape (w,); zero before the first.
        age: ticks since it was sent; inf before the first.
    """

    numbers: Array
    age: float


Messages: TypeAlias = Mapping[str, Message]
"""Messages by sender."""
Parts: TypeAlias = Mapping[str, Array]
"""Numbers of a message by name, in the order in which they are sent."""


def packed(parts: Parts, rest: Array) -> Array:
    """Return a message of named parts and the numbers that follow them, shape (w,)."""
    return np.concatenate([*parts.values(), rest])


def unpacked(messages: Messages, parts: Parts) -> tuple[dict[str, Messages], Messages]:
    """Return the messages of each part by its name, and those of the numbers that follow the parts.

    Args:
        messages: Messages of equal parts.
        parts: Parts of the same sizes.
    """
    by_part, rest = dict[str, Messages](), messages
    for name, part in parts.items():
        size = len(part)
        by_part[name] = {sender: Message(one.numbers[:size], one.age) for sender, one in rest.items()}
        rest = {sender: Message(one.numbers[size:], one.age) for sender, one in rest.items()}
    return by_part, rest
