"""Time integration of the equations of motion: Runge-Kutta methods as tableaus, and semi-implicit Euler.

An integrator advances (q, v) for a given rate function of (t, q, v), and integrates the work of the applied
forces with the same weights.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array

_FREE_FLYER = "JointModelFreeFlyer"
_SMALL = 2.7e-5
"""Largest square of a free-flyer's increment for the series of dexp^-1, which is right to 1e-12 there."""


class ConfigurationSpace(ABC):
    """Configuration space with increments u, shape (nv,): q(t) = q_0 (+) u(t)."""

    @abstractmethod
    def step(self, q: Array, u: Array) -> Array:
        """Return q (+) u, shape (nq,)."""

    @abstractmethod
    def increment_rate(self, q: Array, u: Array, v: Array) -> Array:
        """Return u' such that q (+) u(t) moves with velocity v, shape (nv,)."""


class VectorSpace(ConfigurationSpace):
    """Vector space, nq = nv: angles and lengths."""

    def step(self, q: Array, u: Array) -> Array:
        """Return q + u."""
        return q + u

    def increment_rate(self, q: Array, u: Array, v: Array) -> Array:
        """Return v."""
        return v


class LieGroup(ConfigurationSpace):
    """Lie group of configurations with a free-flyer or continuous joints.

    Without dexp^-1, Runge-Kutta methods would be of second order on a free-flyer (Munthe-Kaas).
    """

    def __init__(self, model: pin.Model) -> None:
        self._model = model
        sizes = [(str(joint.shortname()), int(joint.idx_v), int(joint.nv)) for joint in model.joints]
        free = [slice(first, first + 6) for name, first, _ in sizes if name == _FREE_FLYER]
        turning = [name for name, _, nv in sizes if nv > 1 and name != _FREE_FLYER]
        self._free, self._is_series = free, not turning

    def step(self, q: Array, u: Array) -> Array:
        """Return pin.integrate(q, u)."""
        return pin.integrate(self._model, q, u)

    def increment_rate(self, q: Array, u: Array, v: Array) -> Array:
        """Return dexp_u^-1 v: v = J_r(u) u' with J_r the derivative of pin.integrate by its increment.

        Of joints with one degree of freedom it is v. Of free-flyers it is v + A v / 2 + A^2 v / 12 with
        A = ad_u, and a remainder of at most |u|^4 |v| / 720: small increments, at which Pinocchio's
        derivative is off by 1e-8.
        """
        rate = v.copy()
        for entries in self._free:
            w = u[entries]
            if w.dot(w) > _SMALL:
                break
            rate[entries] = _increment_rate(w.tolist(), v[entries].tolist())
        else:
            if self._is_series:
                return rate
        return np.linalg.solve(pin.dIntegrate(self._model, q, u, pin.ARG1), v)


def _increment_rate(u: Sequence[float], v: Sequence[float]) -> tuple[float, ...]:
    """Return v + A v / 2 + A^2 v / 12 with A = ad_u; for six numbers arrays would take twice as long."""
    (a, b, c, x, y, z), (d, e, f, p, q, r) = u, v
    A, B, C = y * f - z * e + b * r - c * q, z * d - x * f + c * p - a * r, x * e - y * d + a * q - b * p
    P, Q, R = y * r - z * q, z * p - x * r, x * q - y * p
    return (
        d + 0.5 * A + (y * C - z * B + b * R - c * Q) / 12.0,
        e + 0.5 * B + (z * A - x * C + c * P - a * R) / 12.0,
        f + 0.5 * C + (x * B - y * A + a * Q - b * P) / 12.0,
        p + 0.5 * P + (y * R - z * Q) / 12.0,
        q + 0.5 * Q + (z * P - x * R) / 12.0,
        r + 0.5 * R + (x * Q - y * P) / 12.0,
    )


def configuration_space(model: pin.Model) -> ConfigurationSpace:
    """Return the configuration space of a model."""
    return VectorSpace() if model.nq == model.nv else LieGroup(model)


Rate = Callable[[float, Array, Array], tuple[Array, Array]]
"""(t, q, v) -> (acceleration, shape (nv,); powers of the force channels, W, shape (channels,))."""


class Step(NamedTuple):
    """State after an integration step.

    Attributes:
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        work: done by each force channel over the step, J, shape (channels,).
    """

    q: Array
    v: Array
    work: Array


class Tableau(NamedTuple):
    """Butcher tableau of an explicit Runge-Kutta method with s stages.

    Attributes:
        A: coefficients of the stages, strictly lower triangular, shape (s, s).
        b: weights, shape (s,).
        c: nodes, as parts of a step; c[0] = 0, shape (s,).
    """

    A: Array
    b: Array
    c: tuple[float, ...]


RK4 = Tableau(
    A=np.array([[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
    b=np.array([1.0, 2.0, 2.0, 1.0]) / 6.0,
    c=(0.0, 0.5, 0.5, 1.0),
)
"""The classical fourth-order Runge-Kutta method."""


class Integrator(ABC):
    """Integration method: advances (q, v) by a step of h seconds."""

    @abstractmethod
    def step(self, rate: Rate, t: float, q: Array, v: Array, h: float) -> Step:
        """Return the state at t + h."""


class RungeKutta(Integrator):
    """Explicit Runge-Kutta method on a Lie group (Munthe-Kaas): the increments u from q are integrated."""

    def __init__(self, space: ConfigurationSpace, tableau: Tableau = RK4) -> None:
        self.space, self.tableau = space, tableau
        self._A, self._h = np.vstack((tableau.A[1:], tableau.b)), math.nan
        self._hA = np.zeros_like(self._A)  # of the last step's length
        self._stages = [(c, row[: i + 1]) for i, (c, row) in enumerate(zip(tableau.c, self._hA, strict=True))]

    def step(self, rate: Rate, t: float, q: Array, v: Array, h: float) -> Step:
        """Return the state at t + h."""
        if h != self._h:
            self._h = h
            np.multiply(self._A, h, self._hA)
        n, space, powers = len(v), self.space, []
        rates, k, q_i, v_i = np.empty((len(self._stages), 2 * n)), v, q, v
        for i, (c, row) in enumerate(self._stages):
            stage = rates[i]
            stage[:n] = k
            stage[n:], power = rate(t + c * h, q_i, v_i)
            powers.append(power)
            change = row.dot(rates[: i + 1])
            u, v_i = change[:n], v + change[n:]
            q_i = space.step(q, u)
            if i + 1 < len(rates):
                k = space.increment_rate(q, u, v_i)
        return Step(q_i, v_i, self._hA[-1].dot(np.array(powers)))


class VectorRungeKutta(Integrator):
    """Explicit Runge-Kutta method on a vector space, q' = v: fewer array operations than RungeKutta.

    With the weights b as the last row of A, the stages and the end of the step are

        v_i = v + h sum_j A_ij a_j
        q_i = q + h sum_j A_ij v_j = q + h sum_j A_ij v + h^2 sum_j (A A)_ij a_j

    so that (q_i, v_i) = C_i(h) [q, v, a_1, ..., a_s]: one small product.
    """

    def __init__(self, tableau: Tableau = RK4) -> None:
        self.tableau = tableau
        stages = len(tableau.b)
        A = np.vstack((tableau.A, tableau.b))
        C = np.zeros(
            (3, stages, 2, stages + 2)
        )  # polynomials in h of the stages after the first, and of the end
        C[0, :, 0, 0] = C[0, :, 1, 1] = 1.0
        C[1, :, 0, 1] = A[1:].sum(axis=1)
        C[1, :, 1, 2:] = A[1:]
        C[2, :, 0, 2:] = A[1:] @ A[:stages]
        self._shape, self._polynomials = C.shape[1:], C.reshape(3, -1)
        self._h, self._weights = math.nan, np.empty(0)  # of the last step's length
        self._stages = list[tuple[float, Array]]()  # c_i h and C_i(h)

    def step(self, rate: Rate, t: float, q: Array, v: Array, h: float) -> Step:
        """Return the state at t + h."""
        if h != self._h:
            C = np.array((1.0, h, h * h)).dot(self._polynomials).reshape(self._shape)
            self._stages = [(c * h, C_i) for c, C_i in zip(self.tableau.c, C, strict=True)]
            self._h, self._weights = h, h * self.tableau.b
        known = np.zeros((self._shape[2], len(q)))
        known[0], known[1] = q, v
        stage, powers = known, []
        for i, (delay, C_i) in enumerate(self._stages, start=2):
            known[i], power = rate(t + delay, stage[0], stage[1])
            stage = C_i.dot(known)
            powers.append(power)
        return Step(stage[0], stage[1], self._weights.dot(np.array(powers)))


def _runge_kutta(model: pin.Model) -> Integrator:
    """Return the classical Runge-Kutta method on the configuration space of a model."""
    space = configuration_space(model)
    return VectorRungeKutta() if isinstance(space, VectorSpace) else RungeKutta(space)


class SemiImplicitEuler(Integrator):
    """Semi-implicit Euler method: v' = v + h a(t, q, v), then q' = q (+) h v'; first order."""

    def __init__(self, space: ConfigurationSpace) -> None:
        self.space = space

    def step(self, rate: Rate, t: float, q: Array, v: Array, h: float) -> Step:
        """Return the state at t + h."""
        a, powers = rate(t, q, v)
        v_next = v + h * a
        return Step(self.space.step(q, h * v_next), v_next, h * powers)


INTEGRATORS: dict[str, Callable[[pin.Model], Integrator]] = {
    "rk4": _runge_kutta,
    "semi-implicit-euler": lambda model: SemiImplicitEuler(configuration_space(model)),
}
"""Constructors of the integrators of a model, by their names in scenarios."""
