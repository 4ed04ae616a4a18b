"""How the internal wrench reaches a law: an explicit choice, because it decides which force gains are stable."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from coop_pin.control.bounds import force_gain_bound
from coop_pin.schema.base import Description


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
