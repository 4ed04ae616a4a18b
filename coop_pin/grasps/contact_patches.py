"""Contacts with dry friction: patches pressed on faces of the payload, and tables under it.

Both are one element, points of a body A on a bounded plane of a body B. Its wrench is a pure function of
relative pose and velocity (``ContactPoints``); ``ContactPatches`` has its places in the tree of a cell.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, Mask
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.contact import DryContact, corners
from coop_pin.grasps.contact_points import ContactPoints
from coop_pin.grasps.force_elements import ForceElements, own_loads
from coop_pin.grasps.grasp_springs import changed
from coop_pin.model.cell_model import CellModel
from coop_pin.model.pinocchio_model import frame_id, symmetric

_TINY = float(np.finfo(float).tiny)


class PatchesState(NamedTuple):
    """Memory of contacts; the arrays are not written to.

    Attributes:
        roots: roots of the bristles in the planes, m, shape (n, 2).
        within: points within the bounds of their planes, shape (n,).
        slip: distance that each patch has slid since it took hold, the mean of its points that touch, m,
            shape (p,).
    """

    roots: Array
    within: Mask
    slip: Array


class ContactState(NamedTuple):
    """Contacts of a cell at a state; p patches on arms and tables.

    Attributes:
        wrench: wrench on body A of each about the plane's origin in its axes, N and N m, shape (p, 6).
        on_bodies: the same about the world's origin in world axes, shape (p, 6).
        touching: number of points that bear a force, shape (p,).
        energy: energy in springs and bristles, J.
        power: power that neither moves bodies nor is stored, W: negative where the contacts dissipate.
    """

    wrench: Array
    on_bodies: Array
    touching: Array
    energy: float
    power: float


class _Now(NamedTuple):
    """Contacts at the state of the joints.

    Attributes:
        x: points in their planes, m, shape (n, 3).
        F: forces on them, N, shape (n, 3).
        wrenches: wrench on body A of each about the plane's origin in its axes.
        on_bodies: the same about the world's origin in world axes.
        power: Power of ContactState, W.
    """

    x: Array
    F: Array
    wrenches: Array
    on_bodies: list[Any]
    power: float


class ContactPatches:
    """Contacts with friction in the tree of a cell: first the patches of arms, then the tables.

    Attributes:
        names: their names: of arms, then of tables.
        arms: indices of the arms with patches.
        cell, tree, bodies: as of the call.
        sides: bodies A and B of each, with poses of their planes.
        parts: points of each among all.
        contact_of: contact of each point, shape (n,).
        on_body: points on their bodies A, in axes of the planes, m, shape (n, 3).
        points: their points. They have no damping before ``damp`` is called.
        state: memory, replaced by ``settle``.
    """

    def __init__(self, cell: Cell, tree: CellModel, bodies: ForceElements) -> None:
        """Find the frames of the contacts.

        Args:
            cell: Description.
            tree: Tree of the cell, which is kept.
            bodies: Joints of the tree and the wrenches on them, to which the contacts add theirs.
        """
        self.cell, self.tree, self.bodies, model = cell, tree, bodies, tree.model
        self.names = [*cell.patches, *cell.tables]
        self.arms = [list(cell.arms).index(name) for name in cell.patches]
        self._rest = np.zeros(model.nv)
        frames = [(frame_id(model, f"payload/{name}"), grasp.plane) for name, grasp in cell.patches.items()]
        self.sides = [
            (bodies.side(tree.arms[index].tip, plane), bodies.side(face, plane))
            for index, (face, plane) in zip(self.arms, frames, strict=True)
        ] + [
            (bodies.side(tree.payload_frame), bodies.side(0, table.matrix)) for table in cell.tables.values()
        ]
        contacts: list[DryContact] = [*cell.patches.values(), *cell.tables.values()]
        points = [grasp.points for grasp in cell.patches.values()] + [corners(cell.payload)] * len(
            cell.tables
        )
        bounds = [grasp.bounds(cell.payload) for grasp in cell.patches.values()]
        bounds += [table.bounds for table in cell.tables.values()]
        counts = [len(part) for part in points]
        self._contacts, self._counts = contacts, np.array(counts, dtype=int)
        self.contact_of = np.repeat(np.arange(len(counts)), counts)
        self._starts = np.cumsum([0, *counts])[:-1]
        self.parts = [slice(a, a + n) for a, n in zip(self._starts.tolist(), counts, strict=True)]
        self.on_body = np.concatenate([np.zeros((0, 3)), *points])
        numbers = [(contact.stiffness, contact.shear_stiffness, contact.mu) for contact in contacts]
        stiffness, shear_stiffness, mu = np.reshape(numbers, (-1, 3))[self.contact_of].T.copy()
        # The corners of a payload have a second face, which is not on the table at the same time.
        share = np.where(np.arange(len(counts)) < len(self.arms), self._counts, self._counts / 2.0)
        self._shared = shared = share[self.contact_of]
        n = len(self.on_body)
        none, (lower, upper) = np.zeros(n), np.swapaxes(np.reshape(bounds, (-1, 2, 2))[self.contact_of], 0, 1)
        self.points = ContactPoints(
            stiffness / shared, none, shear_stiffness / shared, none, mu, lower, upper
        )
        self.state = PatchesState(np.zeros((n, 2)), np.ones(n, dtype=bool), np.zeros(len(counts)))

    def __len__(self) -> int:
        """Return the number of contacts."""
        return len(self.names)

    @property
    def slips(self) -> Array:
        """Distance that the patch of each arm has slid, m, shape (n,)."""
        return self.state.slip[: len(self.arms)]

    def release(self, number: int) -> None:
        """Do nothing: a patch opens by the retreat of its arm."""

    def grasp(self, number: int, q: Array | None = None) -> None:
        """Count the slip of an arm's patch from now on."""
        self.state = self.state._replace(slip=changed(self.state.slip, number, 0.0))

    def act(self) -> float:
        """Add the wrenches at the state of the joints to theirs; return the power of ContactState, W."""
        now, forces = self._now(), self.bodies.F_J
        for wrench, (A, B) in zip(now.on_bodies, self.sides, strict=True):
            forces[A.joint] += A.X_WJ.actInv(wrench).vector
            forces[B.joint] -= B.X_WJ.actInv(wrench).vector
        return now.power

    def at(self, q: Array, v: Array) -> ContactState:
        """Return the contacts at a state."""
        self.bodies.move(q, v)
        return self.present()

    def present(self) -> ContactState:
        """Return the contacts at the state of the joints."""
        now = self._now()
        return ContactState(
            now.wrenches,
            np.array([wrench.vector for wrench in now.on_bodies]),
            np.add.reduceat(now.F[:, 2] > 0.0, self._starts, dtype=float),
            self.points.energy(now.x, self.state.roots, self.state.within),
            now.power,
        )

    def settle(self, q: Array) -> float:
        """Return the bristles to the friction cone after a step; the energy lost, J."""
        x, before = self.positions(q), self.state
        roots, within, slid = self.points.settled(x, before.roots, before.within)
        touching = np.add.reduceat(within & (x[:, 2] < 0.0), self._starts, dtype=float)
        slip = before.slip + np.add.reduceat(slid, self._starts) / np.maximum(touching, 1.0)
        lost = self.points.energy(x, before.roots, before.within)
        self.state = PatchesState(roots, within, slip)
        return lost - self.points.energy(x, roots, within)

    def damp(self, q: Array) -> None:
        """Set the damping, by the mobilities at a configuration."""
        model = self.tree.model
        M, bodies = symmetric(pin.crba(model, model.createData(), q)), self.bodies
        pin.computeJointJacobians(bodies.model, bodies.data, q)
        damping = np.zeros((2, len(self)))
        for number, ((A, B), contact) in enumerate(zip(self.sides, self._contacts, strict=True)):
            axes = pin.SE3(B.pose.rotation, A.pose.translation).toActionMatrixInverse()[:3]
            J = axes @ (bodies.jacobian(A) - bodies.jacobian(B))
            mobility = np.diagonal(J @ np.linalg.solve(M, J.T))
            k = np.array((contact.stiffness, contact.shear_stiffness))
            W = np.array((mobility[2], mobility[:2].mean()))
            damping[:, number] = 2.0 * contact.damping_ratio * np.sqrt(k / np.maximum(W, _TINY))
        normal, shear = damping[:, self.contact_of] / self._shared
        self.points = self.points._replace(damping=normal, shear_damping=shear)

    def loads(self, q: Array, loads: Array) -> Array:
        """Return the wrenches on the arms at rest about P as their own kinematics see it, shape (m, 6).

        Args:
            q: Configuration.
            loads: Wrenches of the arms with other grasps, about P in world axes, shape (m, 6).
        """
        return own_loads(loads, self.arms, self.payload_poses(q), self.at(q, self._rest).on_bodies)

    def payload_poses(self, q: Array) -> list[pin.SE3]:
        """Return X_WP as each arm with a patch sees it by its own kinematics at a configuration."""
        self.bodies.move(q, self._rest)
        grasps = self.cell.patches.values()
        return [
            A.pose * pin.SE3(grasp.matrix @ grasp.plane).inverse()
            for grasp, (A, _) in zip(grasps, self.sides, strict=False)
        ]

    def matrices(self, q: Array) -> tuple[Array, Array]:
        """Return stiffness and damping of the arms' patches while all points stick, shape (nv, nv) each.

        They are J^T k J and J^T c J, with J v the velocities of the points on A in the planes, and k and c
        those of springs and bristles; the load's prestress is not in them, and no table.
        """
        nv, bodies, points = self.tree.model.nv, self.bodies, self.points
        K, D = np.zeros((2, nv, nv))
        bodies.move(q, self._rest)
        pin.computeJointJacobians(bodies.model, bodies.data, q)
        k = np.stack((points.shear_stiffness, points.shear_stiffness, points.stiffness), axis=1)
        c = np.stack((points.shear_damping, points.shear_damping, points.damping), axis=1)
        for (A, B), part in zip(self.sides, self.parts[: len(self.arms)], strict=False):
            to_plane = pin.SE3(B.pose.rotation, A.pose.translation).toActionMatrixInverse()
            V, R_BA = (
                to_plane @ (bodies.jacobian(A) - bodies.jacobian(B)),
                B.pose.rotation.T @ A.pose.rotation,
            )
            for r, k_r, c_r in zip(self.on_body[part] @ R_BA.T, k[part], c[part], strict=True):
                J = V[:3] - pin.skew(r) @ V[3:]
                K += J.T * k_r @ J
                D += J.T * c_r @ J
        return K, D

    def _now(self) -> _Now:
        """Return the contacts at the state of the joints."""
        poses = [B.pose.actInv(A.pose) for A, B in self.sides]
        x, V = self._placed(poses), self.bodies.data.v
        V_BA = [  # relative twists about the planes' origins in their axes
            (X.act(A.X_JF.actInv(V[A.joint])) - B.X_JF.actInv(V[B.joint])).vector
            for X, (A, B) in zip(poses, self.sides, strict=True)
        ]
        v, w = np.array(V_BA)[self.contact_of].reshape(-1, 2, 3).swapaxes(0, 1)
        v_x = v + _cross(w, x)
        F, stored = self.points.forces(x, v_x, self.state.roots, self.state.within)
        about = np.concatenate((F, _cross(x, F)), axis=1)
        wrenches = np.add.reduceat(about, self._starts, axis=0)
        on_bodies = [
            B.pose.act(pin.Force(wrench)) for wrench, (_, B) in zip(wrenches, self.sides, strict=True)
        ]
        return _Now(x, F, wrenches, on_bodies, float((F * v_x).sum()) + stored)

    def positions(self, q: Array) -> Array:
        """Return the points in their planes, m, shape (n, 3)."""
        self.bodies.move(q, self._rest)
        return self._placed([B.pose.actInv(A.pose) for A, B in self.sides])

    def _placed(self, poses: list[Any]) -> Array:
        parts = zip(self.parts, poses, strict=True)
        return np.concatenate([self.on_body[part] @ X.rotation.T + X.translation for part, X in parts])


def _cross(a: Array, b: Array) -> Array:
    """Return a x b of each row, shape (n, 3); numpy's own is slow for few rows."""
    (a_x, a_y, a_z), (b_x, b_y, b_z) = a.T, b.T
    return np.stack((a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x), axis=1)
