"""Contacts in the 3-D scene: pads, friction cones with the forces in them, partners, nearest points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.spatial import exp3, make_pose, quaternions, rotations
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.contact import Pad
from coop_pin.description.events import Partner
from coop_pin.figures import palette
from coop_pin.model.shapes import Box, Cylinder, Mesh, Sphere
from coop_pin.results.friction import pad_wrench
from coop_pin.results.quantity import Samples
from coop_pin.viz.scene import Item

_PAD_M, _PAD_COLOUR = 0.003, "#7d858f"
"""Thickness and colour of a patch as drawn."""
_CONE_M, _CONE_SIDES, _NEEDLE_M = 0.09, 32, 0.004
"""Slant height and sides of a friction cone; radius of the needle along the force in it."""
_HAND_M, _HANDLE_M = 0.045, 0.022
"""Radii of a partner's hand and of the handle."""
_LIMBS = ((0.28, 0.036, 0.2), (0.3, 0.046, 0.75))
"""Length and radius of a partner's forearm and upper arm, m, and how far they rise, as sines."""

_NEAREST, _NEAR_M = ("nearest/first", "nearest/second"), 0.012
"""Nodes of the nearest points of two bodies, and the radius of a point, m."""

HOLDS, SLIDES, ABSENT = 0, 4, 5
"""Codes of a contact, as those of warning colours: it sticks or would, it slides or would, there is none."""


_SLID_M = 1e-7
"""Slip between two frames from which a patch slides, m."""


def contact_nodes(cell: Cell, partners: Sequence[Partner], nearest: bool = False) -> tuple[str, ...]:
    """Return the paths of the nodes that move: cones and needles of contacts, the hand, nearest points."""
    parts = (f"{part}/{name}" for name in cell.padded for part in ("cones", "needles"))
    return (*parts, *["hand"] * bool(partners), *_NEAREST * nearest)


def contact_items(cell: Cell, partners: Sequence[Partner], nearest: bool = False) -> Iterator[Item]:
    """Yield pads on the payload's faces, friction cones of half angle atan(mu) with needles, handle and hand.

    The apex of a cone is in the middle of its patch; its axis is the normal out of the payload. The force of
    the payload on the arm points along the needle, which is inside the cone while friction holds.
    """
    for name, pad in cell.padded.items():
        X_PF = cell.grasps[name].matrix @ pad.plane @ make_pose((0.0, 0.0, _PAD_M / 2.0))
        shape = Cylinder(pad.radius, _PAD_M) if pad.radius else Box((*(pad.size or (0.0, 0.0)), _PAD_M))
        yield Item("payload", shape, _PAD_COLOUR, X_PF)
        yield Item(
            f"cones/{name}", _cone(pad.mu), palette.LOAD, np.eye(4), "cones", 0.45, lit=False, over=True
        )
        needle, middle = Cylinder(_NEEDLE_M, 1.2 * _CONE_M), make_pose((0.0, 0.0, 0.6 * _CONE_M))
        yield Item(f"needles/{name}", needle, palette.DESIRED, middle, "cones", lit=False, over=True)
    for partner in partners:
        yield Item("payload", Sphere(_HANDLE_M), palette.EXTERNAL, partner.handle.matrix)
    for partner in partners[:1]:
        yield from _arm(partner)
    for node in _NEAREST * nearest:
        yield Item(node, Sphere(_NEAR_M), palette.SLIDES, np.eye(4), lit=False, over=True)


def _arm(partner: Partner) -> Iterator[Item]:
    """Yield hand, forearm and upper arm of a partner: capsules that go away from the payload and upwards."""
    R_HP, away = partner.handle.matrix[:3, :3].T, partner.handle.matrix[:3, 3] * (1.0, 1.0, 0.0)
    away = np.array((0.0, -1.0, 0.0)) if np.linalg.norm(away) < 1e-6 else away / np.linalg.norm(away)
    yield Item("hand", Sphere(_HAND_M), palette.EXTERNAL, np.eye(4), "external")
    start = np.zeros(3)
    for length, radius, rise in _LIMBS:
        along = R_HP @ (np.sqrt(1.0 - rise**2) * away + (0.0, 0.0, rise))
        X_HL = np.eye(4)
        X_HL[:3, :3] = _turns(along[None])[0]
        X_HL[:3, 3] = start + length / 2.0 * along
        start = start + length * along
        yield Item("hand", Cylinder(radius, length), palette.EXTERNAL, X_HL, "external")
        yield Item("hand", Sphere(1.08 * radius), palette.EXTERNAL, make_pose(start), "external")


def contact_poses(
    samples: Samples, cell: Cell, partners: Sequence[Partner]
) -> tuple[Array, NDArray[np.int8]]:
    """Return poses and codes of the nodes of contacts at n samples.

    Args:
        samples: quantities by name, n samples along the first axis.
        cell: the cell.
        partners: partners of the run.

    Returns:
        x, y, z (m) and quaternion x, y, z, w, shape (n, nodes, 7), and codes, shape (n, nodes).
    """
    R, p = rotations(samples["payload_quaternion"]), samples["payload_position"]
    poses, codes = [np.zeros((len(p), 0, 7))], [np.zeros((len(p), 0), dtype=np.int8)]
    for name, pad in cell.padded.items():
        X_PF, F = cell.grasps[name].matrix @ pad.plane, pad_wrench(samples, cell, name, pad)
        apex, R_WF = p + R @ X_PF[:3, 3], R @ X_PF[:3, :3]
        poses.append(np.stack([_poses(apex, turn) for turn in (R_WF, R_WF @ _turns(F[:, :3]))], axis=1))
        codes.append(np.repeat(_codes(F, _slides(samples, cell, name, pad, F))[:, None], 2, axis=1))
    if partners:
        pose, is_held = _hand(samples, R, p, partners)
        poses.append(pose[:, None])
        codes.append(np.where(is_held, HOLDS, ABSENT)[:, None].astype(np.int8))
    if "nearest_points" in samples:
        points = samples["nearest_points"]
        is_known = np.isfinite(points).all(axis=2)
        turns = np.broadcast_to((0.0, 0.0, 0.0, 1.0), (*is_known.shape, 4))
        poses.append(np.concatenate((np.nan_to_num(points), turns), axis=2))
        codes.append(np.where(is_known, HOLDS, ABSENT).astype(np.int8))
    return np.concatenate(poses, axis=1), np.concatenate(codes, axis=1)


def _codes(F: Array, slides: Mask) -> NDArray[np.int8]:
    """Return the codes of a patch or pad, shape (n,): where nothing presses, there is no contact."""
    return np.where(F[:, 2] > 0.0, np.where(slides, SLIDES, HOLDS), ABSENT).astype(np.int8)


def _slides(samples: Samples, cell: Cell, name: str, pad: Pad, F: Array) -> Mask:
    """Return where a patch has slid since the sample before, or a pad would slide, shape (n,)."""
    if name in cell.patches and "patch_slip" in samples:
        slip = samples["patch_slip"][:, list(cell.patches).index(name)]
        return np.diff(slip, prepend=slip[:1]) > _SLID_M
    slides: Mask = pad.needed_friction(F) > pad.mu * F[:, 2]
    return slides


def _poses(p: Array, R: Array) -> Array:
    return np.concatenate((p, quaternions(R)), axis=1)


def _turns(f: Array) -> Array:
    """Return the least rotations of z onto forces, shape (n, 3, 3); identities where there is none."""
    size = np.linalg.norm(f, axis=1, keepdims=True)
    x, y, z = np.where(size > 0.0, f / np.where(size > 0.0, size, 1.0), (0.0, 0.0, 1.0)).T
    q = np.stack((-y, x, np.zeros_like(x), 1.0 + np.maximum(z, 0.0)), axis=1)
    return rotations(q / np.linalg.norm(q, axis=1, keepdims=True))


def _hand(samples: Samples, R: Array, p: Array, partners: Sequence[Partner]) -> tuple[Array, Mask]:
    """Return the pose of the point that a partner moves, shape (n, 7), and where a partner holds, shape (n,).

    The deflection of the handle H from the point G is in axes of G: R_WG = R_WH exp(r)^T, p_G = p_H - R_WG p.
    """
    time, none = samples["time"], np.zeros((len(p), 6))
    deflection = np.nan_to_num(samples.get("partner_deflection", none))  # NaN in rows of no task
    poses, is_held = _poses(p, R), np.zeros(len(p), dtype=bool)
    for partner in partners:
        holds = (time >= partner.time) & (time < partner.end)
        X_PH, is_held = partner.handle.matrix, is_held | holds
        R_WG = R @ X_PH[:3, :3] @ np.swapaxes(np.stack([exp3(r) for r in deflection[:, 3:]]), 1, 2)
        p_G = p + R @ X_PH[:3, 3] - (R_WG @ deflection[:, :3, None])[..., 0]
        poses[holds] = _poses(p_G, R_WG)[holds]
    return poses, is_held


def _cone(mu: float) -> Mesh:
    """Return the surface of a cone of half angle atan(mu) about z, with its apex in the origin."""
    angle = 2.0 * np.pi * np.arange(_CONE_SIDES) / _CONE_SIDES
    height, radius = _CONE_M / np.hypot(1.0, mu), _CONE_M * mu / np.hypot(1.0, mu)
    rim = np.stack((radius * np.cos(angle), radius * np.sin(angle), np.full(_CONE_SIDES, height)), axis=1)
    k = np.arange(_CONE_SIDES)
    faces = np.stack((np.zeros_like(k), 1 + k, 1 + (k + 1) % _CONE_SIDES), axis=1)
    return Mesh(np.concatenate((np.zeros((1, 3)), rim)), faces)
