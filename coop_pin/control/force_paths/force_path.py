"""Force paths, by which measured internal wrenches reach a law."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from coop_pin.base.schema.base import Description
from coop_pin.base.schema.delay import Delay
from coop_pin.control.controller import ArmController
from coop_pin.control.measurement import ControlledArm

INSIST = "or insist with beyond_bound = true"
"""Advice for those who know better than the bounds."""


Split = Literal["shares", "virtual-linkage"]
"""Load in the measured wrenches, which less it are internal: shares about P, or forces at the tips."""


class ForcePathTraits:
    """Properties of a force path, with their defaults."""

    measures: ClassVar[bool] = True
    """Whether a wrench is measured."""
    by_sensors: ClassVar[bool] = False
    """Whether the internal wrench comes with the measurement, from the wrists of all arms."""
    hears_all: ClassVar[bool] = False
    """Whether every arm hears all others, and its wrench is as late as their messages."""
    exchanges_wrenches: ClassVar[bool] = True
    """Whether wrenches cross between the arms."""

    def wrapped(self, law: ArmController, arm: ControlledArm, scenario: Any) -> ArmController:
        """Return the law of an arm, in a wrapper that forms its internal wrench where no sensor gives it.

        Args:
            law: Law of the arm.
            arm: Numbers of the arm.
            scenario: Scenario to run.

        Raises:
            FieldError: the network does not carry what the path needs.
        """
        return law


class PlainForcePath(ForcePathTraits, Description):
    """Force path without filter, delay and split of its own."""

    pole: ClassVar[float] = 0.0
    delay: ClassVar[int] = 0
    split: ClassVar[Split] = "shares"


class NoForcePath(PlainForcePath):
    """No measured internal wrench: K_f must be zero, and the law is truly decentralised."""

    measures: ClassVar[bool] = False
    exchanges_wrenches: ClassVar[bool] = False

    kind: Literal["none"] = "none"


class LateForcePath(ForcePathTraits, Description):
    """Internal wrench of one tick before: f_m[k] = f(t_k^-), f_m[0] = f_d.

    Attributes:
        delay: D, ticks of transport, or a time such as "5 ms", rounded up to ticks:
            f_m[k] = f(t_{k-D}^-), and f_d until the first sample is there.
        split: Load in the measured wrenches: the "shares" about P, or in the "virtual-linkage" tip
            forces without moments, which patches can bear; then the payload's mass may be unknown.
    """

    by_sensors: ClassVar[bool] = True
    pole: ClassVar[float] = 0.0

    kind: Literal["late"] = "late"
    delay: Delay = 0
    split: Split = "shares"


class LowPassForcePath(ForcePathTraits, Description):
    """Discrete low-pass filter: f_m[k] = p f_m[k-1] + (1 - p) f(t_k^-), f_m[0] = f_d.

    It takes every sample once, when it arrives; between samples of slow sensors it holds.

    Attributes:
        pole: p, in [0, 1).
        delay: D, ticks of transport, or a time, before the filter, which then takes f(t_{k-D}^-).
        split: Load in the measured wrenches, as of LateForcePath.
    """

    by_sensors: ClassVar[bool] = True

    kind: Literal["low-pass"] = "low-pass"
    pole: float = Field(default=0.9, ge=0.0, lt=1.0)
    delay: Delay = 0
    split: Split = "shares"
