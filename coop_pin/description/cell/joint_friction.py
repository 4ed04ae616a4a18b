"""Friction at the drives of an arm: viscous, Coulomb and Stribeck."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Discriminator, Tag, ValidationInfo, field_validator

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, Magnitude, NumberOrVector, Positive


class JointFriction(Description):
    """Viscous, smoothed Coulomb and Stribeck friction at the drives of an arm, in drive coordinates.

        tau_friction = -(viscous v + level tanh(v / coulomb_velocity))
        level = coulomb + (stiction - coulomb) exp(-(v / stribeck_velocity)^2)

    A smooth law never sticks: below coulomb_velocity a load creeps. Keep stribeck_velocity several times
    larger, otherwise the smoothing hides the peak of stiction.

    Attributes:
        viscous: N m s/rad, one value for all joints or one for each.
        coulomb: N m, one value for all joints or one for each.
        coulomb_velocity: speed within which Coulomb friction changes sign, rad/s. A discontinuity would
            reduce the order of RK4.
        stiction: level of the friction towards zero speed, N m, not below ``coulomb``; one value for all
            joints or one for each; as ``coulomb`` when omitted.
        stribeck_velocity: speed at which the level falls from stiction to Coulomb friction, rad/s.
    """

    viscous: Magnitude = 0.0
    coulomb: Magnitude = 0.0
    coulomb_velocity: Positive = 0.05
    stiction: NumberOrVector | None = None
    stribeck_velocity: Positive = 0.2

    @field_validator("stiction")
    @classmethod
    def _not_below_coulomb(
        cls, stiction: float | tuple[float, ...] | None, earlier: ValidationInfo
    ) -> float | tuple[float, ...] | None:
        coulomb = earlier.data.get("coulomb", 0.0)
        sizes = {len(value) for value in (stiction, coulomb) if isinstance(value, tuple)}
        # Sizes that disagree are left to the arm, which names all of them.
        if stiction is not None and len(sizes) < 2 and np.less(stiction, coulomb).any():
            raise FieldError(f"is {stiction}; it must be at least coulomb, {coulomb}")
        return stiction


# The tags separate the members: pydantic would report a mistake in a plain union once for each of them.
Friction = Annotated[
    Annotated[JointFriction, Tag("coefficients")] | Annotated[Literal["urdf", "none"], Tag("source")],
    Discriminator(lambda value: "source" if isinstance(value, str) else "coefficients"),
]
"""Friction coefficients, "urdf" for those of the URDF's <dynamics>, or "none"."""
