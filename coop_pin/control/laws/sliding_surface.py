"""Laws with a sliding surface: their common gains, and the switching functions of their integral, eq. (18).

A switching function is sign, saturation (boundary layer) or tanh: a frozen, validated value that stands in a
scenario (``kind`` and fields) and is called by the law.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Generic, Literal, TypeVar

import numpy as np
from pydantic import Field

from coop_pin.base.arrays import Array
from coop_pin.base.schema.base import Description, NotNegative, Positive
from coop_pin.control.gains import Gains, PositiveGain, SignGain
from coop_pin.control.law import DecentralisedLaw
from coop_pin.control.steady_state import NearRest


class Sign(Description):
    """sgn(s) with a dead zone around 0; a dead zone of 0 is sgn as printed, with sgn(0) = 0.

    A surface that should be 0 is not: it carries the rounding of the kinematics (1e-16 to 1e-13) and the
    closure error that the integration leaves (1e-11 m times pose_gain), and sgn would integrate their sign.
    The default lies above both and far below any signal: one tick of sgn moves the surface by about
    alpha T, 1e-3 in the catalogue, and a surface of 1e-9 stands for an error of 1e-9 / pose_gain, m or rad.

    Attributes:
        dead_zone: sgn(s) = 0 for abs(s) <= dead_zone, in the unit of the surface.
    """

    is_smooth: ClassVar[bool] = False
    width: ClassVar[float] = np.nan
    """It has no layer."""

    kind: Literal["sign"] = "sign"
    dead_zone: NotNegative = 1e-9

    def __call__(self, surface: Array) -> Array:
        """Return sgn(s) for every entry: -1, 0 or 1."""
        return np.sign(surface) * (np.abs(surface) > self.dead_zone)


class Saturation(Description):
    """Boundary layer: s / width within it, sgn(s) outside.

    Attributes:
        width: half width of the layer, in the unit of the surface.
    """

    is_smooth: ClassVar[bool] = True

    kind: Literal["saturation"] = "saturation"
    width: Positive = 0.01

    def __call__(self, surface: Array) -> Array:
        """Return s / width for every entry, limited to [-1, 1]."""
        return np.minimum(np.maximum(surface / self.width, -1.0), 1.0)


class Tanh(Description):
    """tanh(s / width), a smooth sign.

    Attributes:
        width: scale of the transition, in the unit of the surface.
    """

    is_smooth: ClassVar[bool] = True

    kind: Literal["tanh"] = "tanh"
    width: Positive = 0.01

    def __call__(self, surface: Array) -> Array:
        """Return tanh(s / width) for every entry."""
        return np.tanh(surface / self.width)


Switching = Annotated[Sign | Saturation | Tanh, Field(discriminator="kind")]
"""An odd function of the surface s with values in [-1, 1], chosen by ``kind``."""


class SurfaceGains(Gains):
    """Gains common to the laws with a sliding surface.

    Attributes:
        pose_gain: gamma, how fast pose errors decay, 1/s; one for all task rows (6, or 3 for a planar cell)
            or one for each.
        sign_gain: alpha, on the integral of the error's sign; diagonal. On the joints, rad/s^2, or on the
            task rows, m/s^2 and rad/s^2: see the law.
        force_gain: K_f, how strongly the measured internal wrench is fed back; no unit.
        transient_rate: kappa of eq. (20), how fast the sliding surface that starts at the first error decays,
            1/s.
    """

    are_matrices: ClassVar[bool] = True

    pose_gain: PositiveGain
    sign_gain: SignGain
    force_gain: NotNegative = 0.0
    transient_rate: Positive


G = TypeVar("G", bound=SurfaceGains)


class SurfaceLaw(DecentralisedLaw[G], Generic[G]):
    """Fields common to the laws with a sliding surface.

    Attributes:
        switching: Switching function of the integral, eq. (18).
    """

    equal_gains: ClassVar[Mapping[str, str]] = {
        "pose_gain": "Theorem 2 needs one gamma",
        "force_gain": "Theorem 2 needs one K_f",
    }

    switching: Switching = Sign()

    @property
    def needs(self) -> tuple[str, ...]:
        """Needs of the law: the internal wrench if K_f is not zero."""
        return self.measured(["internal wrench"] if self.gains.force_gain > 0.0 else [])

    @property
    def near_rest(self) -> NearRest:
        """Model near rest, with a linear integral where the switching function is smooth at 0."""
        if self.switching.is_smooth:
            return super().near_rest._replace(integral="linear")
        return super().near_rest._replace(integral="sign" if np.any(self.gains.sign_gain) else "none")
