"""The choice of a switching function."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from coop_pin.schema.base import Description, Positive


class Sign(Description):
    """sgn(s), as printed; sgn(0) = 0."""

    kind: Literal["sign"] = "sign"


class Saturation(Description):
    """s / width, cut at -1 and 1: a boundary layer.

    Attributes:
        width: half width of the layer, in the unit of the surface (rad/s).
    """

    kind: Literal["saturation"] = "saturation"
    width: Positive = 0.01


class Tanh(Description):
    """tanh(s / width).

    Attributes:
        width: in the unit of the surface (rad/s).
    """

    kind: Literal["tanh"] = "tanh"
    width: Positive = 0.01


Switching = Annotated[Sign | Saturation | Tanh, Field(discriminator="kind")]
