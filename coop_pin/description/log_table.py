"""Table of a log: which topic is which arm, signs, units, and further knowledge."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, Interval, NotNegative, Vector3

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of time of a log, s."""


class ArmLog(Description):
    """Topics of one arm in a log; in a CSV file, how the names of its columns begin.

    Attributes:
        joints: topic of the joint states (JointState).
        wrench: topic of the wrist's wrench (WrenchStamped) in axes and origin of the tip; empty without one.
        wrench_sign: 1 if it is the wrench on the arm by the payload, -1 if that on the payload.
        hand_mass: mass behind the sensor that belongs to the arm, and whose weight is still in the wrench,
            kg; its error is estimated.
        hand_centre: centre of the hand in axes of the tip, m.
    """

    joints: str
    wrench: str = ""
    wrench_sign: Literal[1, -1] = 1
    hand_mass: NotNegative = 0.0
    hand_centre: Vector3 = (0.0, 0.0, 0.0)


class LogTable(Description):
    """Topics of a log, its units, and further knowledge.

    Attributes:
        arms: topics of every arm.
        desired: topic of the desired pose of the payload (PoseStamped), which the replay shows, or empty.
        angle: unit of joint positions and velocities.
        time: unit of the column "time" of a CSV file; stamps of messages are in seconds and nanoseconds.
        free: interval in which the hands were free and at rest, s from the start of the log. Without one, the
            zero of the squeeze is not seen.
        shares: load share of each arm that the law is known to have run with, in place of those of the cell,
            as ``{left = 0.48, right = 0.52}``. What the log shows beside them is a cause.
    """

    arms: dict[str, ArmLog]
    desired: str = ""
    angle: Literal["rad", "deg"] = "rad"
    time: Literal["s", "ms", "us", "ns"] = "s"
    free: Interval | None = None
    shares: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _free_ends_after_its_start(self) -> Self:
        if self.free is not None and not 0.0 <= self.free[0] < self.free[1]:
            raise FieldError(
                f"is {list(self.free)}; it starts at 0 or later and ends after its start", "free"
            )
        return self
