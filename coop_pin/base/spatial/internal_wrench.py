"""Load and internal wrenches: the decomposition of interaction wrenches by load shares."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, as_array, shaped
from coop_pin.base.errors import ArgumentError, ShapeError
from coop_pin.base.spatial.pose import shift_wrench

_RANK = 1e-6
"""Ratio of singular values below which tips count as collinear or coplanar; runs move them by rounding."""


def load_wrenches(interaction: Array, load_shares: Array) -> Array:
    """Return the load wrench of each arm: delta_i = c_i sum_j F_j.

    Gueaieb et al. (2007), eqs. (10)-(12).

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., m, k).
        load_shares: c_i, summing to one, shape (..., m).
    """
    if not isinstance(load_shares, np.ndarray) or (type(load_shares) is np.ndarray and load_shares.ndim < 2):
        load_shares = as_array("load_shares", load_shares, "m")
    if not isinstance(interaction, np.ndarray):
        interaction = as_array("interaction", interaction, "m", "k")
    if interaction.shape[-2:-1] != load_shares.shape[-1:]:
        raise ShapeError("interaction", interaction.shape, ("...", load_shares.shape[-1], "k"))
    return load_shares[..., None] * interaction.sum(axis=-2, keepdims=True)


def internal_wrenches(interaction: Array, load_shares: Array) -> Array:
    """Return the internal wrench of each arm: f_i = F_i - c_i sum_j F_j, so that sum_i f_i = 0.

    Gueaieb et al. (2007), eqs. (7), (8), (12).

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., m, k).
        load_shares: c_i, summing to one, shape (m,).
    """
    return interaction - load_wrenches(interaction, load_shares)


def symmetric_internal_wrenches(interaction: Array) -> Array:
    """Return the internal wrenches of two arms in the symmetric formulation: f_1 = (F_1 - F_2) / 2 = -f_2.

    Uchiyama and Dauchez (1993), "Symmetric kinematic formulation and non-master/slave coordinated control of
    two-arm robots". It is the split by equal load shares.

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., 2, 6).
    """
    interaction = shaped("interaction", interaction, 2, 6)
    return (interaction - interaction[..., ::-1, :]) / 2.0


def nonsqueezing_internal_wrenches(interaction: Array, tips: Array) -> Array:
    """Return the internal wrenches left over by the non-squeezing load distribution.

    The load at tip i is ``h_i = [F, N - r_i x F] / m`` of the resultant [F, N] about P. Walker, Freeman and
    Marcus (1991), "Analysis of motion and internal loading of objects grasped by multiple cooperating
    manipulators". About P every arm then has an m-th of the resultant: the split by equal load shares.

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., m, 6).
        tips: r_i, position of each tip relative to P, m, shape (..., m, 3).
    """
    interaction, tips = _grasped(interaction, tips)
    F, N = np.split(interaction.sum(axis=-2, keepdims=True), 2, axis=-1)
    forces = np.broadcast_to(F, tips.shape)
    at_tips = np.concatenate((forces, N - np.cross(tips, forces)), axis=-1) / tips.shape[-2]
    return interaction - shift_wrench(at_tips, tips)


def minimum_norm_internal_wrenches(interaction: Array, tips: Array) -> Array:
    """Return the internal wrenches by the pseudo-inverse of the grasp matrix: h - G^+ G h.

    The tip wrenches h = [h_1, ..., h_m] with the resultant G h have the load part of least norm. The norm
    adds N^2 to (N m)^2: in another unit of length the split is another one. Kumar and Waldron (1988), "Force
    distribution in closed kinematic chains".

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., m, 6).
        tips: r_i, position of each tip relative to P, m, shape (..., m, 3).
    """
    interaction, tips = _grasped(interaction, tips)
    B = _about_P(tips, np.eye(6))
    return _split(interaction, B, B.sum(axis=-3))


def virtual_linkage_internal_wrenches(interaction: Array, tips: Array) -> Array:
    """Return the internal wrenches of the virtual linkage: the load is carried by tip forces alone.

    Every tip moment is internal, balanced by tip forces; of the tip forces, those are internal that act along
    the lines between tips (the tensions of the linkage). Williams and Khatib (1993), "The virtual linkage: a
    model for internal forces in multi-grasp manipulation". Tip forces transmit no moment about the line
    through collinear tips (two arms): this part of the load is divided equally between the tip moments.

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., m, 6).
        tips: r_i, position of each tip relative to P, m, shape (..., m, 3).
    """
    interaction, tips = _grasped(interaction, tips)
    B = _about_P(tips, np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
    middle = tips.mean(axis=-2)
    _, spread, lines = np.linalg.svd(tips - middle[..., None, :])
    u = np.where(spread[..., 1:2] < 1e-9 * spread[..., :1], lines[..., 0, :], 0.0)  # zero unless collinear
    turn = np.concatenate((np.cross(middle, u), u), axis=-1)  # twist about the line: it moves no tip
    moment = u * np.sum(turn * interaction.sum(axis=-2), axis=-1, keepdims=True) / tips.shape[-2]
    by_moments = np.concatenate((np.zeros_like(moment), moment), axis=-1)
    regular = B.sum(axis=-3) + turn[..., :, None] * turn[..., None, :]
    return _split(interaction - by_moments[..., None, :], B, regular)


def linkage_loads(tips: Array) -> Array:
    """Return L_i with the load L_i sum_j F_j of each arm in the virtual linkage, shape (m, 6, 6).

    The split is linear in the resultant, and turns with the tips: f_i = F_i - L_i sum_j F_j.

    Args:
        tips: r_i, position of each tip relative to P, m, shape (m, 3).
    """
    m = len(tips := as_array("tips", tips, "m", 3))
    if m == 1:
        return np.eye(6)[None]
    each = np.tile(np.eye(6)[:, None, :] / m, (1, m, 1))  # resultants, one after the other
    loads = each - virtual_linkage_internal_wrenches(each, np.broadcast_to(tips, (6, m, 3)))
    return np.moveaxis(loads, 0, -1)


class VirtualLinkage(NamedTuple):
    """Internal wrenches of the virtual linkage by struts, one between every two tips; p = m (m - 1) / 2.

    Attributes:
        struts: tension, N, and twisting moment, N m, of each strut, shape (..., p, 2); a tension pulls the
            payload apart, and a positive twist turns the payload at the second tip about the line to it.
        rest: force, N, and moment about the tip, N m, on each arm that no strut carries, shape (..., m, 6).
    """

    struts: Array
    rest: Array


def virtual_linkage(interaction: Array, tips: Array) -> VirtualLinkage:
    """Return tensions and twists of the virtual linkage's struts, and what struts do not carry.

    With ``E`` the unit vectors from tip to tip, ``f = E t + rest`` splits the internal tip forces f and, with
    the same E, the tip moments. Of two tips or three in a triangle, and of four in space, the tensions are
    unique. Struts of collinear tips and of four in a plane can stress each other: t is the least-norm one.
    The pairs of tips are in the order (1, 2), (1, 3), ..., (2, 3), ... Williams and Khatib (1993).

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., m, 6).
        tips: r_i, position of each tip relative to P, m, shape (..., m, 3).
    """
    internal = shift_wrench(virtual_linkage_internal_wrenches(interaction, tips), -tips)
    m, pairs = tips.shape[-2], list(combinations(range(tips.shape[-2]), 2))
    E = np.zeros((*tips.shape[:-2], m, 3, len(pairs)))
    for strut, (i, j) in enumerate(pairs):
        line = tips[..., j, :] - tips[..., i, :]
        line = line / np.maximum(np.linalg.norm(line, axis=-1, keepdims=True), np.finfo(float).tiny)
        E[..., i, :, strut], E[..., j, :, strut] = line, -line
    E = E.reshape(*tips.shape[:-2], 3 * m, len(pairs))
    f = np.moveaxis(internal.reshape(*tips.shape[:-1], 2, 3), -2, -1).reshape(*E.shape[:-1], 2)
    struts = np.linalg.pinv(E, rcond=_RANK) @ f
    rest = np.moveaxis((f - E @ struts).reshape(*tips.shape, 2), -1, -2)
    return VirtualLinkage(struts, rest.reshape(internal.shape))


def determinate_grasp(interaction: Array, tips: Array) -> tuple[Array, Array]:
    """Return wrenches and tips with zeros for rows that rigid bodies do not determine (NaN).

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., m, 6).
        tips: r_i, position of each tip relative to P, m, shape (..., m, 3).
    """
    tips, interaction = shaped("tips", tips, 3), shaped("interaction", interaction, 6)
    if tips.shape[:-1] != interaction.shape[:-1]:
        raise ShapeError("tips", tips.shape, (*interaction.shape[:-1], 3))
    is_free = np.isnan(interaction)
    return np.where(is_free, 0.0, interaction), np.where(is_free[..., :3], 0.0, tips)


def constraint_consistent_internal_wrenches(
    interaction: Array, tips: Array, masses: Array, inertias: Array
) -> Array:
    """Return the internal wrenches by virtual inertias at the tips: those that move no virtual body.

    The load part accelerates virtual bodies (m_i, J_i) at the tips as the rigid payload's motion demands:
    ``h_i = M_i X_i^T (sum_j X_j M_j X_j^T)^-1 [F, N]``. Erhart and Hirche (2015), "Internal force analysis
    and load distribution for cooperative multi-robot manipulation".

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., m, 6).
        tips: r_i, position of each tip relative to P, m, shape (..., m, 3).
        masses: m_i, kg, shape (m,).
        inertias: moments J_i of spherical virtual bodies, kg m^2, shape (m,).
    """
    interaction, tips = _grasped(interaction, tips)
    masses, inertias = (
        as_array(name, value, tips.shape[-2]) for name, value in (("masses", masses), ("inertias", inertias))
    )
    M = np.stack([np.diag([m, m, m, J, J, J]) for m, J in zip(masses, inertias, strict=True)])
    B = _about_P(tips, M)
    return _split(interaction, B, B.sum(axis=-3))


def _grasped(interaction: Array, tips: Array) -> tuple[Array, Array]:
    """Return wrenches and tips, shape (..., m, 6) and (..., m, 3)."""
    interaction, tips = shaped("interaction", interaction, 6), shaped("tips", tips, 3)
    if interaction.ndim < 2 or tips.shape[:-1] != interaction.shape[:-1]:
        raise ShapeError("tips", tips.shape, (*interaction.shape[:-1], 3))
    return interaction, tips


def _about_P(tips: Array, weights: Array) -> Array:
    """Return B_i = X_i W_i X_i^T with X_i = [1, 0; r_i x, 1], shape (..., m, 6, 6)."""
    X = np.broadcast_to(np.eye(6), (*tips.shape[:-1], 6, 6)).copy()
    X[..., 3:, :3] = np.cross(np.eye(3), tips[..., None, :])
    return X @ weights @ np.swapaxes(X, -1, -2)


def _split(interaction: Array, B: Array, total: Array) -> Array:
    """Return F_i - B_i total^-1 sum_j F_j."""
    try:
        motion = np.linalg.solve(total, interaction.sum(axis=-2)[..., None])
    except np.linalg.LinAlgError:
        raise ArgumentError("tips are at one place; the virtual bodies there could turn freely") from None
    return interaction - (B @ motion[..., None, :, :])[..., 0]
