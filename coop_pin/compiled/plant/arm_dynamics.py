"""Dynamics of one serial arm as scalar code, for forces on the payload that it holds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.compiled.plant.serial_arm import (
    Numbers,
    RigidInertia,
    SerialArm,
    cross,
    force_moved,
    frames,
    join,
    links,
)
from coop_pin.tracing.tape import Number
from coop_pin.tracing.traced_array import plain
from coop_pin.tracing.tree import SharedFunctions


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


class ArmResponse(NamedTuple):
    """Dynamics of one arm for the forces that act on its payload frame: M a + h = tau + S^T F.

    With M = L D L^T and the kept rows S_k of S::

        Y = L^-1 S_k^T,  u = L^-1 (tau - h),  G = Y^T D^-1 Y = S_k M^-1 S_k^T,  b = A_k + Y^T D^-1 u

    the acceleration of the last body is G F + b in the kept rows. Twists, accelerations, subspaces and forces
    are about the origin of the world, in world axes, linear before angular; k of their six rows are kept.

    Attributes:
        R_WP: Orientation of P, shape (3, 3).
        p_WP: Position of P, m, shape (3,).
        V: Twist of the last body, m/s and rad/s, shape (6,).
        A: Acceleration of the last body for a = 0, less gravity, m/s^2 and rad/s^2, shape (6,).
        S: Motion subspaces of the joints, shape (6, n).
        L: Unit lower triangle of the mass matrix, shape (n, n).
        D_inverse: Inverse diagonal of D, shape (n,).
        Y: L^-1 S_k^T, shape (n, k).
        u: L^-1 (tau - h), shape (n,).
        G: Mobility of the last body in the kept rows, shape (k, k).
        b: Acceleration of the last body in the kept rows without F, shape (k,).
        kinetic: Kinetic energy, J.
        moment: First moment about the world's origin, kg m, shape (3,).
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
    moment: Numbers

    def acceleration(self, F: Numbers) -> Numbers:
        """Return a = L^-T D^-1 (u + Y F) for a force F on the last body in the kept rows, shape (n,)."""
        return solve_transposed(self.L, self.D_inverse * (self.u + self.Y @ F))

    def acceleration_under(self, F: Numbers) -> Numbers:
        """Return a = L^-T D^-1 (u + L^-1 S^T F) for a force F in all rows, shape (n,)."""
        return solve_transposed(self.L, self.D_inverse * (self.u + solve_lower(self.L, self.S.T @ F)))


class ArmNumbers(NamedTuple):
    """Constants of an arm's dynamics.

    Attributes:
        arm: bodies of the arm; those numbers that ArmInput has are not read.
        gravity: m/s^2, shape (3,).
        rows: the kept rows of six-vectors, as text: the others are zero for every motion; none for arms
            without closures.
    """

    arm: SerialArm
    gravity: Numbers
    rows: str


def arm_terms(model: ArmNumbers, state: ArmInput) -> ArmResponse:
    """Return the dynamics of an arm by recursive Newton-Euler and composite rigid bodies, in body axes."""
    first, *others = model.arm.bodies
    bodies = [first._replace(R=state.first[0], p=state.first[1]), *others]
    bodies[-1] = bodies[-1]._replace(inertia=state.last)
    arm = SerialArm(tuple(bodies), model.arm.is_revolute, *state.held)
    kinematics, rows = frames(arm, state.q), [int(row) for row in model.rows]
    h, a, alpha = newton_euler(arm, model.gravity, state.q, state.v, np.zeros(len(state.q)))
    M, whole = mass_matrix(arm, state.q)
    V = kinematics.S @ state.v
    A = _spatial(V, kinematics.p, kinematics.R @ a, kinematics.R @ alpha)
    L, D_inverse = factor(M)
    Y = np.empty((len(L), len(rows)), dtype=object)
    for column, row in enumerate(rows):
        Y[:, column] = solve_lower(L, kinematics.S[row])
    u, Z = solve_lower(L, state.tau - h), D_inverse[:, None] * Y
    return ArmResponse(
        R_WP=kinematics.R_WP,
        p_WP=kinematics.p_WP,
        V=V,
        A=A,
        S=kinematics.S,
        L=L,
        D_inverse=D_inverse,
        Y=Y,
        u=u,
        G=_symmetric_product(Y, Z),
        b=A[rows] + Z.T @ u,
        kinetic=0.5 * (state.v @ (M @ state.v)),
        moment=whole.moved(*links(arm, state.q)[0]).moment,
    )


def shared_terms(
    functions: SharedFunctions, model: ArmNumbers, state: ArmInput, *, in_place: bool
) -> ArmResponse:
    """Return the terms of an arm: by a call of its model's code; in a plane, where it is short, in place."""
    if in_place:
        return arm_terms(model, state)
    blank, bodies = (np.zeros((3, 3)), np.zeros(3)), [*model.arm.bodies]
    bodies[0] = bodies[0]._replace(R=blank[0], p=blank[1])
    bodies[-1] = bodies[-1]._replace(inertia=RigidInertia(0.0, blank[1], blank[0]))
    shared = SerialArm(tuple(bodies), model.arm.is_revolute, *blank)
    return functions.call(state.v[0].tape, arm_terms, model._replace(arm=shared), state)


def newton_euler(
    arm: SerialArm, gravity: Numbers, q: Numbers, v: Numbers, vdot: Numbers
) -> tuple[Numbers, Numbers, Numbers]:
    """Return the torques M vdot + h of a motion, and what the last body does.

    Of each body, in its axes about its origin, the point r has the acceleration a + Omega r::

        Omega = alpha^x + w w^T - w . w 1,  f = m a + Omega h,  n = I alpha + w x I w + h x a

    Args:
        arm: Bodies of the arm.
        gravity: m/s^2, shape (3,).
        q: joint positions, shape (n,).
        v: joint rates, shape (n,).
        vdot: joint accelerations, shape (n,).

    Returns:
        M vdot + h, shape (n,), and of the last body's origin a, less gravity, and alpha, shape (3,) both.
    """
    placed, forces = links(arm, q), []
    w = alpha = np.zeros(3).astype(object)
    a, Omega = -plain(gravity), np.zeros((3, 3))
    joints = zip(arm.bodies, placed, arm.is_revolute, v, vdot, strict=True)
    for body, (R, p), is_revolute, rate, change in joints:
        a, w, alpha = R.T @ (a + Omega @ p), R.T @ w, R.T @ alpha
        Sv, Sa = (np.array([0.0, 0.0, x], dtype=object) for x in (rate, change))
        if is_revolute:
            w, alpha = w + Sv, alpha + cross(w, Sv) + Sa
        else:
            a = a + 2.0 * cross(w, Sv) + Sa
        Omega = _affine(w, alpha)
        mass, moment, second = body.inertia.mass, plain(body.inertia.moment), plain(body.inertia.second)
        f, n = mass * a + Omega @ moment, second @ alpha + cross(w, second @ w) + cross(moment, a)
        forces.append(join(f, n))
    tau, force = np.empty(len(q), dtype=object), np.zeros(6).astype(object)
    for k in reversed(range(len(q))):
        force = force + forces[k]
        tau[k] = force[_axis(arm, k)] + arm.bodies[k].armature * vdot[k]
        force = force_moved(*placed[k], force)
    return tau, a, alpha


def mass_matrix(arm: SerialArm, q: Numbers) -> tuple[Numbers, RigidInertia]:
    """Return M(q), shape (n, n), and the inertia of the arm as one body about the origin of its first."""
    n, placed = len(q), links(arm, q)
    M, inertia = np.empty((n, n), dtype=object), arm.bodies[-1].inertia
    for k in reversed(range(n)):
        if k + 1 < n:
            inertia = arm.bodies[k].inertia.plus(inertia.moved(*placed[k + 1]))
        force = inertia.times(np.eye(6).astype(object)[_axis(arm, k)])
        for j in reversed(range(k + 1)):
            M[k, j] = M[j, k] = force[_axis(arm, j)]
            force = force_moved(*placed[j], force)
        M[k, k] = M[k, k] + arm.bodies[k].armature
    return M, inertia


def _axis(arm: SerialArm, k: int) -> int:
    """Return the row of six-vectors in body axes along which, or about which, a joint moves."""
    return 5 if arm.is_revolute[k] else 2


def _affine(w: Numbers, alpha: Numbers) -> Numbers:
    """Return Omega = alpha^x + w w^T - w . w 1, shape (3, 3)."""
    (x, y, z), (a, b, c) = w, alpha
    return np.array(
        [
            [-(y * y + z * z), x * y - c, x * z + b],
            [x * y + c, -(x * x + z * z), y * z - a],
            [x * z - b, y * z + a, -(x * x + y * y)],
        ],
        dtype=object,
    )


def _spatial(V: Numbers, p: Numbers, a: Numbers, alpha: Numbers) -> Numbers:
    """Return the spatial acceleration about the world's origin of a body whose point p has acceleration a."""
    v, w = V[:3], V[3:]
    return join(a - cross(alpha, p) - cross(w, v + cross(w, p)), alpha)


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
