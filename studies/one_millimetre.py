"""Tracking and internal force over time under a kinematic bias of 1 mm: the printed and the anchored law."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.figures import palette
from coop_pin.figures.style import label, styled

COLOURS = (palette.EXTERNAL, palette.INTERNAL, palette.MEASURED, palette.ACTUAL)


def curves(result: cp.SweepResult) -> Iterator[tuple[str, Array, Array, Array]]:
    """Yield law, time, position error, mm, and internal-force error of the first arm, N, of each run."""
    for number in range(len(result.plan)):
        data = result.open(number).data
        parts = (data[f"internal_{part}_error"].values[:, 0] for part in ("axial", "shear"))
        position = 1e3 * np.linalg.norm(data["pose_error"].values[:, :3], axis=1)
        yield str(result.plan[number].parameters["law"]), data["time"].values, position, np.hypot(*parts)


def figure(results: Mapping[str, cp.SweepResult]) -> Figure:
    """Return two panels: both errors over time, a line for each law."""
    with styled():
        drawn = Figure(figsize=(7.6, 2.9), layout="constrained")
        tracking, internal = drawn.subplots(1, 2)
        for (law, time, position, force), colour in zip(
            curves(results["one_millimetre"]), COLOURS, strict=True
        ):
            tracking.semilogy(time, position, color=colour, label=law)
            internal.semilogy(time, force, color=colour)
            value = f" {force[-1]:.0f} N" if force[-1] > 10.0 else f" {force[-1]:.2f} N"
            end: Any = {"color": colour, "fontsize": 8.0, "va": "center", "annotation_clip": False}
            internal.annotate(value, (time[-1], force[-1]), **end)
        half: Any = {"color": palette.DESIRED, "linestyle": "--", "linewidth": 0.9, "zorder": 1.5}
        tracking.axhline(0.5, label="half of the bias", **half)
        for panel in (tracking, internal):
            panel.set_xlim(0.0, time[-1])
            panel.set_xlabel("time (s)")
        internal.set_ylim(bottom=0.05)
        label(tracking, "position error", "mm")
        label(internal, "internal-force error", "N")
        tracking.legend(loc="upper right")
    return drawn


def numbers(results: Mapping[str, cp.SweepResult]) -> str:
    """Return both errors of each law at 4 s and at the end."""
    lines = []
    for law, time, position, force in curves(results["one_millimetre"]):
        for place in (int(np.searchsorted(time, 4.0)), len(time) - 1):
            at = f"{time[place]:5.1f} s: position error {position[place]:8.3f} mm"
            lines.append(f"{law:18} {at}, internal-force error {force[place]:9.3f} N")
    return "\n".join(lines)
