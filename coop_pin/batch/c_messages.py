"""C99 of what an exported law tells other arms and hears of them: parts of header and self-test."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.batch.law_code import AGREEMENT, RecordedLaw, heard_fields
from coop_pin.tracing.c_emitter import c_number

_EXCHANGE = """   At every tick the arm tells the others {size} numbers before any arm steps: {name}_message.
   Before start, which hears messages, too, it tells {name}_first_message. It hears {heard}:
   the latest message of each as it arrived, and its age; zeros of age INFINITY before the first.
"""

_DECLARED = """/* Set the {size} numbers that this arm tells the others, before start and at a tick. */
int {name}_first_message(
    const {name}_measurement *measurement, const {name}_reference *reference, double *message);
int {name}_message(
    const {name}_measurement *measurement, const {name}_reference *reference, const {name}_state *state,
    double *message);

"""

_SAID = """
static const double said[][{size}] = {{
{said}
}};

/* Return whether a message is the expected one. */
static int is_said(const double *message, const double *expected)
{{
    int good = 1;
    for (int index = 0; index < {size}; ++index)
        good &= message[index] == expected[index] || fabs(message[index] - expected[index]) <= {tolerance};
    return good;
}}
"""

_BEFORE = """
    double message[{size}];
    good &= {name}_first_message(&measured[0], &desired[0], message) & is_said(message, said[0]);"""

_AT_TICK = """
        good &= {name}_message(&measured[tick], &desired[tick], &state, message);
        good &= is_said(message, said[tick + 1]);"""


class MessageTexts(NamedTuple):
    """Parts of header and self-test; empty for a law that says nothing.

    Attributes:
        exchange: sentences of the header.
        declared: declarations of the header.
        said: expected messages of the self-test.
        before: statements of the self-test before the first tick.
        at_tick: statements at a tick.
        comments: meanings of the fields with messages.
    """

    exchange: str
    declared: str
    said: str
    before: str
    at_tick: str
    comments: dict[str, str]

    @classmethod
    def of_law(cls, name: str, law: RecordedLaw) -> MessageTexts:
        """Return the parts of a recorded law with the name of its files."""
        senders, ticks = heard_fields(law.ticks[0].measurement), law.ticks
        comments = {field: f"latest message of arm {sender!r}" for field, sender in senders.items()}
        comments |= {
            f"{field}_age": f"ticks since arm {sender!r} said it" for field, sender in senders.items()
        }
        messages = [law.first_message, *(tick.message for tick in ticks)]
        if not len(law.first_message):
            return cls("", "", "", "", "", comments)
        rows = [", ".join(c_number(float(number)) for number in message) for message in messages]
        numbers = {
            "name": name,
            "size": len(law.first_message),
            "heard": ", ".join(map(repr, senders.values())),
            "said": ",\n".join(f"    {{{row}}}" for row in rows),
            "tolerance": c_number(AGREEMENT * float(np.abs(messages).max())),
        }
        exchange, declared, said, before, at_tick = (
            text.format(**numbers) for text in (_EXCHANGE, _DECLARED, _SAID, _BEFORE, _AT_TICK)
        )
        return cls(exchange, declared, said, before, at_tick, comments)
