"""Points that stick to bounded planes or slide on them: normal springs and bristles with dry friction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask

_DEEPEST = 1e-2
"""Depth up to which a point that comes from beyond an edge lands on a plane, m; deeper ones pass below."""


class ContactPoints(NamedTuple):
    """Points of body A on planes of body B, with a spring and damper along and a bristle across each normal.

    Of a point at x in the plane's frame, whose z axis points out of B, with the bristle's root a in the plane

    ::

        d = -x_z,    N = max(0, k d + c d')  where d > 0 within the bounds, else 0
        z = (x_x, x_y) - a,    f = -(sigma_0 z + sigma_1 z'), cut to |f| <= mu N

    is the force (f, N) on A. Within a step a rests. After each step the bristle returns radially to the cone
    of the elastic normal force, |z| <= mu k d / sigma_0, and a point without contact keeps none: ``settled``.
    So a stuck point never creeps, a sliding one has exactly mu N, and no state is stiff.

    Attributes:
        stiffness: k, N/m, shape (n,).
        damping: c, N s/m, shape (n,).
        shear_stiffness: sigma_0, N/m, shape (n,).
        shear_damping: sigma_1, N s/m, shape (n,).
        mu: coefficients of friction, shape (n,).
        lower: lower corners of the planes, m, shape (n, 2).
        upper: upper corners, likewise.
    """

    stiffness: Array
    damping: Array
    shear_stiffness: Array
    shear_damping: Array
    mu: Array
    lower: Array
    upper: Array

    def of(self, part: slice) -> ContactPoints:
        """Return the points of a part."""
        return ContactPoints(*(values[part] for values in self))

    def forces(self, x: Array, v: Array, roots: Array, within: Mask) -> tuple[Array, float]:
        """Return the forces on A in axes of the planes, N, shape (n, 3), and the power stored, W.

        Args:
            x: Positions of the points in the planes' frames, m, shape (n, 3).
            v: Their rates, m/s, shape (n, 3).
            roots: Roots a of the bristles, m, shape (n, 2).
            within: Points within the bounds, shape (n,).
        """
        touches = within & (x[:, 2] < 0.0)
        normal = touches * np.maximum(0.0, -self.stiffness * x[:, 2] - self.damping * v[:, 2])
        elastic = self.shear_stiffness[:, None] * (x[:, :2] - roots)
        friction = -elastic - self.shear_damping[:, None] * v[:, :2]
        size, most = np.sqrt((friction * friction).sum(axis=1)), self.mu * normal
        friction *= _kept(size, most)[:, None]
        stored = self.stiffness * x[:, 2] * v[:, 2] + (elastic * v[:, :2]).sum(axis=1)
        return np.column_stack((friction, normal)), float(stored[touches].sum())

    def energy(self, x: Array, roots: Array, within: Mask) -> float:
        """Return the energy in springs and bristles, J; arguments as of ``forces``."""
        touches = within & (x[:, 2] < 0.0)
        bristles = ((x[:, :2] - roots) ** 2).sum(axis=1)
        return float(0.5 * (self.stiffness * x[:, 2] ** 2 + self.shear_stiffness * bristles)[touches].sum())

    def settled(self, x: Array, roots: Array, within: Mask) -> tuple[Array, Mask, Array]:
        """Return roots and bounded points after a step, and how far each touching point slid, m, shape (n,).

        Arguments are as of ``forces``.
        """
        flat, depth = x[:, :2], -x[:, 2]
        bounded = ((flat >= self.lower) & (flat <= self.upper)).all(axis=1)
        within = bounded & (within | (depth < _DEEPEST))
        z = flat - roots
        most = self.mu * self.stiffness * np.where(within, np.maximum(depth, 0.0), 0.0) / self.shear_stiffness
        size = np.sqrt((z * z).sum(axis=1))
        kept = _kept(size, most)
        return flat - kept[:, None] * z, within, np.where(most > 0.0, (1.0 - kept) * size, 0.0)


def _kept(size: Array, most: Array) -> Array:
    """Return the factors that shorten sizes to at most these, shape (n,)."""
    beyond = size > most
    return np.where(beyond, most / np.where(beyond, size, 1.0), 1.0)
