"""The spaces that configurations live in: plain vectors, or a product of Lie groups."""

from __future__ import annotations

from abc import ABC, abstractmethod

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
