"""The choice of a controller: its name, gains, switching function and force path."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from coop_pin.description.force_path import ForcePath, NoForcePath
from coop_pin.description.gains import PayloadSpaceGains, PostureGains, SlidingModeGains
from coop_pin.description.switching import Sign, Switching
from coop_pin.errors import FieldError
from coop_pin.schema.base import Description, NotNegative


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


Controller = Annotated[SlidingMode | RedundantSlidingMode | PayloadSpace | UserController, Field(discriminator="kind")]

Prescribed = SlidingMode | RedundantSlidingMode | PayloadSpace
"""The laws that come with coop_pin."""
