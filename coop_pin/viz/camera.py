"""Camera of a scene: what it must show at the opening instant, and whether it goes with the payload."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import rotations
from coop_pin.description.cell.cell import Cell
from coop_pin.model.shapes import bounds
from coop_pin.model.visuals import Body
from coop_pin.results.quantity import Samples
from coop_pin.viz.scene import LONGEST_M, ArrowScales, Camera, drawn_lengths

_FIELD_OF_VIEW_DEG, _ASPECT = 32.0, 1.4
"""Vertical angle of the view, and ratio of width to height of the window that it is framed for."""
_AZIMUTH_DEG = 22.0
_ELEVATION_DEG = 24.0
_PLANAR_ELEVATION_DEG = 42.0
_MARGIN = 1.06
"""Room around what is framed, as a factor."""
_CORNERS = np.array(list(itertools.product((False, True), repeat=3)))
_TRAVELS_M = 1.0
"""Distance from which the camera goes with a payload, m."""
_BEGINS, _ENDS = 0.25, 0.6
"""Cosines to the inward direction from which an arrow begins, and ends, at its grasp; between, it slides."""


def framing_camera(cell: Cell, tips: Array, path: Array, at: Array, shown: Array) -> Camera:
    """Return a camera that frames an instant, the first arm on the left and the last on the right.

    Its azimuth is a little off the front, to the side from which the line between the tips appears longer.
    Planar cells are seen from higher up, arms on one base from the front. A payload that travels far is
    followed; else all of its path is in view.

    Args:
        cell: the cell.
        tips: positions of the tips at the instant, m, shape (m, 3).
        path: positions of the payload over time, m, shape (n, 3).
        at: position of the payload at the instant, m, shape (3,).
        shown: points that are in view at the instant, m, shape (k, 3).
    """
    bases = np.array([arm.base.xyz for arm in cell.arms.values()])
    follows = travels(path, at)
    points = np.concatenate((shown, at[None], tips, *[path] * (not follows))) - at
    outwards = _outwards(cell, bases, tips)
    right = np.array((-outwards[1], outwards[0], 0.0)) / np.hypot(*outwards[:2])
    up, z = np.cross(outwards, right), points @ outwards  # z towards the camera
    half = np.tan(np.radians(_FIELD_OF_VIEW_DEG / 2.0)) / _MARGIN
    (x, far_x), (y, far_y) = _centred(points @ right, z, _ASPECT * half), _centred(points @ up, z, half)
    target = at + x * right + y * up
    eye = target + max(far_x, far_y) * outwards
    return Camera(eye, target, _FIELD_OF_VIEW_DEG, at if follows else None)


def travels(path: Array, at: Array) -> bool:
    """Return whether a payload goes so far from a position that the camera goes with it."""
    return bool(np.linalg.norm(path - at, axis=1).max() > _TRAVELS_M)


def _centred(x: Array, z: Array, slope: float) -> tuple[float, float]:
    """Return the coordinate of a camera and its least distance, so that |x - c| <= slope (d - z) everywhere.

    At the edges x - c = slope (d - z) and c - x = slope (d - z); their sum gives d, their difference c.
    """
    high, low = float((x + slope * z).max()), float((slope * z - x).max())
    return (high - low) / 2.0, (high + low) / (2.0 * slope)


def _outwards(cell: Cell, bases: Array, tips: Array) -> Array:
    """Return the direction from the cell to its camera, shape (3,)."""
    line, across = tips[-1] - tips[0], bases[-1, :2] - bases[0, :2]
    if np.linalg.norm(across) < 1e-6:
        ahead = tips.mean(axis=0) - bases[0]
        across = np.array((-ahead[1], ahead[0]))
    front = np.arctan2(across[1], across[0]) - np.pi / 2.0
    sides = (front + np.radians(_AZIMUTH_DEG), front - np.radians(_AZIMUTH_DEG))
    azimuth = max(sides, key=lambda side: abs(line[0] * np.sin(side) - line[1] * np.cos(side)))
    elevation = np.radians(_PLANAR_ELEVATION_DEG if cell.rows == "planar" else _ELEVATION_DEG)
    level = np.cos(elevation)
    return np.array((np.cos(azimuth) * level, np.sin(azimuth) * level, np.sin(elevation)))


def link_points(bodies: Iterable[Body], poses: Array) -> Array:
    """Return the corners of boxes around the shapes of bodies, m, shape (k, 3).

    Args:
        bodies: bodies of the arms.
        poses: their poses, as of ``CellVisuals.poses`` at one configuration, shape (n, 7).
    """
    points = [np.zeros((0, 3))]
    for body, p, R in zip(bodies, poses[:, :3], rotations(poses[:, 3:]), strict=True):
        for visual in body.visuals:
            low, high = bounds(visual.shape)
            corners = np.where(_CORNERS, high, low) @ visual.pose[:3, :3].T + visual.pose[:3, 3]
            points.append(corners @ R.T + p)
    return np.concatenate(points)


def longest_arrows(tips: Array) -> Array:
    """Return the ends of the longest arrows at tips along all axes, m, shape (k, 3).

    Args:
        tips: positions, m, shape (m, 3).
    """
    return (tips[:, None] + LONGEST_M * np.concatenate((np.eye(3), -np.eye(3)))).reshape(-1, 3)


def arrow_ends(samples: Samples, scales: ArrowScales) -> Array:
    """Return both ends of the forces of the arms on the payload and of a push, shape (n, k, 3), m.

    Args:
        samples: quantities by name, n samples along the first axis.
        scales: scales of the arrows.
    """
    tips, inner = samples["tip_position"], -np.nan_to_num(samples["internal_wrench"])[..., :3]
    whole, push = (
        sign * np.nan_to_num(samples[name])[..., :3]
        for name, sign in (("interaction_wrench", -1.0), ("external_wrench", 1.0))
    )
    inwards = tips.mean(axis=1, keepdims=True) - tips
    inwards /= np.maximum(np.linalg.norm(inwards, axis=2, keepdims=True), 1e-9)
    ends = [samples["payload_position"][:, None]]
    ends.append(ends[0] + _drawn(push, scales)[:, None])
    for force in (inner, whole - inner):
        arrow = _drawn(force, scales)
        length = np.maximum(np.linalg.norm(arrow, axis=2, keepdims=True), 1e-9)
        turned = (arrow * inwards).sum(axis=2, keepdims=True) / length
        share = np.clip((turned - _BEGINS) / (_ENDS - _BEGINS), 0.0, 1.0)
        tail = tips - share * share * (3.0 - 2.0 * share) * arrow
        ends += [tail, tail + arrow]
    return np.concatenate(ends, axis=1)


def _drawn(force: Array, scales: ArrowScales) -> Array:
    """Return forces as long as they are drawn, m."""
    size = np.linalg.norm(force, axis=-1, keepdims=True)
    return force / np.maximum(size, 1e-12) * drawn_lengths(size / scales.newtons_per_metre)
