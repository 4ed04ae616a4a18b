"""Motion along decaying exponentials, as in the reference experiment."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from coop_pin.arrays import Array, as_array
from coop_pin.errors import NotPositiveError
from coop_pin.reference.checks import keep
from coop_pin.reference.target import PoseReference, PoseTarget
from coop_pin.spatial import make_pose


@dataclass(frozen=True, eq=False)
class Exponentials(PoseReference):
    """p(t) = constant + sum_k amplitude_k exp(-t / tau_k) with a fixed orientation.

    Gueaieb et al. (2007), section 4, is ``x_d = 0.4 - 0.2 exp(-t/6.6) + 0.5 exp(-t/6.8)``, ``y_d = x_d/sqrt(3) - 0.2``,
    ``psi_d = pi/3``. The motion does not start at rest; the formula holds at negative times as well, where it grows.

    Attributes:
        constant: where the motion ends, m, shape (3,).
        amplitudes: one vector for each exponential, m, shape (n, 3).
        time_constants: tau_k, s, positive, shape (n,).
        rpy: the fixed orientation, roll, pitch, yaw, rad, shape (3,).

    Raises:
        ShapeError: shapes differ from these.
        NotFiniteError: an entry is NaN or infinite.
        NotPositiveError: a time constant is zero or less.
    """

    constant: Array
    amplitudes: Array
    time_constants: Array
    rpy: Array
    _rates: Array = field(init=False, repr=False)
    _base: Array = field(init=False, repr=False)
    _columns: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the fields and lay the target out as base (28,) + columns (28, n) exp(rates t)."""
        constant = as_array("constant", self.constant, 3)
        amplitudes = as_array("amplitudes", self.amplitudes, "n", 3)
        time_constants = as_array("time_constants", self.time_constants, len(amplitudes))
        rpy = as_array("rpy", self.rpy, 3)
        for index, time_constant in enumerate(time_constants):
            if time_constant <= 0.0:
                raise NotPositiveError(f"time_constants[{index}]", float(time_constant))
        rates = -1.0 / time_constants
        base = np.concatenate((make_pose(constant, rpy).reshape(16), np.zeros(12)))
        columns = np.zeros((28, len(rates)))
        columns[[3, 7, 11]] = amplitudes.T
        columns[16:19] = amplitudes.T * rates
        columns[22:25] = amplitudes.T * rates**2
        keep(self, constant=constant, amplitudes=amplitudes, time_constants=time_constants, rpy=rpy)
        keep(self, _rates=rates, _base=base, _columns=columns)

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        flat = self._columns @ np.exp(self._rates * time)
        flat += self._base
        flat.flags.writeable = False
        return PoseTarget(flat[:16].reshape(4, 4), flat[16:22], flat[22:])
