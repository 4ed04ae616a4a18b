"""Spring and damper between two frames: the law of compliant grasps and of partners.

It computes with floats and with traced numbers alike: the plants of all engines have it from here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import log3, shift_wrench
from coop_pin.description.events import Partner

_UPPER, _LOWER = [5, 6, 1], [7, 2, 3]
"""Entries (2, 3), (3, 1), (1, 2) of a flat matrix, and those of its transpose."""


class SpringDamper(NamedTuple):
    """Springs and dampers between frames G and E: the equations of CompliantGrasp, n of them at once.

    Attributes:
        stiffness: diagonals of K in axes of G, N/m and N m/rad, shape (n, 6).
        turning: diagonals of G = tr(K_r) / 2 - K_r, N m/rad, shape (n, 3).
        damping: diagonals of D in axes of G, N s/m and N m s/rad, shape (n, 6).
    """

    stiffness: Array
    turning: Array
    damping: Array

    @classmethod
    def of(cls, stiffness: Array, damping: Array) -> SpringDamper:
        """Return the springs and dampers of two diagonals, shape (n, 6) each."""
        k_r = stiffness[:, 3:]
        return cls(stiffness, 0.5 * k_r.sum(axis=1, keepdims=True) - k_r, damping)

    def elastic(self, p: Array, R: Array) -> Array:
        """Return the wrenches on E about its origin in axes of G without damping, N and N m, shape (n, 6).

        Args:
            p: Position of E in G, m, shape (n, 3).
            R: Orientation of E in G, shape (n, 3, 3).
        """
        S = (R * self.turning[:, None, :]).reshape(-1, 9)
        return np.concatenate((-self.stiffness[:, :3] * p, S[:, _UPPER] - S[:, _LOWER]), axis=1)

    def energy(self, p: Array, R: Array) -> Array:
        """Return the energies in the springs, J, shape (n,); arguments as of ``elastic``."""
        turned = self.turning * (1.0 - R.reshape(-1, 9)[:, ::4])
        return 0.5 * (self.stiffness[:, :3] * p * p).sum(axis=1) + turned.sum(axis=1)


class SpringState(NamedTuple):
    """Springs and dampers at a state, n of them or one without the first axis.

    Attributes:
        wrench: wrench on E about its origin in axes of G, N and N m, shape (n, 6).
        on_body: the same about the world's origin in world axes, shape (n, 6).
        position: position of E in G, m, shape (n, 3).
        rotation: orientation of E in G, shape (n, 3, 3).
        power: power of each damper, W; not positive, shape (n,).
    """

    wrench: Array
    on_body: Array
    position: Array
    rotation: Array
    power: Array

    @property
    def deflection(self) -> Array:
        """Position and rotation vector of E in G, m and rad, shape (n, 6)."""
        return np.concatenate((self.position, log3(self.rotation)), axis=-1)


class MovingFrame(NamedTuple):
    """Frame F in motion.

    Attributes:
        R_WF: orientation, shape (3, 3).
        p_WF: position, m, shape (3,).
        V: twist of its body about the world's origin in world axes, m/s and rad/s, shape (6,).
    """

    R_WF: Array
    p_WF: Array
    V: Array

    @classmethod
    def on(cls, X_WB: Array, V_WB: Array, X_BF: Array) -> MovingFrame:
        """Return a frame on a body B.

        Args:
            X_WB: Pose of the body, shape (4, 4).
            V_WB: Twist of the body about its origin in world axes, shape (6,).
            X_BF: Pose of the frame on the body, shape (4, 4).
        """
        X, w = X_WB @ X_BF, V_WB[3:]
        return cls(X[:3, :3], X[:3, 3], np.concatenate((V_WB[:3] + np.cross(X_WB[:3, 3], w), w)))


def spring_state(spring: SpringDamper, E: MovingFrame, G: MovingFrame) -> SpringState:
    """Return one spring and damper from G to E at a state; the wrench is on the body of E.

    With p and R the pose of E in G and V the twist of E relative to G, about E in axes of G::

        p = R_WG^T (p_WE - p_WG),  R = R_WG^T R_WE,  F = elastic(p, R) - D V

    Args:
        spring: One spring and damper, n = 1.
        E: Frame of the arm.
        G: Frame of the payload, or of a partner.
    """
    R_GW = G.R_WF.T
    p, R, drift = R_GW @ (E.p_WF - G.p_WF), R_GW @ E.R_WF, E.V - G.V
    V = np.concatenate((R_GW @ (drift[:3] + np.cross(drift[3:], E.p_WF)), R_GW @ drift[3:]))
    damped = -spring.damping[0] * V
    F = spring.elastic(p[None], R[None])[0] + damped
    f = G.R_WF @ F[:3]
    on_body = np.concatenate((f, G.R_WF @ F[3:] + np.cross(E.p_WF, f)))
    return SpringState(F, on_body, p, R, damped @ V)


class PartnerState(NamedTuple):
    """Partner at a state.

    Attributes:
        wrench: wrench on the payload about P in world axes, N and N m, shape (6,).
        deflection: position and rotation vector of the handle from the partner's point, in axes of the
            point, m and rad, shape (6,).
        energy: energy in the spring, J.
        dissipated: power of the damper, W; not positive.
        supplied: power that the moving point gives, W.
    """

    wrench: Array
    deflection: Array
    energy: float
    dissipated: float
    supplied: float


def partner_state(partner: Partner, time: float, X_WP: Array, V_WP: Array) -> PartnerState:
    """Return the spring and damper of a partner at a time and a state of the payload.

    It is that of ``spring_state`` from the partner's point G to the handle. With V_G the twist of the point,
    the power of the wrench F is -d(energy)/dt + dissipated + supplied, supplied = F . V_G.

    Args:
        partner: the partner.
        time: time, s.
        X_WP: pose of the payload, shape (4, 4).
        V_WP: twist of the payload, shape (6,).
    """
    target, X_PH = partner.motion.at(time), partner.handle.matrix
    point = MovingFrame.on(target.X_WP_d, target.V_WP_d, X_PH)
    spring = SpringDamper.of(np.array([partner.stiffness]), np.array([partner.damping]))
    state = spring_state(spring, MovingFrame.on(X_WP, V_WP, X_PH), point)
    return PartnerState(
        wrench=shift_wrench(state.on_body, -X_WP[:3, 3]),
        deflection=state.deflection,
        energy=float(spring.energy(state.position[None], state.rotation[None])[0]),
        dissipated=float(state.power),
        supplied=float(state.on_body @ point.V),
    )


def partner_matrices(partner: Partner, time: float, J_WP: Array) -> tuple[Array, Array]:
    """Return stiffness J^T K J and damping J^T D J of an undeflected partner, shape (nv, nv) each.

    Args:
        partner: the partner.
        time: time, s.
        J_WP: Jacobian of the payload, shape (6, nv).
    """
    X_WG = partner.motion.at(time).X_WP_d @ partner.handle.matrix
    from_P = partner.motion.at(time).X_WP_d[:3, :3] @ partner.handle.matrix[:3, 3]
    R = X_WG[:3, :3]
    J = np.vstack((R.T @ (J_WP[:3] + np.cross(J_WP[3:].T, from_P).T), R.T @ J_WP[3:]))
    return J.T @ np.diag(partner.stiffness) @ J, J.T @ np.diag(partner.damping) @ J
