"""What only the whole cell knows about gains: checked when a scenario is read, never by the laws. Paths start at the controller."""

from __future__ import annotations

import numpy as np

from coop_pin.description.controller import Prescribed, UserController
from coop_pin.errors import FieldError, ForceGainBoundError, UnequalGainsError, suggestion

_INSIST = "or insist with beyond_bound = true"


def controller_problems(controller: Prescribed | UserController, arms: list[str]) -> list[FieldError]:
    """Return what is wrong with a controller for a cell with these arms."""
    if isinstance(controller, UserController):
        return []
    strangers = [name for name in controller.arm_gains if name not in arms]
    if strangers:
        detail = f"names {strangers}, which the cell does not have; {suggestion(strangers[0], arms)}"
        return [FieldError(detail, "arm_gains")]
    return [*_unequal(controller, arms), *_beyond_force_bound(controller, arms)]


def _unequal(controller: Prescribed, arms: list[str]) -> list[FieldError]:
    problems: list[FieldError] = []
    for field, symbol in (("pose_gain", "gamma"), ("force_gain", "K_f")):
        values = {name: getattr(controller.gains_of(name), field) for name in arms}
        first = next(iter(values.values()))
        if any(not _same(value, first) for value in values.values()):
            detail = f"differs between arms: {values}; Theorem 2 needs one {symbol} for all arms. Make them equal, {_INSIST}"
            problems.append(UnequalGainsError(detail, f"arm_gains.*.{field}"))
    return problems


def _same(left: object, right: object) -> bool:
    a, b = np.array(left, dtype=float), np.array(right, dtype=float)
    return a.shape == b.shape and bool(np.all(a == b))


def _beyond_force_bound(controller: Prescribed, arms: list[str]) -> list[FieldError]:
    largest = max(controller.gains_of(name).force_gain for name in arms)
    bound = controller.force_path.force_gain_bound
    path = "gains.force_gain"
    if controller.force_path.kind == "none":
        if largest == 0.0:
            return []
        return [
            ForceGainBoundError(
                f"is {largest:g}, but force_path.kind 'none' measures no force; set the gain to 0, or the kind to 'late' or 'low-pass'",
                path,
            )
        ]
    if largest < bound:
        return []
    detail = (
        f"is {largest:g}; force feedback sampled over {controller.force_path.kind!r} is unstable from {bound:g} on. Lower it, {_INSIST}"
    )
    return [ForceGainBoundError(detail, path)]
