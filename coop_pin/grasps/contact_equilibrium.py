"""Static equilibrium of contacts: a payload that lies on tables, and patches pressed by squeeze and load."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.spatial import weight_wrench
from coop_pin.base.spatial.internal_wrench import linkage_loads
from coop_pin.grasps.contact_patches import ContactPatches
from coop_pin.grasps.contact_points import ContactPoints
from coop_pin.grasps.equilibrium import MOST_STEPS, reached

_RESTS = 1e-3
"""Height above a table up to which a payload starts on it, m."""
_SETTLED = 1e-13


def started(contacts: ContactPatches, q: Array, squeeze: Array) -> Array:
    """Return the configuration at rest, near one with the tips at their grasps, that bears the load.

    A payload at the height of a table lies on it, and the arms bear their squeeze alone; else the patches
    bear the load as tip forces, by the split of the virtual linkage. The bristles are loaded.

    Args:
        contacts: Patches and tables, whose memory is replaced.
        q: Configuration.
        squeeze: Desired internal wrenches about P in payload axes, N and N m, shape (m, 6).
    """
    _root(contacts, q)  # else points beside a table would touch its plane in the first step
    on_table = lies(contacts, q)
    q = laid(contacts, q) if on_table else q
    contacts.bodies.move(q, np.zeros(contacts.tree.model.nv))
    R_WP, cell = contacts.bodies.side(contacts.tree.payload_frame).pose.rotation, contacts.cell
    W = np.kron(np.eye(2), R_WP)
    loads = squeeze @ W.T
    if not on_table:
        tips = np.array([grasp.matrix[:3, 3] for grasp in cell.grasps.values()]) @ R_WP.T
        loads += linkage_loads(tips) @ weight_wrench(cell.payload.mass, cell.gravity)
    for number, index in enumerate(contacts.arms):
        q = _pressed(contacts, q, number, pin.Force(W.T @ loads[index]))
    return q


def lies(contacts: ContactPatches, q: Array) -> bool:
    """Return whether a free payload is at the height of a table.

    Args:
        contacts: Patches and tables.
        q: Configuration.
    """
    if contacts.tree.closed_by_tree or len(contacts) == len(contacts.arms):
        return False
    return bool(_near_tables(contacts, contacts.positions(q)).any())


def laid(contacts: ContactPatches, q: Array) -> Array:
    """Return q with the payload moved until tables and weight balance, its bristles loaded.

    Args:
        contacts: Patches and tables, whose memory is replaced.
        q: Configuration with the payload near a table.
    """
    model, joint, bodies = contacts.tree.model, contacts.tree.payload_joint, contacts.bodies
    entries = slice(int(model.idx_vs[joint]), int(model.idx_vs[joint]) + 6)
    weight = weight_wrench(contacts.cell.payload.mass, contacts.cell.gravity)[:3]
    _root(contacts, q)
    q = _lowered(contacts, q, entries, float(np.linalg.norm(weight)))
    for _ in range(MOST_STEPS):
        x = contacts.positions(q)
        bodies.F_J[:] = 0.0
        contacts.act()
        R = bodies.data.oMi[joint].rotation
        missing = bodies.force(q)[entries] + np.concatenate((R.T @ weight, np.zeros(3)))
        touches = (contacts.contact_of >= len(contacts.arms)) & contacts.state.within & (x[:, 2] < 0.0)
        step = np.zeros(model.nv)
        step[entries] = np.linalg.lstsq(_stiffness(contacts, touches), missing, rcond=1e-9)[0]
        q = pin.integrate(model, q, step)
        if np.abs(step).max() < _SETTLED:
            break
    return q


def _near_tables(contacts: ContactPatches, x: Array) -> Mask:
    """Return which points, m, shape (n, 3), are over a table and at its height."""
    within = contacts.points.settled(x, x[:, :2], np.ones(len(x), dtype=bool))[1]
    return within & (contacts.contact_of >= len(contacts.arms)) & (x[:, 2] < _RESTS)


def _stiffness(contacts: ContactPatches, touches: Mask) -> Array:
    """Return the stiffness of points of the payload that touch tables, in its axes, shape (6, 6)."""
    K, points = np.zeros((6, 6)), contacts.points
    for point in np.flatnonzero(touches):
        A, B = contacts.sides[contacts.contact_of[point]]
        G = B.pose.rotation.T @ A.pose.rotation @ np.hstack((np.eye(3), -pin.skew(contacts.on_body[point])))
        shear = points.shear_stiffness[point]
        K += G.T @ (np.array((shear, shear, points.stiffness[point]))[:, None] * G)
    return K


def _lowered(contacts: ContactPatches, q: Array, entries: slice, weight: float) -> Array:
    """Return q with the payload moved along the normal of a table into it, as its weight would press."""
    x, model = contacts.positions(q), contacts.tree.model
    near = np.flatnonzero(_near_tables(contacts, x))
    table = contacts.sides[contacts.contact_of[near[0]]][1]
    depth = weight / contacts.points.stiffness[near].sum() + float(x[near, 2].min())
    step, R_WJ = np.zeros(model.nv), contacts.bodies.data.oMi[contacts.tree.payload_joint].rotation
    step[entries.start : entries.start + 3] = -R_WJ.T @ table.pose.rotation[:, 2] * depth
    return pin.integrate(model, q, step)


def _root(
    contacts: ContactPatches, q: Array, stretch: Array | float = 0.0, part: slice = slice(None)
) -> None:
    """Put the roots of bristles below their points, less a stretch, m."""
    x = contacts.positions(q)[part]
    roots, within = contacts.state.roots.copy(), contacts.state.within.copy()
    roots[part], within[part], _ = contacts.points.of(part).settled(
        x, x[:, :2] - stretch, np.ones(len(x), dtype=bool)
    )
    contacts.state = contacts.state._replace(roots=roots, within=within)


def _pressed(contacts: ContactPatches, q: Array, number: int, load: Any) -> Array:
    """Return q with an arm moved until its patch has a wrench about P in payload axes on the arm."""
    (A, B), part, tree = contacts.sides[number], contacts.parts[number], contacts.tree
    grasp = contacts.cell.patches[contacts.names[number]]
    wrench = pin.SE3(grasp.matrix @ grasp.plane).actInv(load).vector
    X, stretch = _held(contacts.points.of(part), contacts.on_body[part], wrench)
    contacts.bodies.move(q, np.zeros(tree.model.nv))
    joints = tree.arms[contacts.arms[number]].v_slice
    q = reached(tree.model, contacts.bodies.data, q, A, joints, B.pose * X)
    _root(contacts, q, stretch, part)
    return q


def _held(points: ContactPoints, r: Array, wrench: Array) -> tuple[Any, Array]:
    """Return the pose of a patch in its plane under a wrench on it, and the stretch of its bristles, m."""
    k, shear = points.stiffness, points.shear_stiffness
    still, inside = np.zeros((len(r), 3)), np.ones(len(r), dtype=bool)
    against_tilt, against_turn = (
        (k[:, None] * r[:, 1::-1] ** 2).sum(axis=0),
        (shear * (r * r).sum(axis=1)).sum(),
    )
    pressing = np.array([k.sum(), *against_tilt])
    pose, bristles = np.zeros(3), np.zeros(3)

    def placed() -> tuple[Any, Array]:
        X = pin.SE3(pin.exp3(np.array((pose[1], pose[2], 0.0))), np.array((0.0, 0.0, -pose[0])))
        return X, bristles[:2] + bristles[2] * np.column_stack((-r[:, 1], r[:, 0]))

    for _ in range(MOST_STEPS if wrench[2] > 0.0 else 0):
        X, stretch = placed()
        x = r @ X.rotation.T + X.translation
        F, _ = points.forces(x, still, x[:, :2] - stretch, inside)
        missing = wrench - np.concatenate((F.sum(axis=0), np.cross(x, F).sum(axis=0)))
        change = np.array([missing[2], -missing[3], -missing[4]]) / pressing
        turn = np.array([*missing[:2] / shear.sum(), missing[5] / against_turn])
        pose, bristles = pose + change, bristles - turn
        if max(np.abs(change).max(), np.abs(turn).max()) < _SETTLED:
            break
    return placed()
