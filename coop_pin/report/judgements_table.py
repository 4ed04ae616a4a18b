"""The judgements of a run in words, with units that a person reads."""

from __future__ import annotations

import math
from typing import NamedTuple

from coop_pin.results import RunResult


class Wording(NamedTuple):
    """How a metric is told.

    Attributes:
        text: what it is.
        unit: as shown.
        scale: from the SI value to the unit as shown.
        tight: whether it says how exact the computation was, not how good the control.
    """

    text: str
    unit: str
    scale: float = 1.0
    tight: bool = False


class Judgement(NamedTuple):
    """One line of the table.

    Attributes:
        name: of the metric.
        text: what it is.
        value: with its unit, or why there is none.
        tight: as for ``Wording``.
    """

    name: str
    text: str
    value: str
    tight: bool


_WORDINGS = {
    "settling_time_s": Wording("settles to 5 mm and 5 mrad after the start", "s"),
    "resettling_time_s": Wording("settles again after the first event", "s"),
    "event_peak_position_error_m": Wording("largest position error from the first event on", "mm", 1e3),
    "position_rms_m": Wording("position error, rms", "mm", 1e3),
    "orientation_rms_rad": Wording("orientation error, rms", "mrad", 1e3),
    "internal_axial_mean_N": Wording("internal force along the line between the tips, mean", "N"),
    "internal_axial_rms_error_N": Wording("internal force along the line, rms of its error", "N"),
    "internal_shear_rms_N": Wording("internal force across the line, rms of its error", "N"),
    "internal_moment_rms_error_Nm": Wording("internal moment about P, rms of its error", "N m"),
    "torque_peak_Nm": Wording("largest drive torque", "N m"),
    "closure_error_max_m": Wording("closure error, largest distance", "m", tight=True),
    "closure_error_max_rad": Wording("closure error, largest angle", "rad", tight=True),
    "energy_balance_max_J": Wording("energy minus work, largest", "J", tight=True),
}
_WINDOW = "window_s"


def judgements(result: RunResult) -> list[Judgement]:
    """Return every judgement of a run: control first, then the exactness of the computation.

    A metric without words of its own is shown by its name.
    """
    found = []
    for name, value in result.metrics().items():
        if name == _WINDOW:
            continue
        wording = _WORDINGS.get(name, Wording(name.replace("_", " "), ""))
        numbers = value if isinstance(value, list) else [value]
        text = ", ".join(_number(number, wording) for number in numbers)
        found.append(Judgement(name, wording.text, text, wording.tight))
    return sorted(found, key=lambda judgement: judgement.tight)


def _number(value: float, wording: Wording) -> str:
    if math.isnan(value):
        return "does not apply"
    if math.isinf(value):
        return "never"
    return f"{value * wording.scale:.3g} {wording.unit}".strip()
