"""Turning an orientation about an axis that stays fixed in the world."""

from __future__ import annotations

import math

import numpy as np

from coop_pin.arrays import Array


def axis_turn_terms(axis: Array, R: Array) -> Array:
    """Return the terms of exp(theta [e]x) R = R + sin(theta) [e]x R + (1 - cos(theta)) [e]x^2 R, shape (3, 9).

    Args:
        axis: unit vector e in world axes, shape (3,).
        R: rotation matrix to be turned, shape (3, 3).
    """
    cross = np.cross(axis, np.eye(3)).T
    return np.stack((R, cross @ R, cross @ cross @ R)).reshape(3, 9)


def turned(terms: Array, angle: float) -> Array:
    """Return exp(theta [e]x) R from its terms, shape (3, 3).

    Args:
        terms: from axis_turn_terms, shape (3, 9).
        angle: theta, rad.
    """
    R: Array = (np.array((1.0, math.sin(angle), 1.0 - math.cos(angle))) @ terms).reshape(3, 3)
    return R
