"""Friction of an arm's joints as a user says it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Tag, field_validator

from coop_pin.errors import FieldError
from coop_pin.schema.base import Description, NumberOrVector, Positive


class JointFriction(Description):
    """Friction at the drives of an arm, in drive coordinates.

    ``tau_friction = -(viscous * v + coulomb * tanh(v / coulomb_velocity))``

    Attributes:
        viscous: N m s/rad, one value for all joints or one for each.
        coulomb: N m, likewise.
        coulomb_velocity: the speed over which Coulomb friction changes sign, rad/s. A step would cost RK4 its order.
    """

    viscous: NumberOrVector = 0.0
    coulomb: NumberOrVector = 0.0
    coulomb_velocity: Positive = 0.05

    @field_validator("viscous", "coulomb")
    @classmethod
    def _not_negative(cls, value: float | tuple[float, ...]) -> float | tuple[float, ...]:
        if np.min(value) < 0.0:
            raise FieldError(f"is {value}; friction coefficients must not be negative")
        return value


def _kind(value: Any) -> str:
    return "source" if isinstance(value, str) else "coefficients"


# The tags keep the checks apart: a plain union would report one mistake once for each member.
Friction = Annotated[
    Annotated[JointFriction, Tag("coefficients")] | Annotated[Literal["urdf", "none"], Tag("source")],
    Discriminator(_kind),
]
"""Coefficients, "urdf" for those of the URDF's <dynamics>, or "none"."""
