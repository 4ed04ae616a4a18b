"""Encoders of one arm, and the drive velocities that are computed from their readings."""

from __future__ import annotations

from math import exp, pi

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


class Encoders:
    """Encoders of one arm, with the state of its velocity estimate."""

    def __init__(
        self, sensors: Sensors, period: float, rng: np.random.Generator, joints: int, path: str
    ) -> None:
        """Start without a reading.

        Args:
            sensors: of the arm.
            period: T, s.
            rng: source of the noise.
            joints: number of drives.
            path: of the sensors in the scenario, for error messages.

        Raises:
            FieldError: the number of values differs from that of the drives.
        """
        self._resolution, self._noise, self._offset = (
            per_joint(np.array(getattr(sensors.encoder, name)), joints, f"{path}.encoder.{name}")
            for name in Encoder.model_fields
        )
        # A continuous encoder divides by one and keeps the undivided value.
        self._is_counted = self._resolution > 0.0
        self._count = np.where(self._is_counted, self._resolution, 1.0)
        self._velocity, self._period, self._rng = sensors.velocity, period, rng
        self._last: Array | None = None
        self._estimate = np.zeros(joints)

    def restart(self) -> None:
        """Take the next reading as the first, at rest."""
        self._last = None

    def read(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return measured position and velocity of the drives at the next tick, shape (k,) each.

        Args:
            q: true drive coordinates, rad, shape (k,).
            v: true drive velocities, rad/s, shape (k,).
        """
        q = q + self._noise * self._rng.standard_normal(q.size)
        q = np.where(self._is_counted, self._count * np.round(q / self._count), q) + self._offset
        last, T = q if self._last is None else self._last, self._period
        if self._last is None:
            self._estimate = np.zeros(q.size)
        match self._velocity:
            case IdealVelocity():
                return q, v.copy()
            case DifferencedVelocity(cutoff_hz=cutoff_hz):
                p = exp(-2.0 * pi * cutoff_hz * T)
                self._estimate = p * self._estimate + (1.0 - p) * (q - last) / T
                self._last = q
            case ObservedVelocity(bandwidth_hz=bandwidth_hz):
                p = exp(-2.0 * pi * bandwidth_hz * T)
                e = q - last - T * self._estimate
                self._last, self._estimate = q - p**2 * e, self._estimate + (1.0 - p) ** 2 * e / T
        return q, self._estimate.copy()
