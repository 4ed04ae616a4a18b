"""Colours by meaning, the same in figures and the 3-D scene; the colour-blind-safe set of Okabe and Ito."""

from __future__ import annotations

ACTUAL = "#0072b2"
DESIRED = "#4d4d4d"
MEASURED = "#e69f00"
INTERNAL = "#d55e00"
LOAD = "#009e73"
EXTERNAL = "#cc79a7"
EVENT = "#8c8c8c"
LIMIT = "#000000"
CAPTION = "#5a6472"
SATURATED = "#f0e442"
SINGULAR = "#56b4e9"
FREE = "#d9dde3"
SLIDES = "#b40f20"

SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of lines that only need to differ from each other."""

ARMS = ("#2d1e80", "#8a1c5c", "#8c8c1f", "#c9b0f0")
"""Colours of arms, which mean nothing else; they differ in grey, too."""

FLOOR = "#dfe3e8"
FLOOR_LINES = "#b9c0ca"


def series(number: int) -> str:
    """Return the colour of a line by its number among others; they repeat after six."""
    return SERIES[number % len(SERIES)]


def arm(number: int, shade: float = 0.0) -> str:
    """Return the colour of an arm by its number, mixed with a share of white; they repeat after four."""
    colour = ARMS[number % len(ARMS)]
    parts = (int(colour[at : at + 2], 16) for at in (1, 3, 5))
    return "#" + "".join(f"{round(part + shade * (255 - part)):02x}" for part in parts)
