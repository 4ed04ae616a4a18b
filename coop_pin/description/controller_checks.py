"""Checks of a controller against its cell: arms, equal gains, bounds of sampled force feedback."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from coop_pin.control.bounds import anchor_gain_bound, force_gain_bound
from coop_pin.description.controller import ForcePath, Law, NoForcePath, PayloadSpace, UserController
from coop_pin.errors import FieldError, suggestion

_INSIST = "or insist with beyond_bound = true"


class SampledWrist(NamedTuple):
    """Timing of a wrist sensor, in ticks.

    Attributes:
        delay: of a sample.
        every: from one sample to the next.
    """

    delay: int
    every: int


class SampledLoop(NamedTuple):
    """Timing of the feedback of measured wrenches.

    Attributes:
        pole: p of the force path's filter.
        delay: D of force path and wrists together, ticks.
        every: ticks from one sample to the next.
        lag: time constant of the slowest drives, ticks.
    """

    pole: float
    delay: int
    every: int
    lag: float


def sampled_loop(path: ForcePath, wrists: Collection[SampledWrist], lag: float) -> SampledLoop:
    """Return the timing of the slowest feedback over a force path, or over the wrists alone without one."""
    pole, delay = (0.0, 0) if isinstance(path, NoForcePath) else (path.pole, path.delay)
    slowest = max((wrist.delay for wrist in wrists), default=0)
    return SampledLoop(pole, delay + slowest, max((wrist.every for wrist in wrists), default=1), lag)


def controller_problems(
    controller: Law | UserController,
    arms: list[str],
    wrists: Collection[SampledWrist] = (),
    lag: float = 0.0,
) -> list[FieldError]:
    """Return what is wrong with a controller for a cell.

    Args:
        controller: the law with its gains.
        arms: of the cell.
        wrists: the wrist sensors that the arms have.
        lag: largest time constant of the arms' drives, ticks.
    """
    if isinstance(controller, UserController):
        return []
    strangers = [name for name in controller.arm_gains if name not in arms]
    if strangers:
        detail = f"names {strangers}, which the cell does not have; {suggestion(strangers[0], arms)}"
        return [FieldError(detail, "arm_gains")]
    problems = [*_unequal(controller, arms), *_beyond_force_bound(controller, arms, wrists, lag)]
    return problems or _beyond_anchor_bound(controller, arms, wrists, lag)


def _unequal(controller: Law, arms: list[str]) -> list[FieldError]:
    """Return the gains that differ between arms although the theory needs one value for all."""
    equal = {"pose_gain": "Theorem 2 needs one gamma", "force_gain": "Theorem 2 needs one K_f"}
    if isinstance(controller, PayloadSpace):
        equal["anchor_gain"] = "else the anchors move the payload: it needs one g"
    problems: list[FieldError] = []
    for field, reason in equal.items():
        values = {name: getattr(controller.gains_of(name), field) for name in arms}
        if not all(np.array_equal(value, values[arms[0]]) for value in values.values()):
            detail = f"differs between arms: {values}; {reason} for all arms"
            problems.append(FieldError(f"{detail}. Make them equal, {_INSIST}", f"arm_gains.*.{field}"))
    return problems


def _beyond_force_bound(
    controller: Law, arms: list[str], wrists: Collection[SampledWrist], lag: float
) -> list[FieldError]:
    """Return the problem of a force gain without measured force, or with unstable sampled feedback."""
    path, largest = controller.force_path, max(controller.gains_of(name).force_gain for name in arms)
    if isinstance(path, NoForcePath):
        allowed = largest == 0.0
        detail = (
            "but force_path.kind 'none' measures no force; "
            "set the gain to 0, or the kind to 'late' or 'low-pass'"
        )
    else:
        # A sample that arrives before the next is taken is in time: the loop closes once for each sample.
        delay = max(((path.delay + wrist.delay) // wrist.every for wrist in wrists), default=path.delay)
        every = max((wrist.every for wrist in wrists), default=1)
        bound = min(force_gain_bound(path.pole, delay, lag=own / every) for own in (0.0, lag))
        allowed = largest < bound
        loop = f"{path.kind!r}{_late(delay, lag)}"
        detail = f"but feedback over {loop} is unstable from {bound:g} on; lower it, {_INSIST}"
    return [] if allowed else [FieldError(f"is {largest:g}, {detail}", "gains.force_gain")]


def _beyond_anchor_bound(
    controller: Law, arms: list[str], wrists: Collection[SampledWrist], lag: float
) -> list[FieldError]:
    """Return the problem of an anchor gain with which the sampled internal loop is unstable."""
    if not isinstance(controller, PayloadSpace):
        return []
    gains, path = [controller.gains_of(name) for name in arms], controller.force_path
    largest, force_gain = max(gain.anchor_gain for gain in gains), max(gain.force_gain for gain in gains)
    loop = sampled_loop(path, wrists, lag)
    # Drives of different lags lie between those of none and of the largest.
    bound = min(
        anchor_gain_bound(**loop._replace(lag=own)._asdict(), force_gain=force_gain) for own in (0.0, lag)
    )
    if largest < bound:
        return []
    detail = (
        f"is {largest:g}, but the anchored integral over {path.kind!r}{_late(loop.delay, lag)} with K_f ="
        f" {force_gain:g} is unstable from {bound:.4g} on; lower it, {_INSIST}"
    )
    return [FieldError(detail, "gains.anchor_gain")]


def _late(delay: int, lag: float) -> str:
    late = f" with a delay of {delay}" if delay else ""
    return f"{late} and drives with a lag of {lag:.3g} ticks" if lag else late
