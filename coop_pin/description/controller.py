"""The choice of a controller: its name, gains, switching function and force path."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from coop_pin.control.terms import force_gain_bound
from coop_pin.description.gains import PayloadSpaceGains, PostureGains, SlidingModeGains
from coop_pin.description.switching import Sign, Switching
from coop_pin.errors import FieldError, suggestion
from coop_pin.schema.base import Description, NotNegative


class NoForcePath(Description):
    """No internal wrench is measured: K_f must be zero, and the law is truly decentralised."""

    kind: Literal["none"] = "none"

    @property
    def force_gain_bound(self) -> float:
        """The force gain must stay below this: there is nothing to feed back."""
        return 0.0


class LateForcePath(Description):
    """The internal wrench of one tick before: f_m[k] = f(t_k^-), f_m[0] = f_d."""

    kind: Literal["late"] = "late"

    @property
    def pole(self) -> float:
        """The filter's p: 0."""
        return 0.0

    @property
    def force_gain_bound(self) -> float:
        """The force gain must stay below (1 + p) / (1 - p) = 1."""
        return force_gain_bound(self.pole)


class LowPassForcePath(Description):
    """A discrete low-pass: f_m[k] = p f_m[k-1] + (1 - p) f(t_k^-), f_m[0] = f_d.

    Attributes:
        pole: p, in [0, 1).
    """

    kind: Literal["low-pass"] = "low-pass"
    pole: float = Field(default=0.9, ge=0.0, lt=1.0)

    @property
    def force_gain_bound(self) -> float:
        """The force gain must stay below (1 + p) / (1 - p)."""
        return force_gain_bound(self.pole)


ForcePath = Annotated[NoForcePath | LateForcePath | LowPassForcePath, Field(discriminator="kind")]


class SlidingMode(Description):
    """The decentralised sliding-mode law, Gueaieb et al. (2007), eq. (23), for arms with as many joints as task rows.

    Attributes:
        gains: for every arm.
        arm_gains: gains of single arms, in place of ``gains``.
        switching: the switching function in eq. (18).
        force_path: how the internal wrench reaches the law.
    """

    kind: Literal["sliding-mode"] = "sliding-mode"
    gains: SlidingModeGains
    arm_gains: dict[str, SlidingModeGains] = Field(default_factory=dict)
    switching: Switching = Sign()
    force_path: ForcePath = NoForcePath()

    def gains_of(self, arm: str) -> SlidingModeGains:
        """Return the gains of one arm."""
        return self.arm_gains.get(arm, self.gains)


class RedundantSlidingMode(Description):
    """Law (23) for arms with more joints than task rows: see RedundantSlidingModeController for what its proof loses.

    Attributes:
        gains: for every arm.
        arm_gains: gains of single arms, in place of ``gains``.
        posture: what the spare joints of redundant arms do.
        inverse_damping: of the pseudo-inverse; 0 is exact, anything else biases the tracking.
        switching: the switching function of the integral, eq. (18).
        force_path: how the internal wrench reaches the law.
    """

    kind: Literal["sliding-mode-redundant"] = "sliding-mode-redundant"
    gains: SlidingModeGains
    arm_gains: dict[str, SlidingModeGains] = Field(default_factory=dict)
    posture: PostureGains = PostureGains()
    inverse_damping: NotNegative = 0.0
    switching: Switching = Sign()
    force_path: ForcePath = NoForcePath()

    def gains_of(self, arm: str) -> SlidingModeGains:
        """Return the gains of one arm."""
        return self.arm_gains.get(arm, self.gains)


class PayloadSpace(Description):
    """The payload-space law: a repair of law (23), for any number of joints.

    Attributes:
        gains: for every arm.
        arm_gains: gains of single arms, in place of ``gains``.
        posture: what the spare joints of redundant arms do.
        switching: the switching function of the integral, eq. (18).
        force_path: how the internal wrench reaches the law.
    """

    kind: Literal["payload-space"] = "payload-space"
    gains: PayloadSpaceGains
    arm_gains: dict[str, PayloadSpaceGains] = Field(default_factory=dict)
    posture: PostureGains = PostureGains()
    switching: Switching = Sign()
    force_path: ForcePath = NoForcePath()

    def gains_of(self, arm: str) -> PayloadSpaceGains:
        """Return the gains of one arm."""
        return self.arm_gains.get(arm, self.gains)


class UserController(Description):
    """A controller of the user's own.

    Attributes:
        target: "module:Class"; it is called with the scenario, the arm's name and the options.
        options: handed to it.
        force_path: how the internal wrench reaches it.
    """

    kind: Literal["user"] = "user"
    target: str
    options: dict[str, Any] = Field(default_factory=dict)
    force_path: ForcePath = NoForcePath()

    @model_validator(mode="after")
    def _has_colon(self) -> Self:
        module, colon, name = self.target.partition(":")
        if not (module and colon and name):
            raise FieldError(f"is {self.target!r}; it must read 'module:Class'", "target")
        return self


Controller = Annotated[
    SlidingMode | RedundantSlidingMode | PayloadSpace | UserController, Field(discriminator="kind")
]

Prescribed = SlidingMode | RedundantSlidingMode | PayloadSpace
"""The laws that come with coop_pin."""


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
            problems.append(FieldError(detail, f"arm_gains.*.{field}"))
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
            FieldError(
                f"is {largest:g}, but force_path.kind 'none' measures no force; set the gain to 0, or the kind to 'late' or 'low-pass'",
                path,
            )
        ]
    if largest < bound:
        return []
    detail = f"is {largest:g}; force feedback sampled over {controller.force_path.kind!r} is unstable from {bound:g} on. Lower it, {_INSIST}"
    return [FieldError(detail, path)]
