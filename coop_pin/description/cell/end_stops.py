"""End stops of an arm's joints: springs and dampers beyond its position limits."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from coop_pin.base.schema.base import Description, NotNegative, NumberOrVector, Positive, positive


class EndStops(Description):
    """End stops in the plant: springs with dampers that push joints back into their position limits.

        d = q - q_upper, or q_lower - q;   force = max(0, k d + c d') where d > 0: a stop never pulls
        c = 2 damping_ratio sqrt(k / W),   W: mobility of the joint at the start, in the closed chain

    A joint without position limits has none.

    Attributes:
        stiffness: k, N m/rad, of a prismatic joint N/m; one value for all joints or one for each. When
            omitted the largest force of the drive at the joint, over ``give``.
        give: depth to which the drive's largest force presses its joint into a stop, rad or m.
        damping_ratio: damping of the joint on its stop; 1 is critical.
    """

    stiffness: Annotated[NumberOrVector, AfterValidator(positive)] | None = None
    give: Positive = 0.01
    damping_ratio: NotNegative = 0.5
