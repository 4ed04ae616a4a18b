"""Partner of a cell: spring and damper between a handle of the payload and a moving point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.chain.grasp_springs import SpringDamper
from coop_pin.description.events import Partner
from coop_pin.spatial import log3


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

    With G the partner's point, H the handle, p and R the pose of H in G and V the twist of H relative to G
    about H in axes of G, the wrench on the payload about H is F = elastic(p, R) - D V of SpringDamper. With
    V_G of the point at H, its power F.(V + V_G) is

        -d(energy)/dt + dissipated + supplied,    supplied = F.V_G

    Args:
        partner: the partner.
        time: time, s.
        X_WP: pose of the payload, shape (4, 4).
        V_WP: twist of the payload, shape (6,).
    """
    target, X_PH = partner.motion.at(time), partner.handle.matrix
    X_WG = target.X_WP_d @ X_PH
    X_WH, R_WG = X_WP @ X_PH, X_WG[:3, :3]
    from_P, p_W = X_WH[:3, 3] - X_WP[:3, 3], X_WH[:3, 3] - X_WG[:3, 3]
    v, w = V_WP[:3] + np.cross(V_WP[3:], from_P), V_WP[3:]
    v_d, w_d = target.V_WP_d[:3], target.V_WP_d[3:]
    v_G = v_d + np.cross(w_d, X_WH[:3, 3] - target.X_WP_d[:3, 3])
    p, R = R_WG.T @ p_W, R_WG.T @ X_WH[:3, :3]
    V = np.concatenate((R_WG.T @ (v - v_G), R_WG.T @ (w - w_d)))
    spring = SpringDamper.of(np.array([partner.stiffness]), np.array([partner.damping]))
    damped = spring.dissipative(V[None])[0]
    F = spring.elastic(p[None], R[None])[0] + damped
    f, m = R_WG @ F[:3], R_WG @ F[3:]
    return PartnerState(
        wrench=np.concatenate((f, m + np.cross(from_P, f))),
        deflection=np.concatenate((p, log3(R))),
        energy=float(spring.energy(p[None], R[None])[0]),
        dissipated=float(damped @ V),
        supplied=float(f @ v_G + m @ w_d),
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
