"""Dynamics of one serial arm as scalar code, for forces on the payload that it holds."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from coop_pin.batch.serial_arm import (
    Numbers,
    RigidInertia,
    SerialArm,
    cross,
    force_cross,
    frames,
    join,
    motion_cross,
)
from coop_pin.batch.tape import Number


class ArmInput(NamedTuple):
    """State of an arm, and what differs between arms of one model.

    Attributes:
        q: joint positions, shape (n,).
        v: joint rates, shape (n,).
        tau: joint torques, shape (n,).
        first: orientation and position of the first joint, its base: shape (3, 3) and (3,).
        last: inertia of the last body with all that is welded to it.
        held: orientation and position of P in the last body: shape (3, 3) and (3,).
    """

    q: Numbers
    v: Numbers
    tau: Numbers
    first: tuple[Numbers, Numbers]
    last: RigidInertia
    held: tuple[Numbers, Numbers]


class ArmTerms(NamedTuple):
    """Dynamics of one arm for the forces that act on its payload frame: M a + h = tau + S^T F.

    With M = L D L^T and the kept rows S_k of S::

        Y = L^-1 S_k^T,  u = L^-1 (tau - h),  G = Y^T D^-1 Y = S_k M^-1 S_k^T,  b = A_k + Y^T D^-1 u

    the acceleration of the last body is G F + b in the kept rows.

    Attributes:
        R_WP: orientation of P, shape (3, 3).
        p_WP: position of P, shape (3,).
        V: twist of the last body, shape (6,).
        A: its acceleration for a = 0, less gravity, shape (6,).
        S: motion subspaces, shape (6, n).
        L: unit lower triangle, shape (n, n).
        D_inverse: shape (n,).
        Y: shape (n, k).
        u: shape (n,).
        G: shape (k, k).
        b: shape (k,).
        kinetic: energy, J.
        potential: energy, J.
    """

    R_WP: Numbers
    p_WP: Numbers
    V: Numbers
    A: Numbers
    S: Numbers
    L: Numbers
    D_inverse: Numbers
    Y: Numbers
    u: Numbers
    G: Numbers
    b: Numbers
    kinetic: Number
    potential: Any

    def acceleration(self, F: Numbers) -> Numbers:
        """Return a = L^-T D^-1 (u + Y F) for a force F on the last body in the kept rows, shape (n,)."""
        return solve_transposed(self.L, self.D_inverse * (self.u + self.Y @ F))


class ArmModel(NamedTuple):
    """Constants of an arm's dynamics.

    Attributes:
        arm: its bodies; those numbers that ArmInput has are not read.
        gravity: m/s^2, shape (3,).
        rows: the kept rows of six-vectors, as text: the others are zero for every motion.
    """

    arm: SerialArm
    gravity: Numbers
    rows: str


def arm_terms(model: ArmModel, state: ArmInput) -> ArmTerms:
    """Return the dynamics of an arm by recursive Newton-Euler and composite rigid bodies, in the world."""
    first, *others = model.arm.bodies
    bodies = [first._replace(R=state.first[0], p=state.first[1]), *others]
    bodies[-1] = bodies[-1]._replace(inertia=state.last)
    seen = frames(SerialArm(tuple(bodies), model.arm.is_revolute, *state.held), state.q)
    n, S, rows = len(state.q), seen.S, [int(row) for row in model.rows]
    V: Numbers = np.zeros(6).astype(object)
    A = join(-model.gravity, np.zeros(3))
    inertias, forces = [], []
    for k, body in enumerate(bodies):
        Sv = S[:, k] * state.v[k]
        V = V + Sv
        A = A + motion_cross(V, Sv)
        inertias.append(body.inertia.moved(seen.R[k], seen.p[k]))
        forces.append(inertias[k].times(A) + force_cross(V, inertias[k].times(V)))
    M, h = np.empty((n, n), dtype=object), np.empty(n, dtype=object)
    for k in reversed(range(n)):
        if k + 1 < n:
            inertias[k], forces[k] = inertias[k].plus(inertias[k + 1]), forces[k] + forces[k + 1]
        U, h[k] = inertias[k].times(S[:, k]), S[:, k] @ forces[k]
        for j in range(k + 1):
            M[k, j] = M[j, k] = S[:, j] @ U
    L, D_inverse = factor(M)
    Y = np.stack([solve_lower(L, row) for row in S[rows]], axis=1)
    u, Z = solve_lower(L, state.tau - h), D_inverse[:, None] * Y
    return ArmTerms(
        R_WP=seen.R_WP,
        p_WP=seen.p_WP,
        V=V,
        A=A,
        S=S,
        L=L,
        D_inverse=D_inverse,
        Y=Y,
        u=u,
        G=_symmetric_product(Y, Z),
        b=A[rows] + Z.T @ u,
        kinetic=0.5 * (state.v @ (M @ state.v)),
        potential=-1.0 * (model.gravity @ inertias[0].moment),
    )


def gravity_torque(arm: SerialArm, gravity: Numbers, q: Numbers) -> Numbers:
    """Return g(q), which holds an arm without payload at rest, N m, shape (n,)."""
    seen, torque, force = frames(arm, q), np.empty(len(q), dtype=object), np.zeros(6).astype(object)
    for k in reversed(range(len(q))):
        mass, moment, _ = arm.bodies[k].inertia
        h = mass * seen.p[k] + seen.R[k] @ moment
        force = force - join(mass * gravity, cross(h, gravity))
        torque[k] = seen.S[:, k] @ force
    return torque


def factor(M: Numbers) -> tuple[Numbers, Numbers]:
    """Return L and D^-1 of M = L D L^T, for a symmetric positive definite matrix, shape (n, n) and (n,)."""
    n = len(M)
    L, D, D_inverse = np.eye(n).astype(object), np.empty(n, dtype=object), np.empty(n, dtype=object)
    for j in range(n):
        w = L[j, :j] * D[:j]
        D[j] = M[j, j] - L[j, :j] @ w
        D_inverse[j] = 1.0 / D[j]
        for i in range(j + 1, n):
            L[i, j] = (M[i, j] - L[i, :j] @ w) * D_inverse[j]
    return L, D_inverse


def solve_lower(L: Numbers, b: Numbers) -> Numbers:
    """Return L^-1 b for a unit lower triangle, shape (n,)."""
    x = np.empty(len(b), dtype=object)
    for i in range(len(b)):
        x[i] = b[i] - L[i, :i] @ x[:i]
    return x


def solve_transposed(L: Numbers, b: Numbers) -> Numbers:
    """Return L^-T b for a unit lower triangle, shape (n,)."""
    x = np.empty(len(b), dtype=object)
    for i in reversed(range(len(b))):
        x[i] = b[i] - L[i + 1 :, i] @ x[i + 1 :]
    return x


def _symmetric_product(Y: Numbers, Z: Numbers) -> Numbers:
    """Return Y^T Z, which is known to be symmetric."""
    size = Y.shape[1]
    product = np.empty((size, size), dtype=object)
    for i in range(size):
        for j in range(i + 1):
            product[i, j] = product[j, i] = Y[:, i] @ Z[:, j]
    return product
