"""Switching functions of the sliding surface, eq. (18): sign, saturation (boundary layer) and tanh.

Each is a frozen, validated value that stands in a scenario (``kind`` and fields) and is called by the law.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from coop_pin.arrays import Array
from coop_pin.schema.base import Description, NotNegative, Positive


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
