"""Which values of a scenario a panel has sliders for, and their ranges."""

from __future__ import annotations

from typing import Any, NamedTuple

from coop_pin.description.controller import UserController
from coop_pin.description.force_path import NoForcePath
from coop_pin.description.scenario import Scenario

_DECADE = 10.0


class Knob(NamedTuple):
    """A slider for a gain.

    Attributes:
        field: dotted path in the scenario.
        label: for people.
        value: as the scenario has it: a number, or a factor on a gain of several numbers.
        low: the least.
        high: the most.
        gain: the gain that the factor multiplies; None where the slider is the gain itself.
    """

    field: str
    label: str
    value: float
    low: float
    high: float
    gain: Any = None

    def field_value(self, value: float) -> Any:
        """Return what the scenario's field becomes."""
        return value if self.gain is None else _scaled(self.gain, value)


def gain_knobs(scenario: Scenario) -> tuple[Knob, ...]:
    """Return the knobs of a scenario's gains; none for a user's own controller, whose gains nobody here knows."""
    chosen = scenario.controller
    if isinstance(chosen, UserController):
        return ()
    knobs: list[Knob] = []
    for name, gain in chosen.gains:
        if name == "force_gain" and isinstance(chosen.force_path, NoForcePath):
            continue  # the law would not feel it
        field, label = f"controller.gains.{name}", name.replace("_", " ")
        if isinstance(gain, tuple):
            knobs.append(Knob(field, f"{label} \u00d7", 1.0, 1.0 / _DECADE, _DECADE, gain))
        elif name in ("sign_gain", "force_gain"):
            knobs.append(Knob(field, label, gain, 0.0, max(5.0 * gain, 1.0)))
        else:
            knobs.append(Knob(field, label, gain, gain / _DECADE, gain * _DECADE))
    return tuple(knobs)


def _scaled(gain: Any, factor: float) -> Any:
    return tuple(_scaled(entry, factor) for entry in gain) if isinstance(gain, tuple) else factor * gain
