"""Kinematics and inertias of one serial arm as scalar code, with the numbers of its Pinocchio model.

All spatial vectors are linear first, and unless said otherwise in world axes about the origin of the world
(Featherstone 2008, with the parts swapped): a joint's motion subspace is S = [p x z, z] for a revolute joint
about z through p, and [z, 0] for a prismatic one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coop_pin.base.errors import TracingError
from coop_pin.tracing.tape import Number
from coop_pin.tracing.traced_array import plain, traced

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


def force_moved(R: Numbers, p: Numbers, F: Numbers) -> Numbers:
    """Return a force [f, n] of a frame that stands at (R, p), in the axes and about the origin there."""
    f = R @ F[:3]
    return join(f, cross(p, f) + R @ F[3:])


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
        R, p = plain(R), plain(p)  # products of constants in the order of traced ones, not in that of BLAS
        r, R_second = R @ plain(self.moment), R @ plain(self.second)
        h = self.mass * p + r
        trace, second = p @ h + p @ r, np.empty((3, 3), dtype=object)
        for i in range(3):
            for j in range(i + 1):
                entry = R_second[i] @ R[j] - p[i] * h[j] - r[i] * p[j]
                second[i, j] = second[j, i] = entry + trace if i == j else entry
        return RigidInertia(self.mass, h, second)

    def plus(self, other: RigidInertia) -> RigidInertia:
        """Return the inertia of two bodies together."""
        return RigidInertia(self.mass + other.mass, self.moment + other.moment, self.second + other.second)

    def times(self, V: Numbers) -> Numbers:
        """Return I V = [m v - h x w, h x v + second w]."""
        v, w = V[:3], V[3:]
        return join(self.mass * v - cross(self.moment, w), cross(self.moment, v) + self.second @ w)


# ---------------------------------------------------------------- kinematics


class Link(NamedTuple):
    """Link of an arm with the joint that carries it; the joint moves about or along the body's z axis.

    Attributes:
        R: orientation of the joint in the body before, shape (3, 3).
        p: position of the joint there, m, shape (3,).
        inertia: inertia of the body about its own origin.
        armature: inertia of the joint's rotor as the joint feels it, kg m^2 or kg.
    """

    R: Numbers
    p: Numbers
    inertia: RigidInertia
    armature: Number = 0.0


class SerialArm(NamedTuple):
    """Serial arm that holds a payload frame P.

    Attributes:
        bodies: links from base to tip.
        is_revolute: kind of each joint.
        R_JP: orientation of P in the last body, shape (3, 3).
        p_JP: position of P there, m, shape (3,).
    """

    bodies: tuple[Link, ...]
    is_revolute: tuple[bool, ...]
    R_JP: Numbers
    p_JP: Numbers

    @classmethod
    def from_model(
        cls, model: pin.Model, joints: Sequence[int], X_JP: pin.SE3, last: pin.Inertia
    ) -> SerialArm:
        """Return the arm of some joints of a Pinocchio model.

        Args:
            model: Tree of the arm.
            joints: Indices of its joints from base to tip.
            X_JP: pose of P in the last joint's frame.
            last: Inertia that the last joint carries.

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
            rotor, body = float(model.armature[model.idx_vs[joint]]), RigidInertia.from_model(inertia)
            bodies.append(Link(_snapped(X.rotation), X.translation.copy(), body, rotor))
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


class ArmFrames(NamedTuple):
    """Joints and payload frame of an arm in the world.

    Attributes:
        R: orientation of the last body, shape (3, 3).
        p: position of the last body, shape (3,).
        S: motion subspaces, shape (6, n).
        R_WP: orientation of P, shape (3, 3).
        p_WP: position of P, shape (3,).
    """

    R: Numbers
    p: Numbers
    S: Numbers
    R_WP: Numbers
    p_WP: Numbers


def links(arm: SerialArm, q: Numbers) -> list[tuple[Numbers, Numbers]]:
    """Return orientation and position of each body in the one before, at joint positions, shape (n,)."""
    placements, turns = [], zip(q, np.cos(traced(q)), np.sin(traced(q)), strict=True)
    for body, is_revolute, (q_k, c, s) in zip(arm.bodies, arm.is_revolute, turns, strict=True):
        R, p = plain(body.R), plain(body.p)
        if is_revolute:
            placements.append((R @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=object), p))
        else:
            placements.append((R, p + q_k * R[:, 2]))
    return placements


def frames(arm: SerialArm, q: Numbers) -> ArmFrames:
    """Return the frames of an arm at joint positions, shape (n,)."""
    R, p = np.eye(3).astype(object), np.zeros(3).astype(object)
    S = np.empty((6, len(q)), dtype=object)
    for k, (R_k, p_k) in enumerate(links(arm, q)):
        p, R = p + R @ p_k, R @ R_k
        z = R[:, 2]
        S[:, k] = join(cross(p, z), z) if arm.is_revolute[k] else join(z, np.zeros(3))
    return ArmFrames(R, p, S, R @ arm.R_JP, p + R @ arm.p_JP)


def payload_jacobian(S: Numbers, p_WP: Numbers) -> Numbers:
    """Return J_WP: the columns [v + w x p, w] of motion subspaces S = [v, w], about P, shape (6, n)."""
    return np.stack([join(column[:3] + cross(column[3:], p_WP), column[3:]) for column in S.T], axis=1)
