"""Motion of a closed chain: state, energy and trajectory, by Runge-Kutta steps with projection."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_array, as_positive
from coop_pin.base.errors import ArgumentError, IntegrationError, MassMatrixError, OpenClosureError
from coop_pin.base.memory import require_memory
from coop_pin.chain.integrators import INTEGRATORS
from coop_pin.chain.kkt_solver import KKTSolver
from coop_pin.chain.projection import STEP_ALLOWED, Projection
from coop_pin.chain.proximal_solver import ProximalSolver

TorqueLaw = Callable[[float, Array, Array], ArrayLike]
"""(t, q, v) -> generalised force tau, N m and N, shape (nv,)."""


_ROUNDING = 1e-9
_NO_POWERS = np.zeros(0)


class ChainState(NamedTuple):
    """State of a closed chain: configuration and velocity.

    Attributes:
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
    """

    q: Array
    v: Array


class Trajectory(NamedTuple):
    """Motion sampled at every integration step.

    Attributes:
        time: s, shape (n,).
        q: configurations, shape (n, nq).
        v: velocities, shape (n, nv).
    """

    time: Array
    q: Array
    v: Array


class Energy(NamedTuple):
    """Mechanical energy, J.

    Attributes:
        kinetic: J.
        potential: J.
    """

    kinetic: float
    potential: float

    @property
    def total(self) -> float:
        """Kinetic plus potential energy, J."""
        return self.kinetic + self.potential


class Propagator:
    """Integration of a closed chain by Runge-Kutta 4, with projection onto the closures after every step.

    The KKT solver keeps the rank that the closures have at the beginning of a step for the whole step: the
    stages lie slightly off the closures, and there the redundant rows of an over-constrained loop look
    independent and would lock the mechanism.
    """

    def __init__(
        self,
        model: pin.Model,
        solver: ProximalSolver | KKTSolver,
        torque: TorqueLaw | None,
        projection: Projection | None,
    ) -> None:
        """Prepare the integration.

        Args:
            model: the tree.
            solver: solver of the constrained dynamics.
            torque: the generalised force; zero when None.
            projection: Projection onto the closures after every step; none when None.

        Raises:
            ArgumentError: torque is not callable.
        """
        if torque is not None and not callable(torque):
            raise ArgumentError(f"torque is {torque!r}; it must be a function of (t, q, v), or None")
        self._solver, self._torque, self._projection = solver, torque, projection
        self._integrator = INTEGRATORS["rk4"](model)
        self._nv, self._zero = int(model.nv), np.zeros(model.nv)
        self._caller_errstate = np.geterr()  # torque is user code and runs under the caller's settings

    def run(self, start: ChainState, rank: int | None, time: Array) -> Trajectory:
        """Return the motion from a state at the given times.

        Args:
            start: the state at the first time.
            rank: rank of the closures there; None if unknown.
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
                motion = Trajectory(*(part[: k + 1] for part in motion))
                raise IntegrationError(t, h, str(error), motion) from error
            motion.q[k + 1], motion.v[k + 1] = q, v
        return motion

    def _step(
        self, t: float, h: float, q: Array, v: Array, rank: int | None
    ) -> tuple[Array, Array, int | None]:
        acceleration = self._solver.acceleration
        if isinstance(self._solver, KKTSolver):
            acceleration = partial(self._solver.acceleration, max_rank=rank)

        def rate(t: float, q: Array, v: Array) -> tuple[Array, Array]:
            return acceleration(q, v, self._force(t, q, v)), _NO_POWERS

        moved = self._integrator.step(rate, t, q, v, h)
        if not np.isfinite(moved.v).all():
            raise FloatingPointError("the velocity is no longer finite")
        if self._projection is None:
            return moved.q, moved.v, rank
        return self._projection.state(moved.q, moved.v, STEP_ALLOWED, rank)

    def _force(self, t: float, q: Array, v: Array) -> Array:
        if self._torque is None:
            return self._zero
        with np.errstate(**self._caller_errstate):
            return as_array("torque(t, q, v)", self._torque(t, q.copy(), v.copy()), self._nv)


def time_grid(duration: float, step: float, bytes_per_time: int) -> Array:
    """Return the times 0, step, 2 step, ... and duration; the last step may be shorter.

    Args:
        duration: s.
        step: s.
        bytes_per_time: storage for each time, bytes.

    Raises:
        NotEnoughMemoryError: what is stored does not fit.
        ShapeError, OutOfRangeError: duration or step is not a finite number greater than
            zero.
    """
    duration, step = as_positive("duration", duration), as_positive("step", step)
    steps = duration / step * (1.0 - _ROUNDING)
    needed = (steps + 1.0) * (8 + bytes_per_time)
    require_memory(f"{steps:.3g} steps", needed, "lengthen step or shorten duration")
    return np.append(step * np.arange(int(np.ceil(steps))), duration)
