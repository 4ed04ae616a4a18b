"""Limit surface: tangential forces and torsions at which a patch that is pressed on a plane slides."""

from __future__ import annotations

import numpy as np

from coop_pin.base.arrays import Array

_STEPS, _AT_REST = 50, 1e-9
"""Steps of the search for the sliding motion, and speed of a point at rest, in parts of the mean."""
_NEWTON_STEPS = 8
_TINY = float(np.finfo(float).tiny)


def motion_maps(points: Array) -> Array:
    """Return G_j of points x_j in a plane, shape (k, 2, 3): a motion t = (v, w) moves x_j with G_j t.

    G_j^T takes a force on the point to force and moment about the normal, as of a wrench.

    Args:
        points: points in the plane, m, shape (k, 2) or longer.
    """
    G = np.zeros((len(points), 2, 3))
    G[:, 0, 0] = G[:, 1, 1] = 1.0
    G[:, 0, 2], G[:, 1, 2] = -points[:, 1], points[:, 0]
    return G


def sliding_speeds(G: Array, t: Array) -> Array:
    """Return the speeds |v + w e_z x x_j| of points in a motion of their plane, shape (..., k).

    Their mean with weights p_j is the work h(t) of a unit of friction mu N, the support function of the limit
    surface.

    Args:
        G: Maps of the points, as of ``motion_maps``.
        t: Motions (v, w), shape (..., 3).
    """
    return np.linalg.norm(np.einsum("kia,...a->...ki", G, t), axis=-1)


def needed_friction(F: Array, points: Array, pressures: Array) -> Array:
    """Return the friction mu N that a patch needs for a wrench, N, shape (...,): it slides where it has less.

    Point j at x_j bears the part p_j of the normal force. With the tangential force f and the moment m about
    the normal, of all motions (v, w) in the plane the one that does most work per friction is that of the
    onset of slip::

        mu N = max (f . v + m w) / sum_j p_j |v + w e_z x x_j|

    Goyal, Ruina and Papadopoulos (1991), "Planar sliding with dry friction 1: limit surface and moment
    function". The search is Weiszfeld's: A t = (f, m) with A = sum_j p_j / |v_j| G_j^T G_j and v_j = G_j t of
    the step before. Each step gives a lower bound, of which the best is told: within 1e-3 of the maximum for
    an even pressure, within 1e-2 for the most uneven ones.

    Args:
        F: wrenches on the patch about its middle in axes of the plane, N and N m, shape (..., 6).
        points: points of the patch in the plane, m, shape (k, 2).
        pressures: parts p_j, which sum to one, shape (..., k).
    """
    scale = np.linalg.norm(points, axis=1).max()
    G = motion_maps(points / scale)
    squares = np.swapaxes(G, 1, 2) @ G
    w = np.nan_to_num(np.concatenate((F[..., :2], F[..., 5:] / scale), axis=-1))
    weights, needed, rest = pressures, np.zeros(F.shape[:-1]), 0.3
    for _ in range(_STEPS):
        A = np.einsum("...k,kab->...ab", weights, squares)
        t = np.linalg.solve(A, w[..., None])[..., 0]
        speeds = sliding_speeds(G, t)
        friction = np.maximum((pressures * speeds).sum(axis=-1), _TINY)
        needed = np.maximum(needed, (w * t).sum(axis=-1) / friction)
        rest = max(0.6 * rest, _AT_REST)
        weights = pressures / np.hypot(speeds / friction[..., None], rest)
    return needed


def elastic_pressures(F: Array, points: Array, levers: Array) -> Array:
    """Return the parts p_j of the normal force on points of a rigid face on springs, shape (..., k).

    p_j = max(0, a + b . x_j), with the sum one and the wrench's centre of pressure (-m_y, m_x) / N, at most
    at the levers; equal parts where nothing presses.

    Args:
        F: wrenches on the patch about its middle in axes of the plane, shape (..., 6).
        points: points in the plane, m, shape (k, 2).
        levers: levers l of moments about the axes in the plane, m, shape (2,): from N l on it tips.
    """
    pressed = F[..., 2:3] > 0.0
    moment = np.where(pressed, F[..., 3:5], 0.0) / (levers * np.where(pressed, F[..., 2:3], 1.0))
    moment = levers * np.nan_to_num(moment / np.maximum(np.linalg.norm(moment, axis=-1, keepdims=True), 1.0))
    scale = levers.max()
    x = np.concatenate((np.ones((len(points), 1)), points / scale), axis=1)
    centre = np.stack((np.ones(F.shape[:-1]), -moment[..., 1] / scale, moment[..., 0] / scale), axis=-1)
    bears = np.ones((*F.shape[:-1], len(points)))
    for _ in range(_NEWTON_STEPS):
        H = np.einsum("...k,ka,kb->...ab", bears, x, x)
        p = (np.linalg.pinv(H, rcond=1e-9, hermitian=True) @ centre[..., None])[..., 0] @ x.T
        bears = (p > 0.0).astype(float)
    parts = np.maximum(p, 0.0)
    return parts / parts.sum(axis=-1, keepdims=True)
