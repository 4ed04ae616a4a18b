"""Linearisation of a closed chain about a state, in minimal coordinates; continuous and sampled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg

from coop_pin.base.arrays import Array, as_positive
from coop_pin.base.errors import ArgumentError
from coop_pin.chain.kkt_solver import KKTSolver
from coop_pin.chain.minimal_coordinates import MinimalForm
from coop_pin.chain.proximal_solver import ProximalSolver
from coop_pin.chain.trajectory import ChainState

_STEP = 1e-3
"""Step of the differences, rad, m and their rates; five points leave errors of its fourth power."""
_STENCIL = ((-2.0, 1.0 / 12.0), (-1.0, -2.0 / 3.0), (1.0, 2.0 / 3.0), (2.0, -1.0 / 12.0))
_NEWTON_STEPS, _AT_REST, _LONGEST_STEP = 60, 1e-10, 0.3
"""Most steps to an equilibrium, the step that is rounding and the longest step, rad or m."""


class Linearisation(NamedTuple):
    """Linear model ``x' = A x + B u, y = C x + D u`` of small deviations from a state.

    Attributes:
        A: shape (2 d, 2 d); x holds the deviations of the d independent joints (rad, m), then of their rates.
        B: shape (2 d, nv); u is the deviation of the generalised force, N m and N.
        C: shape (p, 2 d); y is said by the method that returns the model.
        joints: names of the independent joints, in the order of x.
        period: period of a sampled model ``x[k + 1] = A x[k] + B u[k]``, s; 0 for a continuous one.
    """

    A: Array
    B: Array
    C: Array
    joints: tuple[str, ...]
    period: float = 0.0

    def sampled(self, period: float) -> Linearisation:
        """Return the model sampled with u held over a period (zero-order hold), by the matrix exponential.

        exp([[A, B], [0, 0]] T) = [[A_T, B_T], [0, 1]]

        Args:
            period: T, s.

        Raises:
            OutOfRangeError: the period is not greater than zero.
        """
        n, T = len(self.A), as_positive("period", period)
        block = np.zeros((n + self.B.shape[1],) * 2)
        block[:n] = np.hstack((self.A, self.B))
        exponential = scipy.linalg.expm(T * block)[:n]
        return self._replace(A=exponential[:, :n], B=exponential[:, n:], period=T)


def linearised(
    form: MinimalForm,
    solver: ProximalSolver | KKTSolver,
    state: ChainState,
    tau: Array,
    joints: Sequence[str] | None,
    output: Callable[[Array, Array], Array],
) -> Linearisation:
    """Return the linear model about a state on the closures.

    With y the positions of the independent joints and nu = y', f(y, nu) = a[indices] at (q(y), N(q) nu)::

        A = [[0, 1], [df/dy, df/dnu]],    B = [0; M_r^-1 N^T],    C = d output / d(y, nu)

    Args:
        form: minimal coordinates.
        solver: solver of the constrained dynamics.
        state: q and v.
        tau: generalised force, shape (nv,).
        joints: independent joints; of the best condition when None.
        output: function of (q, v), shape (p,).

    Raises:
        ArgumentError: wheels roll.
    """
    form.require_positions()
    (q, v), coordinates = state, form.coordinates(state.q, joints)
    indices, d = coordinates.indices, len(coordinates.indices)
    names = form.joints(coordinates)

    def response(deviation: Array) -> Array:
        near = form.moved(q, coordinates, deviation[:d])
        velocity = form.coordinates(near, names).null_space @ (v[indices] + deviation[d:])
        a = solver.acceleration(near, velocity, tau)
        return np.concatenate((a[indices], output(near, velocity)))

    columns = [  # five-point central differences
        sum(weight * response(point * _STEP * unit) for point, weight in _STENCIL) / _STEP
        for unit in np.eye(2 * d)
    ]
    jacobian = np.array(columns).T
    N, mass_matrix = coordinates.null_space, form.dynamics(q, v, names).mass_matrix
    A = np.vstack((np.eye(d, 2 * d, d), jacobian[:d]))
    B = np.vstack((np.zeros((d, len(v))), np.linalg.solve(mass_matrix, N.T)))
    return Linearisation(A, B, jacobian[d:], names)


def equilibrium(
    form: MinimalForm,
    solver: ProximalSolver | KKTSolver,
    q: Array,
    tau: Array,
    joints: Sequence[str] | None,
) -> Array:
    """Return a configuration with a[indices] = 0 at rest, by Newton's method from q, shape (nq,).

    Raises:
        ArgumentError: the steps do not end.
    """
    still = np.zeros_like(tau)
    for _ in range(_NEWTON_STEPS):
        coordinates = form.coordinates(q, joints)
        d = len(coordinates.indices)
        slope = linearised(
            form, solver, ChainState(q, still), tau, form.joints(coordinates), lambda *_: np.zeros(0)
        ).A[d:, :d]
        a = solver.acceleration(q, still, tau)[coordinates.indices]
        step = np.asarray(np.linalg.lstsq(slope, -a, rcond=None)[0], dtype=np.float64)
        longest = float(np.abs(step).max(initial=0.0))
        if longest < _AT_REST:
            return q
        q = form.moved(q, coordinates, step * min(1.0, _LONGEST_STEP / longest))
    raise ArgumentError(
        f"no equilibrium was found: {float(np.abs(a).max()):.3g} rad/s^2 or m/s^2 remain; start nearer, or"
        " compare tau with inverse_dynamics at rest"
    )
