"""Encoders of one arm, and the drive velocities that are computed from their readings."""

from __future__ import annotations

from math import exp, pi
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.sensors import (
    DifferencedVelocity,
    Encoder,
    IdealVelocity,
    ObservedVelocity,
    Sensors,
)
from coop_pin.model.joint_limits import per_joint


class EncoderState(NamedTuple):
    """Memory of the velocity estimate.

    Attributes:
        position: last reading, or the observer's position, rad, shape (k,).
        velocity: the estimate, rad/s, shape (k,).
    """

    position: Array
    velocity: Array


class Encoders(NamedTuple):
    """Encoders of one arm; every row has one value for each drive, shape (k,).

    Attributes:
        resolution: of a count, rad; 0 is continuous.
        noise: standard deviation at each tick, rad.
        offset: of the zero, rad.
        velocity: kind of the estimate.
        pole: p of its filter or observer.
        period: T, s.
    """

    resolution: Array
    noise: Array
    offset: Array
    velocity: str
    pole: float
    period: float

    @classmethod
    def of_sensors(cls, sensors: Sensors, period: float, joints: int, path: str) -> Encoders:
        """Return the encoders of an arm.

        Args:
            sensors: of the arm.
            period: T, s.
            joints: number of drives.
            path: of the sensors in the scenario, for error messages.

        Raises:
            FieldError: the number of values differs from that of the drives.
        """
        resolution, noise, offset = (
            per_joint(np.array(getattr(sensors.encoder, name)), joints, f"{path}.encoder.{name}")
            for name in Encoder.model_fields
        )
        match sensors.velocity:
            case DifferencedVelocity(cutoff_hz=rate_hz) | ObservedVelocity(bandwidth_hz=rate_hz):
                pole = exp(-2.0 * pi * rate_hz * period)
            case IdealVelocity():
                pole = 0.0
        return cls(resolution, noise, offset, sensors.velocity.kind, pole, period)

    def read(
        self, q: Array, v: Array, noise: Array, state: EncoderState | None
    ) -> tuple[Array, Array, EncoderState]:
        """Return measured position and velocity of the drives at the next tick, shape (k,), and the state.

        Args:
            q: true drive coordinates, rad, shape (k,).
            v: true drive velocities, rad/s, shape (k,).
            noise: of this tick, rad, shape (k,).
            state: after the tick before; None at the first, at rest.
        """
        is_counted = self.resolution > 0.0
        # A continuous encoder divides by one and keeps the undivided value.
        count = np.where(is_counted, self.resolution, 1.0)
        q = q + noise
        q = np.where(is_counted, count * np.round(q / count), q) + self.offset
        last, estimate = (q, np.zeros(q.size)) if state is None else state
        p, T = self.pole, self.period
        if self.velocity == "ideal":
            return q, v.copy(), EncoderState(q, estimate)
        if self.velocity == "difference":
            estimate = p * estimate + (1.0 - p) * (q - last) / T
            return q, estimate.copy(), EncoderState(q, estimate)
        e = q - last - T * estimate
        state = EncoderState(q - p**2 * e, estimate + (1.0 - p) ** 2 * e / T)
        return q, state.velocity.copy(), state
