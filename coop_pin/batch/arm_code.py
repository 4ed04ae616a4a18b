"""Kinematics and dynamics of one serial arm as scalar code, with the numbers of its Pinocchio model.

All spatial vectors are linear first, in world axes, about the origin of the world (Featherstone 2008, with
the parts swapped): a joint's motion subspace is S = [p x z, z] for a revolute joint about z through p, and
[z, 0] for a prismatic one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coop_pin.batch.tape import Number
from coop_pin.batch.traced_array import traced
from coop_pin.errors import TracingError

Numbers: TypeAlias = NDArray[Any]
"""Array of traced scalars and constants."""

_ROUNDING = 1e-15
"""Entries of rotation matrices that are closer to -1, 0 or 1 are those; pi in a scenario is farther off."""

_AXES = {
    "X": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "Y": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "Z": np.eye(3),
}
"""Rotations whose third column is the axis."""


# ---------------------------------------------------------------- spatial algebra


def cross(a: Numbers, b: Numbers) -> Numbers:
    """Return a x b, shape (3,)."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]], dtype=object
    )


def join(linear: Numbers, angular: Numbers) -> Numbers:
    """Return a six-vector, linear first."""
    return np.array([*linear, *angular], dtype=object)


def motion_cross(V: Numbers, U: Numbers) -> Numbers:
    """Return V x U = [w x u + v x u_w, w x u_w], the rate of a motion U that moves with V."""
    return join(cross(V[3:], U[:3]) + cross(V[:3], U[3:]), cross(V[3:], U[3:]))


def force_cross(V: Numbers, F: Numbers) -> Numbers:
    """Return V x* F = [w x f, v x f + w x n], the rate of a force F that moves with V."""
    return join(cross(V[3:], F[:3]), cross(V[:3], F[:3]) + cross(V[3:], F[3:]))


class RigidInertia(NamedTuple):
    """Inertia of a rigid body about an origin O.

    Attributes:
        mass: m, kg.
        moment: h = m c with the centre of mass c, kg m, shape (3,).
        second: I_c + m (c . c - c c^T), kg m^2, shape (3, 3), symmetric.
    """

    mass: Number
    moment: Numbers
    second: Numbers

    @classmethod
    def from_model(cls, inertia: pin.Inertia) -> RigidInertia:
        """Return an inertia of Pinocchio."""
        c = inertia.lever
        second = inertia.inertia + inertia.mass * (c @ c * np.eye(3) - np.outer(c, c))
        return cls(float(inertia.mass), inertia.mass * c, second)

    def moved(self, R: Numbers, p: Numbers) -> RigidInertia:
        """Return the inertia about the origin in which O stands at (R, p).

        With r = R h: h' = m p + r, second' = R second R^T + (p . h' + p . r) 1 - p h'^T - r p^T.
        """
        r, R_second = R @ self.moment, R @ self.second
        h = self.mass * p + r
        trace, second = p @ h + p @ r, np.empty((3, 3), dtype=object)
        for i in range(3):
            for j in range(i + 1):
                own = R_second[i] @ R[j] - p[i] * h[j] - r[i] * p[j]
                second[i, j] = second[j, i] = own + trace if i == j else own
        return RigidInertia(self.mass, h, second)

    def plus(self, other: RigidInertia) -> RigidInertia:
        """Return the inertia of two bodies together."""
        return RigidInertia(self.mass + other.mass, self.moment + other.moment, self.second + other.second)

    def times(self, V: Numbers) -> Numbers:
        """Return I V = [m v - h x w, h x v + second w]."""
        v, w = V[:3], V[3:]
        return join(self.mass * v - cross(self.moment, w), cross(self.moment, v) + self.second @ w)


# ---------------------------------------------------------------- kinematics


class Body(NamedTuple):
    """Body of an arm with the joint that carries it; the joint moves about or along the body's z axis.

    Attributes:
        R: orientation of the joint in the body before, shape (3, 3).
        p: its position there, m, shape (3,).
        inertia: about its own origin.
    """

    R: Numbers
    p: Numbers
    inertia: RigidInertia


class SerialArm(NamedTuple):
    """Serial arm that holds a payload frame P.

    Attributes:
        bodies: from base to tip.
        is_revolute: kind of each joint.
        R_JP: orientation of P in the last body, shape (3, 3).
        p_JP: its position there, m, shape (3,).
    """

    bodies: tuple[Body, ...]
    is_revolute: tuple[bool, ...]
    R_JP: Numbers
    p_JP: Numbers

    @classmethod
    def from_model(
        cls, model: pin.Model, joints: Sequence[int], X_JP: pin.SE3, last: pin.Inertia
    ) -> SerialArm:
        """Return the arm of some joints of a Pinocchio model.

        Args:
            model: the tree.
            joints: from base to tip.
            X_JP: pose of P in the last joint's frame.
            last: inertia that the last joint carries.

        Raises:
            TracingError: the joints are no serial chain, or one of them has more than one degree of freedom.
        """
        bodies, kinds, turned, parent = [], [], pin.SE3.Identity(), 0
        for joint in joints:
            kind, parent_of_joint = str(model.joints[joint].shortname()), int(model.parents[joint])
            if parent_of_joint != parent or model.nvs[joint] != 1:
                raise TracingError(
                    f"has joint {model.names[joint]!r} ({kind}), which is no part of a serial chain"
                )
            align = pin.SE3(_aligned(model.joints[joint], kind), np.zeros(3))
            X = turned.actInv(model.jointPlacements[joint]) * align
            inertia = align.actInv(last if joint == joints[-1] else model.inertias[joint])
            bodies.append(Body(_snapped(X.rotation), X.translation.copy(), RigidInertia.from_model(inertia)))
            kinds.append(kind.startswith("JointModelR"))
            turned, parent = align, joint
        X = turned.actInv(X_JP)
        return cls(tuple(bodies), tuple(kinds), _snapped(X.rotation), X.translation.copy())


def _aligned(joint: Any, kind: str) -> NDArray[np.float64]:
    """Return a rotation whose third column is the axis of a joint."""
    if kind[-1] in _AXES and "Unaligned" not in kind:
        return _AXES[kind[-1]]
    axis = np.array(joint.extract().axis)
    return np.array(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix())


def _snapped(R: NDArray[np.float64]) -> NDArray[np.float64]:
    whole = np.round(R)
    return np.where(np.abs(R - whole) < _ROUNDING, whole, R) + 0.0


class Frames(NamedTuple):
    """Joints and payload frame of an arm in the world.

    Attributes:
        R: orientation of each body, shape (3, 3) each.
        p: position of each joint, shape (3,) each.
        S: motion subspaces, shape (6, n).
        R_WP: orientation of P, shape (3, 3).
        p_WP: position of P, shape (3,).
    """

    R: list[Numbers]
    p: list[Numbers]
    S: Numbers
    R_WP: Numbers
    p_WP: Numbers


def frames(arm: SerialArm, q: Numbers) -> Frames:
    """Return the frames of an arm at joint positions, shape (n,)."""
    R, p = np.eye(3).astype(object), np.zeros(3).astype(object)
    rotations, positions, S = [], [], np.empty((6, len(q)), dtype=object)
    cosine, sine = np.cos(traced(q)), np.sin(traced(q))
    for k, (body, is_revolute) in enumerate(zip(arm.bodies, arm.is_revolute, strict=True)):
        p = p + R @ body.p
        R = R @ body.R
        z = R[:, 2]
        if is_revolute:
            c, s = cosine[k], sine[k]
            R = np.stack([c * R[:, 0] + s * R[:, 1], c * R[:, 1] - s * R[:, 0], z], axis=1)
            S[:, k] = join(cross(p, z), z)
        else:
            p = p + q[k] * z
            S[:, k] = join(z, np.zeros(3))
        rotations.append(R)
        positions.append(p)
    return Frames(rotations, positions, S, R @ arm.R_JP, p + R @ arm.p_JP)


def payload_jacobian(S: Numbers, p_WP: Numbers) -> Numbers:
    """Return J_WP: the columns [v + w x p, w] of motion subspaces S = [v, w], about P, shape (6, n)."""
    return np.stack([join(column[:3] + cross(column[3:], p_WP), column[3:]) for column in S.T], axis=1)


# ---------------------------------------------------------------- dynamics


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
