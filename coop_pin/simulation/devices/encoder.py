"""Encoders of one arm, and the drive velocities that are computed from their readings."""

from __future__ import annotations

from math import exp, pi
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.description.sensors import (
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
        resolution: size of a count, rad; 0 is continuous.
        offset: error of the zero, rad.
        velocity: kind of the velocity estimate.
        pole: p of the estimate's filter or observer.
        period: T, s.
    """

    resolution: Array
    offset: Array
    velocity: str
    pole: float
    period: float

    @classmethod
    def of_sensors(cls, sensors: Sensors, period: float, joints: int, path: str) -> Encoders:
        """Return the encoders of an arm.

        Args:
            sensors: Sensors of the arm.
            period: T, s.
            joints: Number of drives.
            path: Place of the sensors in the scenario, for error messages.

        Raises:
            FieldError: the number of values differs from that of the drives.
        """
        resolution, _, offset = (
            per_joint(np.array(value), joints, f"{path}.encoder.{name}") for name, value in sensors.encoder
        )
        pole = exp(-2.0 * pi * sensors.velocity.filter_hz * period)
        return cls(resolution, offset, sensors.velocity.kind, pole, period)

    def start(self, q: Array, noise: Array) -> EncoderState:
        """Return the state before the first tick, at rest.

        Args:
            q: True drive coordinates at the first tick, rad, shape (k,).
            noise: Noise of the first tick, rad, shape (k,).
        """
        return EncoderState(self._reading(q, noise), np.zeros(q.size))

    def step(
        self, state: EncoderState, q: Array, v: Array, noise: Array
    ) -> tuple[tuple[Array, Array], EncoderState]:
        """Return measured position and velocity of the drives at a tick, shape (k,) both, and the state.

        Args:
            state: State after the tick before.
            q: True drive coordinates, rad, shape (k,).
            v: True drive velocities, rad/s, shape (k,).
            noise: Noise of this tick, rad, shape (k,).
        """
        q, (last, estimate), p, T = self._reading(q, noise), state, self.pole, self.period
        if self.velocity == "ideal":
            return (q, v), EncoderState(q, estimate)
        if self.velocity == "difference":
            estimate = p * estimate + (1.0 - p) * (q - last) / T
            return (q, estimate), EncoderState(q, estimate)
        e = q - last - T * estimate
        state = EncoderState(q - p**2 * e, estimate + (1.0 - p) ** 2 * e / T)
        return (q, state.velocity), state

    def _reading(self, q: Array, noise: Array) -> Array:
        """Return the counted positions of the drives, rad, shape (k,)."""
        is_counted = self.resolution > 0.0
        # A continuous encoder divides by one and keeps the undivided value.
        count = np.where(is_counted, self.resolution, 1.0)
        q = q + noise
        return np.where(is_counted, count * np.round(q / count), q) + self.offset
