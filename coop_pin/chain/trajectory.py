"""The motion of a closed chain over time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array
from coop_pin.chain.chain_dynamics import ChainState
from coop_pin.chain.integrators import INTEGRATORS, RUNGE_KUTTA_NODES, configuration_space
from coop_pin.chain.projection import Projected
from coop_pin.errors import (
    ArgumentError,
    IntegrationError,
    MassMatrixError,
    OpenClosureError,
    OutOfRangeError,
)

TorqueLaw = Callable[[float, Array, Array], ArrayLike]
"""(t, q, v) -> generalised force tau, N m and N, shape (nv,)."""

Acceleration = Callable[[Array, Array, Array, int | None], Array]
Project = Callable[[Array, Array, int | None], Projected]

_ROUNDING = 1e-9
_NO_POWERS = np.zeros(0)


class Trajectory(NamedTuple):
    """A motion, sampled at every step.

    Attributes:
        time: s, shape (n,).
        q: configurations, shape (n, nq).
        v: velocities, shape (n, nv).
    """

    time: Array
    q: Array
    v: Array


class Propagator:
    """Carries a state along by Runge-Kutta 4.

    The rank of the closures where a step begins holds for the step. Its stages stand a little off the
    closures, where redundant rows of an over-constrained loop look independent and would hold the mechanism
    fast.
    """

    def __init__(
        self, model: pin.Model, acceleration: Acceleration, torque: TorqueLaw | None, project: Project | None
    ) -> None:
        """Take the parts of a motion.

        Args:
            model: the tree.
            acceleration: (q, v, tau, rank) -> a.
            torque: the generalised force; none when None.
            project: (q, v, rank) -> state on the closures, done after every step; nothing is done when None.

        Raises:
            ArgumentError: torque cannot be called.
        """
        if torque is not None and not callable(torque):
            raise ArgumentError(f"torque is {torque!r}; it must be a function of (t, q, v), or None")
        self._acceleration, self._torque, self._project = acceleration, torque, project
        self._integrator = INTEGRATORS["rk4"](configuration_space(model))
        self._nv, self._none = int(model.nv), np.zeros(model.nv)
        self._errors = np.geterr()  # the caller's, in which the caller's torque runs

    def run(self, start: ChainState, rank: int | None, time: Array) -> Trajectory:
        """Return the motion from a state at the given times.

        Args:
            start: the state at the first time.
            rank: of the closures there; unknown when None.
            time: s, shape (n,).

        Raises:
            IntegrationError: a step left the range of finite, closed motion; with the motion up to then.
        """
        motion = Trajectory(time, np.empty((len(time), len(start.q))), np.empty((len(time), len(start.v))))
        motion.q[0], motion.v[0] = q, v = start
        for k in range(len(time) - 1):
            t, h = float(time[k]), float(time[k + 1] - time[k])
            try:
                with np.errstate(over="raise", invalid="raise"):
                    q, v, rank = self._step(t, h, q, v, rank)
            except (OpenClosureError, MassMatrixError, FloatingPointError, np.linalg.LinAlgError) as error:
                raise IntegrationError(
                    t, h, str(error), Trajectory(*(part[: k + 1] for part in motion))
                ) from error
            motion.q[k + 1], motion.v[k + 1] = q, v
        return motion

    def _step(
        self, t: float, h: float, q: Array, v: Array, rank: int | None
    ) -> tuple[Array, Array, int | None]:
        nodes = iter(RUNGE_KUTTA_NODES)

        def rate(q: Array, v: Array) -> tuple[Array, Array]:
            return self._acceleration(q, v, self._force(t + next(nodes) * h, q, v), rank), _NO_POWERS

        moved = self._integrator.step(rate, q, v, h)
        if not np.isfinite(moved.v).all():
            raise FloatingPointError("the velocity is no longer finite")
        return (moved.q, moved.v, rank) if self._project is None else self._project(moved.q, moved.v, rank)

    def _force(self, t: float, q: Array, v: Array) -> Array:
        if self._torque is None:
            return self._none
        with np.errstate(**self._errors):
            return as_array("torque(t, q, v)", self._torque(t, q.copy(), v.copy()), self._nv)


def time_grid(duration: float, step: float) -> Array:
    """Return the times 0, step, 2 step, ... and duration itself; the last step is shorter where step does not divide duration.

    Raises:
        ShapeError, OutOfRangeError: duration or step is not a finite number greater than
            zero.
    """
    for name, value in (("duration", duration), ("step", step)):
        if not float(as_array(name, value)) > 0.0:
            raise OutOfRangeError(name, float(value))
    whole = int(np.ceil(duration / step * (1.0 - _ROUNDING)))
    return np.append(step * np.arange(whole), duration)
