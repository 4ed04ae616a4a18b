"""What the payload is asked to do: the desired motion and the desired internal wrench."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from coop_pin.description.base import Description, Positive, Vector3
from coop_pin.description.pose import Pose
from coop_pin.errors import FieldShapeError
from coop_pin.reference import Exponentials, Hold, PoseReference


class HoldMotion(Description):
    """Stay at a pose.

    Attributes:
        pose: X_WP_d.
    """

    kind: Literal["hold"] = "hold"
    pose: Pose

    def build(self) -> PoseReference:
        """Return the reference."""
        return Hold(self.pose.matrix)


class ExponentialMotion(Description):
    """p_d(t) = constant + sum_k amplitudes_k exp(-t / time_constants_k), at a fixed orientation.

    Attributes:
        constant: m.
        amplitudes: one vector for each term, m.
        time_constants: s.
        rpy: orientation, rad.
    """

    kind: Literal["exponentials"] = "exponentials"
    constant: Vector3
    amplitudes: tuple[Vector3, ...]
    time_constants: tuple[Positive, ...]
    rpy: Vector3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _one_constant_each(self) -> Self:
        if len(self.amplitudes) != len(self.time_constants):
            raise FieldShapeError(f"has {len(self.time_constants)} entries for {len(self.amplitudes)} amplitudes", "time_constants")
        return self

    def build(self) -> PoseReference:
        """Return the reference."""
        return Exponentials(np.array(self.constant), np.array(self.amplitudes), np.array(self.time_constants), np.array(self.rpy))


Motion = Annotated[HoldMotion | ExponentialMotion, Field(discriminator="kind")]
