"""Partner of a cell: spring and damper between a handle of the payload and a moving point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import shift_wrench
from coop_pin.description.events import Partner
from coop_pin.grasps.spring_damper import MovingFrame, SpringDamper, spring_state


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
