"""Which part of the wrenches in a closed chain rigid bodies determine at all."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array, Mask
from coop_pin.chain.cell_chain import CellChain
from coop_pin.chain.kkt_solver import mass_weighted
from coop_pin.model.pinocchio_model import symmetric
from coop_pin.spatial import rotate_vector6, shift_wrench

_UNDETERMINED = 1e-6


def determined_rows(chain: CellChain, q: Array) -> Mask:
    """Say which rows of the interaction wrenches (about P, in world axes) the closed chain determines, shape (6,).

    Closure multipliers in the null space of J^T move no joint. Rows that they reach are shared between the arms' structures in
    a way that rigid bodies do not tell: for example the weight of a bar between two planar arms.

    Args:
        chain: the closed cell.
        q: configuration, shape (nq,).
    """
    model, data = chain.tree.model, chain.tree.model.createData()
    closed = chain.chain.closures
    state = closed.state(q, np.zeros(model.nv))
    weighted = mass_weighted(symmetric(pin.crba(model, data, q)), state.jacobian)
    idle = np.eye(len(state.position)) - weighted.left @ weighted.left.T
    pin.framesForwardKinematics(model, data, q)
    p_WP = data.oMf[chain.tree.payload_frame].translation
    determined = np.ones(6, dtype=bool)
    for (tip, _), wrench_map in zip(closed.sides, state.wrench_map, strict=True):
        X_WE = data.oMf[tip.named]
        in_world = rotate_vector6(X_WE.rotation, (wrench_map @ idle).T)
        about_P = shift_wrench(in_world, X_WE.translation - p_WP)
        determined &= np.abs(about_P).max(axis=0, initial=0.0) < _UNDETERMINED
    return determined
