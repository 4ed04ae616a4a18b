"""Names of the engines that simulate runs."""

from __future__ import annotations

from typing import Literal, TypeAlias

Engine: TypeAlias = Literal["auto", "pinocchio", "traced", "batch"]
"""What simulates a run: "pinocchio", one tree of arms and payload; "traced", a compiled plant; "batch",
compiled code of plant, law and sensors, many runs at once or one; "auto" chooses by the run's length and
number."""
PREVIOUS = {"single": "pinocchio"}
"""Names of earlier versions, which are read."""
