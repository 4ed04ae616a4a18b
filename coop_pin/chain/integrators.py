"""Time integration of the equations of motion: Runge-Kutta methods as tableaus, and semi-implicit Euler.

An integrator advances (q, v) for a given rate function of (t, q, v), and integrates the work of the applied
forces with the same weights.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.disk_cache import DiskCache
from coop_pin.chain.free_flyer import displaced, increment_rate
from coop_pin.tracing.kernel import Kernel, Layout, Program
from coop_pin.tracing.llvm_machine import LlvmMachine

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
            A, moved = pin.Motion(w).action, rate[entries]
            first = A.dot(moved)
            moved += A.dot(first) / 12.0 + 0.5 * first
        else:
            if self._is_series:
                return rate
        return np.linalg.solve(pin.dIntegrate(self._model, q, u, pin.ARG1), v)


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
        self._h, self._rows = math.nan, list[Array]()  # h A and h b, of the last step's length

    def step(self, rate: Rate, t: float, q: Array, v: Array, h: float) -> Step:
        """Return the state at t + h."""
        if h != self._h:
            self._h, self._rows = h, [h * row[:i] for i, row in enumerate((*self.tableau.A, self.tableau.b))]
        n, space = len(v), self.space
        rates, powers = np.empty((len(self.tableau.b), 2 * n)), []
        u, q_i, v_i = np.zeros(n), q, v
        for i, c in enumerate(self.tableau.c):
            rates[i, :n] = space.increment_rate(q, u, v_i) if i else v
            rates[i, n:], power = rate(t + c * h, q_i, v_i)
            powers.append(power)
            change = self._rows[i + 1].dot(rates[: i + 1])
            u, v_i = change[:n], v + change[n:]
            q_i = space.step(q, u)
        return Step(q_i, v_i, self._rows[-1].dot(np.array(powers)))


class VectorRungeKutta(Integrator):
    """Explicit Runge-Kutta method on a vector space, q' = v: a quarter of the array operations of RungeKutta.

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


class FreeFlyerRungeKutta(Integrator):
    """RungeKutta of joints in a vector space and a free-flyer after them, as compiled code between the rates.

    With the weights b as the last row of A, stage i begins at

        u_i = h sum_j A_ij k_j,  q_i = q (+) u_i,  v_i = v + h sum_j A_ij a_j,  k_i = dexp_{u_i}^-1 v_i
    """

    def __init__(self, joints: int, tableau: Tableau = RK4) -> None:
        """Compile the stages, once in a process.

        Args:
            joints: number of joints before the free-flyer.
            tableau: the method; its coefficients fold into the code.
        """
        self.tableau = tableau
        lanes, machine = _free_flyer_stages(joints, tuple(map(tuple, tableau.A)), tuple(tableau.b))
        block, self._h = np.zeros(lanes.size), np.zeros((1, 1))
        self._calls = machine.single(block, self._h)
        at = lanes.views(block)
        self._q_i, self._v_i, self._weights = at["q_i"], at["v_i"], np.empty(0)
        copied: list[Any] = [at[name].data for name in ("q", "v", *(f"a_{i}" for i in range(len(tableau.b))))]
        self._q, self._v, *self._a = copied  # memory, which is written sooner than an array
        self._powers, self._rows = np.empty(0), list[Any]()  # of the stages; the first rate sizes them

    def step(self, rate: Rate, t: float, q: Array, v: Array, h: float) -> Step:
        """Return the state at t + h."""
        if h != self._h[0, 0]:
            self._h[0], self._weights = h, h * self.tableau.b
        self._q[:], self._v[:] = q, v
        q_i, v_i = q, v
        for i, c in enumerate(self.tableau.c):
            self._a[i][:], power = rate(t + c * h, q_i, v_i)
            if not self._rows:
                self._powers = np.empty((len(self._a), len(power)))
                self._rows = [row.data for row in self._powers]
            self._rows[i][:] = power
            self._calls[i]()
            q_i, v_i = self._q_i, self._v_i
        return Step(q_i.copy(), v_i.copy(), self._weights.dot(self._powers))


@cache
def _free_flyer_stages(joints: int, A: Any, b: Any) -> tuple[Layout, LlvmMachine]:
    """Return the slots of a step and the code of its stages after the first, the last of which ends it."""
    lanes, uniforms, kernels = Layout(), Layout(), list[Kernel]()
    nv, rows = joints + 6, [*A[1:], b]
    lanes.add(q=(nv + 1,), v=(nv,), q_i=(nv + 1,), v_i=(nv,))
    for i in range(len(rows)):
        lanes.add(**{f"a_{i}": (nv,), f"k_{i + 1}": (nv,)})
    uniforms.add(h=())
    for i, row in enumerate(rows):
        kernel = Kernel(f"stage_{i + 1}", lanes, uniforms)
        q, v, h = kernel.read("q"), kernel.read("v"), kernel.uniform("h")
        u, change = np.zeros(nv), np.zeros(nv)
        for j, factor in enumerate(row):
            if factor:
                u = u + h * factor * kernel.read(f"k_{j}" if j else "v")
                change = change + h * factor * kernel.read(f"a_{j}")
        v_i, joint, free = v + change, slice(joints), slice(joints, None)
        kernel.write("q_i", np.concatenate((q[joint] + u[joint], displaced(q[free], u[free]))))
        kernel.write("v_i", v_i)
        kernel.write(f"k_{i + 1}", np.concatenate((v_i[joint], increment_rate(u[free], v_i[free]))))
        kernels.append(kernel)
    order = np.array([(i, 0) for i in range(len(rows))])
    return lanes, LlvmMachine(Program(kernels, lanes, 0, 0, order), 1, DiskCache())


def _runge_kutta(model: pin.Model) -> Integrator:
    """Return the classical Runge-Kutta method on the configuration space of a model."""
    space = configuration_space(model)
    if isinstance(space, VectorSpace):
        return VectorRungeKutta()
    is_last_free = str(model.joints[model.njoints - 1].shortname()) == _FREE_FLYER
    return (
        FreeFlyerRungeKutta(model.nv - 6) if is_last_free and model.nq == model.nv + 1 else RungeKutta(space)
    )


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
