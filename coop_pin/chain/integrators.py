"""One step of the equations of motion, with the work of the applied forces integrated along."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array


class ConfigurationSpace(ABC):
    """How increments u move a configuration: q(t) = q_0 + u(t), in the sense of the space."""

    @abstractmethod
    def step(self, q: Array, u: Array) -> Array:
        """Return q moved by the increment u, shape (nq,)."""

    @abstractmethod
    def increment_rate(self, q: Array, u: Array, v: Array) -> Array:
        """Return u' such that q_0 + u(t) moves with velocity v, shape (nv,)."""


class VectorSpace(ConfigurationSpace):
    """nq = nv: angles and lengths."""

    def step(self, q: Array, u: Array) -> Array:
        """Return q + u."""
        return q + u

    def increment_rate(self, q: Array, u: Array, v: Array) -> Array:
        """Return v."""
        return v


class LieGroup(ConfigurationSpace):
    """Configurations with a floating body or continuous joints.

    Runge-Kutta stages that ignored dexp^-1 would be second order on a free-flyer (Munthe-Kaas).
    """

    def __init__(self, model: pin.Model) -> None:
        self._model = model

    def step(self, q: Array, u: Array) -> Array:
        """Return pin.integrate(q, u)."""
        moved: Array = pin.integrate(self._model, q, u)
        return moved

    def increment_rate(self, q: Array, u: Array, v: Array) -> Array:
        """Return dexp_u^-1 v: v = J_r(u) u' with J_r the derivative of integrate by its increment."""
        return np.linalg.solve(pin.dIntegrate(self._model, q, u, pin.ARG1), v)


def configuration_space(model: pin.Model) -> ConfigurationSpace:
    """Return the space of a model's configurations."""
    return VectorSpace() if model.nq == model.nv else LieGroup(model)


Rate = Callable[[Array, Array], tuple[Array, Array]]
"""(q, v) -> (acceleration, shape (nv,); powers of the force channels, W, shape (channels,))."""


class Step(NamedTuple):
    """The state after a step.

    Attributes:
        q: configuration.
        v: velocity.
        work: done by each force channel over the step, J, shape (channels,).
    """

    q: Array
    v: Array
    work: Array


class Integrator(ABC):
    """Advances (q, v) by a step of h seconds."""

    @abstractmethod
    def step(self, rate: Rate, q: Array, v: Array, h: float) -> Step:
        """Return the state after h seconds."""


_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0

RUNGE_KUTTA_NODES = (0.0, 0.5, 0.5, 1.0)
"""The parts of a step at which the Runge-Kutta methods ask for the rate, in this order."""


class RungeKutta4(Integrator):
    """The classical fourth-order Runge-Kutta method, Munthe-Kaas form."""

    def __init__(self, space: ConfigurationSpace) -> None:
        self.space = space

    def step(self, rate: Rate, q: Array, v: Array, h: float) -> Step:
        """Return the state after h seconds."""
        space, half = self.space, 0.5 * h
        a1, p1 = rate(q, v)
        u, v2 = half * v, v + half * a1
        k2 = space.increment_rate(q, u, v2)
        a2, p2 = rate(space.step(q, u), v2)
        u, v3 = half * k2, v + half * a2
        k3 = space.increment_rate(q, u, v3)
        a3, p3 = rate(space.step(q, u), v3)
        u, v4 = h * k3, v + h * a3
        k4 = space.increment_rate(q, u, v4)
        a4, p4 = rate(space.step(q, u), v4)
        weights = h * _WEIGHTS
        return Step(
            space.step(q, weights.dot(np.array((v, k2, k3, k4)))),
            v + weights.dot(np.array((a1, a2, a3, a4))),
            weights.dot(np.array((p1, p2, p3, p4))),
        )


def _stage_polynomials() -> Array:
    """Return C_2, C_3, C_4 and C_end of VectorRungeKutta4 as polynomials in h, flat, shape (3, 4 * 2 * 6)."""
    A = np.array([[0, 0, 0, 0], [1 / 2, 0, 0, 0], [0, 1 / 2, 0, 0], [0, 0, 1, 0], _WEIGHTS])
    C = np.zeros((3, 4, 2, 6))
    C[0, :, 0, 0] = C[0, :, 1, 1] = 1.0
    C[1, :, 0, 1] = A[1:].sum(axis=1)
    C[1, :, 1, 2:] = A[1:]
    C[2, :, 0, 2:] = A[1:] @ A[:4]
    return C.reshape(3, 48)


_STAGES = _stage_polynomials()


class VectorRungeKutta4(Integrator):
    """The same method for plain vectors, where q' = v, with a quarter of the array operations.

    With Butcher's tableau A (its weights as the last row), stages and end of the step combine what is known
    already::

        v_i = v + h sum_j A_ij a_j
        q_i = q + h sum_j A_ij v_j = q + h sum_j A_ij v + h^2 sum_j (A A)_ij a_j

    so that (q_i, v_i) = C_i(h) [q, v, a_1, ..., a_4]: one small product.
    """

    def step(self, rate: Rate, q: Array, v: Array, h: float) -> Step:
        """Return the state after h seconds."""
        C = np.array((1.0, h, h * h)).dot(_STAGES).reshape(4, 2, 6)
        known = np.zeros((6, len(q)))
        known[0], known[1] = q, v
        known[2], p1 = rate(q, v)
        second = C[0].dot(known)
        known[3], p2 = rate(second[0], second[1])
        third = C[1].dot(known)
        known[4], p3 = rate(third[0], third[1])
        fourth = C[2].dot(known)
        known[5], p4 = rate(fourth[0], fourth[1])
        end = C[3].dot(known)
        return Step(end[0], end[1], (h * _WEIGHTS).dot(np.array((p1, p2, p3, p4))))


class SemiImplicitEuler(Integrator):
    """v' = v + h a(q, v), then q' = q + h v'; first order."""

    def __init__(self, space: ConfigurationSpace) -> None:
        self.space = space

    def step(self, rate: Rate, q: Array, v: Array, h: float) -> Step:
        """Return the state after h seconds."""
        a, powers = rate(q, v)
        v_next = v + h * a
        return Step(self.space.step(q, h * v_next), v_next, h * powers)


def _runge_kutta_4(space: ConfigurationSpace) -> Integrator:
    return VectorRungeKutta4() if isinstance(space, VectorSpace) else RungeKutta4(space)


INTEGRATORS: dict[str, Callable[[ConfigurationSpace], Integrator]] = {
    "rk4": _runge_kutta_4,
    "semi-implicit-euler": SemiImplicitEuler,
}
