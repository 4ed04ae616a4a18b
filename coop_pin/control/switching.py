"""Switching functions of the sliding surface, eq. (18): sign, saturation (boundary layer) and tanh.

Each is a frozen, validated value that stands in a scenario (``kind`` and fields) and is called by the law.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from coop_pin.arrays import Array
from coop_pin.schema.base import Description, Positive


class Sign(Description):
    """sgn(s), as printed; sgn(0) = 0."""

    kind: Literal["sign"] = "sign"

    def __call__(self, surface: Array) -> Array:
        """Return sgn(s) for every entry: -1, 0 or 1."""
        return np.sign(surface)


class Saturation(Description):
    """Boundary layer: s / width within it, sgn(s) outside.

    Attributes:
        width: half width of the layer, in the unit of the surface.
    """

    kind: Literal["saturation"] = "saturation"
    width: Positive = 0.01

    def __call__(self, surface: Array) -> Array:
        """Return s / width for every entry, limited to [-1, 1]."""
        return np.minimum(np.maximum(surface / self.width, -1.0), 1.0)


class Tanh(Description):
    """tanh(s / width), a smooth sign.

    Attributes:
        width: in the unit of the surface.
    """

    kind: Literal["tanh"] = "tanh"
    width: Positive = 0.01

    def __call__(self, surface: Array) -> Array:
        """Return tanh(s / width) for every entry."""
        return np.tanh(surface / self.width)


Switching = Annotated[Sign | Saturation | Tanh, Field(discriminator="kind")]
"""An odd function of the surface s with values in [-1, 1], chosen by ``kind``."""
