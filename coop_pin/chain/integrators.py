"""One step of the equations of motion, with the work of the applied forces integrated along."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.chain.configuration_space import ConfigurationSpace

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

    def __init__(self, space: ConfigurationSpace) -> None:
        self.space = space

    @abstractmethod
    def step(self, rate: Rate, q: Array, v: Array, h: float) -> Step:
        """Return the state after h seconds."""


_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0


class RungeKutta4(Integrator):
    """The classical fourth-order Runge-Kutta method, Munthe-Kaas form."""

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
            space.step(q, weights @ np.array((v, k2, k3, k4))),
            v + weights @ np.array((a1, a2, a3, a4)),
            weights @ np.array((p1, p2, p3, p4)),
        )


class SemiImplicitEuler(Integrator):
    """v' = v + h a(q, v), then q' = q + h v'; first order."""

    def step(self, rate: Rate, q: Array, v: Array, h: float) -> Step:
        """Return the state after h seconds."""
        a, powers = rate(q, v)
        v_next = v + h * a
        return Step(self.space.step(q, h * v_next), v_next, h * powers)


INTEGRATORS: dict[str, type[Integrator]] = {"rk4": RungeKutta4, "semi-implicit-euler": SemiImplicitEuler}
