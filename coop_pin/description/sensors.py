"""Sensors of an arm: encoders, joint velocity, wrist wrench and holding torques, with their errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import (
    Description,
    Interval,
    Magnitude,
    NotNegative,
    NumberOrVector,
    Positive,
    by_name,
    not_negative,
)
from coop_pin.base.schema.delay import Delay


class Encoder(Description):
    """Encoders at the drives of an arm: ``resolution * round((q + noise) / resolution) + offset``.

    Every field is one value for all drives or one for each. The arm's kinematics take in what they read.

    Attributes:
        resolution: angle of a count, rad; 0 is continuous.
        noise: standard deviation at each tick, rad, Gaussian and white.
        offset: offset of the zero, rad.
    """

    resolution: Magnitude = 0.0
    noise: Magnitude = 0.0
    offset: NumberOrVector = 0.0


class IdealVelocity(Description):
    """The velocity of the plant."""

    filter_hz: ClassVar[float] = math.inf
    """Frequency of its filter, Hz; as in the other kinds."""

    kind: Literal["ideal"] = "ideal"


class DifferencedVelocity(Description):
    """Difference of two encoder readings, low-pass filtered: v[k] = p v[k-1] + (1 - p)(q[k] - q[k-1]) / T.

    ``p = exp(-2 pi cutoff_hz T)``, at rest at the first tick.

    Attributes:
        cutoff_hz: cutoff frequency of the filter, Hz.
    """

    kind: Literal["difference"] = "difference"
    cutoff_hz: Positive = 20.0

    @property
    def filter_hz(self) -> float:
        """Cutoff frequency of the filter, Hz."""
        return self.cutoff_hz


class ObservedVelocity(Description):
    """Observer of a constant velocity, corrected by the encoder's reading; both of its poles are p.

    With ``e = q[k] - q_o[k-1] - T v_o[k-1]``: ``q_o[k] = q[k] - p^2 e`` and ``v_o[k] = v_o[k-1] + (1 - p)^2 e
    / T``, where ``p = exp(-2 pi bandwidth_hz T)``, at rest at the first tick.

    Attributes:
        bandwidth_hz: Hz.
    """

    kind: Literal["observer"] = "observer"
    bandwidth_hz: Positive = 20.0

    @property
    def filter_hz(self) -> float:
        """Bandwidth of the observer, Hz."""
        return self.bandwidth_hz


Velocity = Annotated[IdealVelocity | DifferencedVelocity | ObservedVelocity, Field(discriminator="kind")]


class WrenchParts(Description):
    """Force and moment of a wrench in sensor axes, each one value for three axes or one for each.

    Attributes:
        force: N.
        moment: about the sensor's origin, N m.
    """

    force: NumberOrVector = 0.0
    moment: NumberOrVector = 0.0

    @field_validator("force", "moment")
    @classmethod
    def _one_or_three(cls, value: float | tuple[float, ...]) -> float | tuple[float, ...]:
        if isinstance(value, tuple) and len(value) != 3:
            raise FieldError(f"has {len(value)} entries {list(value)}; it must be a number or have 3")
        return value

    @property
    def vector6(self) -> Array:
        """Force, then moment, shape (6,)."""
        return np.concatenate([np.full(3, part) for part in (self.force, self.moment)])


class WristSensor(Description):
    """Sensor of the wrench F_i between the tip of an arm and the payload, in the axes and origin of the tip.

    Nothing but the payload hangs behind it: a gripper is part of the arm, in front of it. So it reads neither
    weight nor inertia of its own. The errors add to the true wrench in sensor axes.

    Attributes:
        noise: standard deviation of each sample, Gaussian and white.
        offset: constant.
        drift: growth of the offset, N/s and N m/s.
        delay: ticks from a sample until the controller has it, or a time such as "5 ms", rounded up to ticks.
        rate_hz: rate of the samples, Hz: the control rate, which is the default, divided by a whole number.
            The last sample is held in between.
        lost: intervals of time without samples, [start, end), s.
        stuck_at: time from which every sample repeats the one before, s; it arrives as a new one.
    """

    noise: WrenchParts = WrenchParts()
    offset: WrenchParts = WrenchParts()
    drift: WrenchParts = WrenchParts()
    delay: Delay = 0
    rate_hz: Positive | None = None
    lost: tuple[Interval, ...] = ()
    stuck_at: NotNegative | None = None

    @field_validator("noise")
    @classmethod
    def _no_negative_noise(cls, noise: WrenchParts) -> WrenchParts:
        for part, value in noise:
            try:
                not_negative(value)
            except FieldError as error:
                raise error.below(part) from None
        return noise

    @field_validator("lost")
    @classmethod
    def _from_start_to_end(cls, lost: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        for index, (start, end) in enumerate(lost):
            if not 0.0 <= start < end:
                raise FieldError(
                    f"is [{start:g}, {end:g}]; an interval starts at 0 or later and ends after its start",
                    str(index),
                )
        return lost


class SlipSensor(Description):
    """Sensor of the distance that an arm's patch has slid since it took hold, at every tick.

    Attributes:
        noise: standard deviation at each tick, m, Gaussian and white.
        delay: ticks until the controllers have it, or a time.
    """

    noise: NotNegative = 0.0
    delay: Delay = 0


class SharedJointSensor(Description):
    """Sensor of the shared joints under an arm: ``resolution * round(q / resolution) + offset``.

    Attributes:
        told: knowledge of the arm: "all", position and rate; "position", so that it takes the rate for zero;
            or "nothing", as by the name "not told", so that it takes the joints for where they start.
        resolution: size of a count, m or rad; 0 is continuous.
        offset: offset of the zero, m or rad.
        delay: ticks until the arm is told, or a time.
    """

    told: Literal["all", "position", "nothing"] = "all"
    resolution: NotNegative = 0.0
    offset: float = 0.0
    delay: Delay = 0


SharedSensor = Annotated[
    SharedJointSensor,
    by_name({"not told": SharedJointSensor(told="nothing")}, "a table of fields"),
]
"""What an arm is told of shared joints, or "not told"."""


class Sensors(Description):
    """What an arm measures with. Everything is ideal by default, and there is no wrist sensor.

    Attributes:
        encoder: encoders of the drives.
        velocity: source of the velocities of the drives.
        wrist: sensor of the arm's own interaction wrench; none when omitted.
        holding_torque_error: relative error of the holding torques that the drives report, one value for all
            drives or one for each.
        slip: sensor of the slip of the arm's patch; ideal when omitted.
        shared_joints: sensor of the shared joints or the rolling base under the arm, a table or "not told".
    """

    encoder: Encoder = Encoder()
    velocity: Velocity = IdealVelocity()
    wrist: WristSensor | None = None
    holding_torque_error: NumberOrVector = 0.0
    slip: SlipSensor | None = None
    shared_joints: SharedSensor = SharedJointSensor()

    @property
    def joints_are_ideal(self) -> bool:
        """Whether positions and velocities of the drives are measured as they are."""
        return self.encoder == Encoder() and self.velocity == IdealVelocity()

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return what is wrong with the times of the sensors.

        Args:
            run: fields of the run; without its ``clock`` or ``duration``, which then have mistakes
                themselves, nothing is checked.
        """
        wrist = self.wrist
        if not {"clock", "duration"} <= set(run):
            return []
        clock, duration = run["clock"], run["duration"]
        problems = [] if self.slip is None else clock.late(self.slip.delay, duration, "slip.delay")
        problems += clock.late(self.shared_joints.delay, duration, "shared_joints.delay")
        if wrist is None:
            return problems
        problems += clock.late(wrist.delay, duration, "wrist.delay")
        problems += clock.uneven(wrist.rate_hz, "wrist.rate_hz")
        for index, (_, end) in enumerate(wrist.lost):
            if end > duration:
                detail = (
                    f"ends at {end:g} s; the run ends at {duration:g} s: lengthen it or end the loss before"
                )
                problems.append(FieldError(detail, f"wrist.lost.{index}"))
        return problems
