"""Wrist sensor of one arm, and the transport of the internal wrenches to the controllers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import rotate_vector6


def _delayed(late: Array, sample: Array, delays: Array | None = None) -> tuple[Array, Array]:
    """Return the sample that arrives, and those still on their way, the oldest first.

    Args:
        late: Samples of the last ticks.
        sample: Sample of this tick.
        delays: Mask of the delay among 0, 1, ... ticks; the longest one when None.
    """
    if not len(late):
        return sample, late
    late = np.concatenate((late, sample[None]))
    arrives = late[0]
    for ticks, is_delay in enumerate(() if delays is None else delays):
        arrives = np.where(is_delay, late[-1 - ticks], arrives)
    return arrives, late[1:]


class Wrist(NamedTuple):
    """Samples of a wrist sensor on their way to the controller; signals say when one arrives.

    Attributes:
        late: samples of the last ticks, the oldest first, N and N m, shape (delay, 6); (longest delay, 6) in
            the code of runs whose delays differ.
        wrench: newest sample that has arrived: F_i about P in world axes, as the arm's kinematics saw them
            when it was taken, shape (6,); zero before the first.
    """

    late: Array
    wrench: Array

    @classmethod
    def at_rest(cls, delay: int) -> Wrist:
        """Return the state before the first sample, with a delay in ticks."""
        return cls(np.zeros((delay, 6)), np.zeros(6))

    def step(
        self, F_P: Array, error_P: Array, R_WP: Array, arrived: Array, delays: Array | None = None
    ) -> Wrist:
        """Return the state at the next tick.

        Args:
            F_P: True F_i about P in payload axes, shape (6,).
            error_P: Error of the sample, likewise, shape (6,).
            R_WP: Orientation of the payload as the arm's kinematics see it, shape (3, 3).
            arrived: Whether a sample arrives, a mask.
            delays: Mask of the delay among 0, 1, ... ticks; None for that of the samples on their way.
        """
        sample, late = _delayed(self.late, rotate_vector6(R_WP, F_P + error_P), delays)
        return Wrist(late, np.where(arrived, sample, self.wrench))


class ForcePathState(NamedTuple):
    """Internal wrenches on their way to the controllers, task rows.

    Attributes:
        late: internal wrenches of the last ticks, the oldest first, shape (delay, m, k_0).
        measured: f_m of each arm, shape (m, k_0).
    """

    late: Array
    measured: Array


class ForcePath(NamedTuple):
    """Force path f_m[k] = p f_m[k-1] + (1 - p) f(t_{k-D}^-); each sample passes the filter once.

    Attributes:
        pole: p.
        late: internal wrenches before the first tick, zero, shape (D, m, k_0).
    """

    pole: float
    late: Array

    def start(self, desired: Array) -> ForcePathState:
        """Return the state before the first sample: f_m[0] = f_d, shape (m, k_0)."""
        return ForcePathState(self.late, desired)

    def step(self, state: ForcePathState, internal: Array, arrived: Array) -> ForcePathState:
        """Return the state at the next tick.

        Args:
            state: State after the tick before.
            internal: Internal wrenches of this tick, shape (m, k_0).
            arrived: Whether a sample arrives, a mask.
        """
        (f, late), p, f_m = _delayed(state.late, internal), self.pole, state.measured
        return ForcePathState(late, np.where(arrived, p * f_m + (1.0 - p) * f, f_m))
