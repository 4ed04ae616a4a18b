"""C99 of what an exported law tells other arms and hears of them: parts of header and self-test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.compiled.laws.law_code import AGREEMENT, LawTick, heard_fields
from coop_pin.control import ArmMeasurement
from coop_pin.tracing.c_emitter import c_number

_TEXTS = {
    "exchange": """\
   At every tick the arm tells the others {size} numbers before any arm steps: {name}_message.
   Before start, which hears messages, too, it tells {name}_first_message. It hears {heard}:
   the latest message of each as it arrived, and its age; zeros of age INFINITY before the first.
""",
    "messages": """\
/* Set the {size} numbers that this arm tells the others, before start and at a tick. */
int {name}_first_message(
    const {name}_measurement *measurement, const {name}_reference *reference, double *message);
int {name}_message(
    const {name}_measurement *measurement, const {name}_reference *reference, const {name}_state *state,
    double *message);

""",
    "sent": """
static const double sent[][{size}] = {{
{sent}
}};

/* Return whether a message is the expected one. */
static int agrees(const double *message, const double *expected)
{{
    int good = 1;
    for (int index = 0; index < {size}; ++index)
        good &= message[index] == expected[index] || fabs(message[index] - expected[index]) <= {tolerance};
    return good;
}}
""",
    "before": """
    double message[{size}];
    good &= {name}_first_message(&measured[0], &desired[0], message) & agrees(message, sent[0]);""",
    "at_tick": """
        good &= {name}_message(&measured[tick], &desired[tick], &state, message);
        good &= agrees(message, sent[tick + 1]);""",
}
"""Parts of header and self-test by name."""


def meanings(measurement: ArmMeasurement) -> dict[str, str]:
    """Return the meaning of each field with a message, or its age, that an arm hears."""
    senders = heard_fields(measurement).items()
    latest = {field: f"latest message of arm {sender!r}" for field, sender in senders}
    return latest | {f"{field}_age": f"ticks since arm {sender!r} sent it" for field, sender in senders}


def message_texts(name: str, ticks: Sequence[LawTick], first: Array) -> dict[str, str]:
    """Return the parts of header and self-test, by name; empty for a law without messages.

    Args:
        name: Name of the files.
        ticks: Ticks of the law.
        first: Message before the first of them.
    """
    if not len(first):
        return dict.fromkeys(_TEXTS, "")
    messages = [first, *(tick.message for tick in ticks)]
    rows = [", ".join(c_number(float(number)) for number in message) for message in messages]
    numbers = {
        "name": name,
        "size": len(first),
        "heard": ", ".join(map(repr, heard_fields(ticks[0].measurement).values())),
        "sent": ",\n".join(f"    {{{row}}}" for row in rows),
        "tolerance": c_number(AGREEMENT * float(np.abs(messages).max())),
    }
    return {part: text.format(**numbers) for part, text in _TEXTS.items()}
