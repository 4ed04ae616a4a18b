"""Contacts with dry friction: patches pressed on faces of the payload, and tables under it.

Both are one element, points of a body A on a bounded plane of a body B. Its wrench is a pure function of
relative pose and velocity (``ContactPoints``); ``ContactPatches`` has its places in the tree of a cell.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array, Mask
from coop_pin.chain.closure_set import ClosureError
from coop_pin.chain.contact_points import ContactPoints
from coop_pin.chain.equilibrium import reached
from coop_pin.chain.force_elements import ForceElements, as_seen
from coop_pin.chain.grasp_springs import changed
from coop_pin.description.cell import Cell
from coop_pin.description.contact import DryContact, corners
from coop_pin.model.cell_model import CellModel
from coop_pin.model.pinocchio_model import frame_id, symmetric
from coop_pin.spatial import weight_wrench
from coop_pin.spatial.internal_wrench import linkage_loads

_RESTS = 1e-3
"""Height above a table up to which a payload starts on it, m."""
_STEPS = 60
_SETTLED = 1e-13


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
        poses: pose of body A in the plane of each, shape (p, 4, 4).
        touching: number of points that bear a force, shape (p,).
        energy: energy in springs and bristles, J.
        power: power that neither moves bodies nor is stored, W: negative where the contacts dissipate.
    """

    wrench: Array
    on_bodies: Array
    poses: Array
    touching: Array
    energy: float
    power: float


class _Now(NamedTuple):
    """Contacts at the state of the joints.

    Attributes:
        poses: pose of body A in the plane of each.
        x: points in their planes, m, shape (n, 3).
        F: forces on them, N, shape (n, 3).
        wrenches: wrench on body A of each about the plane's origin in its axes.
        on_bodies: the same about the world's origin in world axes.
        power: Power of ContactState, W.
    """

    poses: list[Any]
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
        self._cell, self._tree, self._bodies, model = cell, tree, bodies, tree.model
        self.names = [*cell.patches, *cell.tables]
        self.arms = [list(cell.arms).index(name) for name in cell.patches]
        self._rest = np.zeros(model.nv)
        frames = [(frame_id(model, f"payload/{name}"), grasp.plane) for name, grasp in cell.patches.items()]
        self._sides = [
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
        self._of = np.repeat(np.arange(len(counts)), counts)
        self._starts = np.cumsum([0, *counts])[:-1]
        self._slices = [slice(a, a + n) for a, n in zip(self._starts.tolist(), counts, strict=True)]
        self._r = np.concatenate([np.zeros((0, 3)), *points])
        stiffness, shear_stiffness, mu = (
            np.array([getattr(contact, name) for contact in contacts])[self._of]
            for name in ("stiffness", "shear_stiffness", "mu")
        )
        # The corners of a payload have a second face, which is not on the table at the same time.
        share = np.where(np.arange(len(counts)) < len(self.arms), self._counts, self._counts / 2.0)
        self._shared = shared = share[self._of]
        n = len(self._r)
        none, (lower, upper) = np.zeros(n), np.swapaxes(np.reshape(bounds, (-1, 2, 2))[self._of], 0, 1)
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

    def gap(self, number: int, q: Array) -> ClosureError:
        """Return distance and angle of an arm's patch from its place on the face."""
        self._bodies.move(q, self._rest)
        A, B = self._sides[number]
        X = B.pose.actInv(A.pose)
        return ClosureError(float(np.linalg.norm(X.translation)), float(np.linalg.norm(pin.log3(X.rotation))))

    def act(self) -> float:
        """Add the wrenches at the state of the joints to theirs; return the power of ContactState, W."""
        now, forces = self._now(), self._bodies.F_J
        for wrench, (A, B) in zip(now.on_bodies, self._sides, strict=True):
            forces[A.joint] += A.X_WJ.actInv(wrench).vector
            forces[B.joint] -= B.X_WJ.actInv(wrench).vector
        return now.power

    def at(self, q: Array, v: Array) -> ContactState:
        """Return the contacts at a state."""
        self._bodies.move(q, v)
        return self.seen()

    def seen(self) -> ContactState:
        """Return the contacts at the state of the joints."""
        now = self._now()
        return ContactState(
            now.wrenches,
            np.array([wrench.vector for wrench in now.on_bodies]),
            np.array([X.homogeneous for X in now.poses]),
            np.add.reduceat(now.F[:, 2] > 0.0, self._starts, dtype=float),
            self.points.energy(now.x, self.state.roots, self.state.within),
            now.power,
        )

    def settle(self, q: Array) -> float:
        """Return the bristles to the friction cone after a step; the energy lost, J."""
        x, before = self._positions(q), self.state
        roots, within, slid = self.points.settled(x, before.roots, before.within)
        touching = np.add.reduceat(within & (x[:, 2] < 0.0), self._starts, dtype=float)
        slip = before.slip + np.add.reduceat(slid, self._starts) / np.maximum(touching, 1.0)
        lost = self.points.energy(x, before.roots, before.within)
        self.state = PatchesState(roots, within, slip)
        return lost - self.points.energy(x, roots, within)

    def damp(self, q: Array) -> None:
        """Set the damping, by the mobilities at a configuration."""
        model = self._tree.model
        M, bodies = symmetric(pin.crba(model, model.createData(), q)), self._bodies
        pin.computeJointJacobians(bodies.model, bodies.data, q)
        damping = np.zeros((2, len(self)))
        for number, ((A, B), contact) in enumerate(zip(self._sides, self._contacts, strict=True)):
            axes = pin.SE3(B.pose.rotation, A.pose.translation).toActionMatrixInverse()[:3]
            J = axes @ (bodies.jacobian(A) - bodies.jacobian(B))
            mobility = np.diagonal(J @ np.linalg.solve(M, J.T))
            k = np.array((contact.stiffness, contact.shear_stiffness))
            W = np.array((mobility[2], mobility[:2].mean()))
            damping[:, number] = 2.0 * contact.damping_ratio * np.sqrt(k / np.maximum(W, _TINY))
        normal, shear = damping[:, self._of] / self._shared
        self.points = self.points._replace(damping=normal, shear_damping=shear)

    def started(self, q: Array, squeeze: Array) -> Array:
        """Return the configuration at rest, near one with the tips at their grasps, that bears the load.

        A payload at the height of a table lies on it, and the arms bear their squeeze alone; else the patches
        bear the load as tip forces, by the split of the virtual linkage. The bristles are loaded.

        Args:
            q: Configuration.
            squeeze: Desired internal wrenches about P in payload axes, N and N m, shape (m, 6).
        """
        lies = self.lies(q)
        q = self.laid(q) if lies else q
        X_WP, cell = self._payload_pose(q), self._cell
        W = np.kron(np.eye(2), X_WP.rotation)
        loads = squeeze @ W.T
        if not lies:
            tips = np.array([grasp.matrix[:3, 3] for grasp in cell.grasps.values()]) @ X_WP.rotation.T
            loads += linkage_loads(tips) @ weight_wrench(cell.payload.mass, cell.gravity)
        for number, index in enumerate(self.arms):
            q = self._pressed(q, number, index, pin.Force(W.T @ loads[index]))
        return q

    def loads(self, q: Array, loads: Array) -> Array:
        """Return the wrenches on the arms at rest about P as their own kinematics see it, shape (m, 6).

        Args:
            q: Configuration.
            loads: Wrenches of the arms with other grasps, about P in world axes, shape (m, 6).
        """
        return as_seen(loads, self.arms, self.seen_poses(q), self.at(q, self._rest).on_bodies)

    def seen_poses(self, q: Array) -> list[pin.SE3]:
        """Return X_WP as each arm with a patch sees it by its own kinematics at a configuration."""
        self._bodies.move(q, self._rest)
        grasps = self._cell.patches.values()
        return [
            A.pose * pin.SE3(grasp.matrix @ grasp.plane).inverse()
            for grasp, (A, _) in zip(grasps, self._sides, strict=False)
        ]

    def matrices(self, q: Array) -> tuple[Array, Array]:
        """Return stiffness and damping of the arms' patches while all points stick, shape (nv, nv) each.

        They are J^T k J and J^T c J, with J v the velocities of the points on A in the planes, and k and c
        those of springs and bristles; the load's prestress is not in them, and no table.
        """
        nv, bodies, points = self._tree.model.nv, self._bodies, self.points
        K, D = np.zeros((2, nv, nv))
        bodies.move(q, self._rest)
        pin.computeJointJacobians(bodies.model, bodies.data, q)
        of_point = (
            (points.shear_stiffness, points.shear_stiffness, points.stiffness),
            (
                points.shear_damping,
                points.shear_damping,
                points.damping,
            ),
        )
        k, c = (np.stack(part, axis=1) for part in of_point)
        for (A, B), part in zip(self._sides, self._slices[: len(self.arms)], strict=False):
            to_plane = pin.SE3(B.pose.rotation, A.pose.translation).toActionMatrixInverse()
            V, R_BA = (
                to_plane @ (bodies.jacobian(A) - bodies.jacobian(B)),
                B.pose.rotation.T @ A.pose.rotation,
            )
            for r, k_r, c_r in zip(self._r[part] @ R_BA.T, k[part], c[part], strict=True):
                J = V[:3] - pin.skew(r) @ V[3:]
                K += J.T * k_r @ J
                D += J.T * c_r @ J
        return K, D

    def _now(self) -> _Now:
        """Return the contacts at the state of the joints."""
        poses = [B.pose.actInv(A.pose) for A, B in self._sides]
        x, V = self._placed(poses), self._bodies.data.v
        V_BA = [  # relative twists about the planes' origins in their axes
            (X.act(A.X_JF.actInv(V[A.joint])) - B.X_JF.actInv(V[B.joint])).vector
            for X, (A, B) in zip(poses, self._sides, strict=True)
        ]
        v, w = np.array(V_BA)[self._of].reshape(-1, 2, 3).swapaxes(0, 1)
        v_x = v + _cross(w, x)
        F, stored = self.points.forces(x, v_x, self.state.roots, self.state.within)
        about = np.concatenate((F, _cross(x, F)), axis=1)
        wrenches = np.add.reduceat(about, self._starts, axis=0)
        on_bodies = [
            B.pose.act(pin.Force(wrench)) for wrench, (_, B) in zip(wrenches, self._sides, strict=True)
        ]
        return _Now(poses, x, F, wrenches, on_bodies, float((F * v_x).sum()) + stored)

    def _positions(self, q: Array) -> Array:
        """Return the points in their planes, m, shape (n, 3)."""
        self._bodies.move(q, self._rest)
        return self._placed([B.pose.actInv(A.pose) for A, B in self._sides])

    def _placed(self, poses: list[Any]) -> Array:
        parts = zip(self._slices, poses, strict=True)
        return np.concatenate([self._r[part] @ X.rotation.T + X.translation for part, X in parts])

    def _payload_pose(self, q: Array) -> Any:
        self._bodies.move(q, self._rest)
        return self._bodies.side(self._tree.payload_frame).pose

    def lies(self, q: Array) -> bool:
        """Return whether a free payload is at the height of a table."""
        if self._tree.closed_by_tree or len(self.names) == len(self.arms):
            return False
        return bool(self._near_tables(self._positions(q)).any())

    def _near_tables(self, x: Array) -> Mask:
        """Return which points, m, shape (n, 3), are over a table and at its height."""
        within = self.points.settled(x, x[:, :2], np.ones(len(x), dtype=bool))[1]
        return within & (self._of >= len(self.arms)) & (x[:, 2] < _RESTS)

    def laid(self, q: Array) -> Array:
        """Return q with the payload moved until tables and weight balance, its bristles loaded."""
        model, joint, cell = self._tree.model, self._tree.payload_joint, self._cell
        entries = slice(int(model.idx_vs[joint]), int(model.idx_vs[joint]) + 6)
        weight = weight_wrench(cell.payload.mass, cell.gravity)[:3]
        on_tables = self._of >= len(self.arms)
        self._anchor(q)
        q = self._lowered(q, entries, float(np.linalg.norm(weight)))
        for _ in range(_STEPS):
            x = self._positions(q)
            self._bodies.F_J[:] = 0.0
            self.act()
            R = self._bodies.data.oMi[joint].rotation
            missing = self._bodies.force(q)[entries] + np.concatenate((R.T @ weight, np.zeros(3)))
            touches, K = on_tables & self.state.within & (x[:, 2] < 0.0), np.zeros((6, 6))
            for point in np.flatnonzero(touches):
                A, B = self._sides[self._of[point]]
                r, R_BA = self._r[point], B.pose.rotation.T @ A.pose.rotation
                G = R_BA @ np.hstack((np.eye(3), -pin.skew(r)))
                shear = self.points.shear_stiffness[point]
                K += G.T @ (np.array((shear, shear, self.points.stiffness[point]))[:, None] * G)
            step = np.zeros(model.nv)
            step[entries] = np.linalg.lstsq(K, missing, rcond=1e-9)[0]
            q = pin.integrate(model, q, step)
            if np.abs(step).max() < _SETTLED:
                break
        return q

    def _lowered(self, q: Array, entries: slice, weight: float) -> Array:
        """Return q with the payload moved along the normal of a table into it, as its weight would press."""
        x, model = self._positions(q), self._tree.model
        near = np.flatnonzero(self._near_tables(x))
        table = self._sides[self._of[near[0]]][1]
        depth = weight / self.points.stiffness[near].sum() + float(x[near, 2].min())
        step = np.zeros(model.nv)
        R_WJ = self._bodies.data.oMi[self._tree.payload_joint].rotation
        step[entries.start : entries.start + 3] = -R_WJ.T @ table.pose.rotation[:, 2] * depth
        return pin.integrate(model, q, step)

    def _anchor(self, q: Array) -> None:
        """Put the roots of all bristles below their points."""
        x = self._positions(q)
        roots, within, _ = self.points.settled(x, x[:, :2], np.ones(len(x), dtype=bool))
        self.state = self.state._replace(roots=roots, within=within)

    def _pressed(self, q: Array, number: int, index: int, load: Any) -> Array:
        """Return q with an arm moved until its patch has a wrench about P in payload axes on the arm."""
        name, (A, B), part = self.names[number], self._sides[number], self._slices[number]
        grasp = self._cell.patches[name]
        X_PF = pin.SE3(grasp.matrix @ grasp.plane)
        r, k = self._r[part], self.points.stiffness[part]
        expected, pose, bristles = X_PF.actInv(load).vector, np.zeros(3), np.zeros(3)
        points = ContactPoints(*(values[part] for values in self.points))
        shear, still, inside = (
            self.points.shear_stiffness[part],
            np.zeros((len(r), 3)),
            np.ones(len(r), dtype=bool),
        )
        spread = np.array(
            [
                k.sum(),
                *(k[:, None] * r[:, 1::-1] ** 2).sum(axis=0),
                shear.sum(),
                (shear * (r * r).sum(axis=1)).sum(),
            ]
        )
        pressed = expected[2] > 0.0
        for _ in range(_STEPS if pressed else 0):
            X = pin.SE3(pin.exp3(np.array((pose[1], pose[2], 0.0))), np.array((0.0, 0.0, -pose[0])))
            x = r @ X.rotation.T + X.translation
            z = bristles[:2] + bristles[2] * np.column_stack((-r[:, 1], r[:, 0]))
            F, _ = points.forces(x, still, x[:, :2] - z, inside)
            missing = expected - np.concatenate((F.sum(axis=0), np.cross(x, F).sum(axis=0)))
            change = np.array([missing[2], -missing[3], -missing[4]]) / spread[:3]
            pose = pose + change
            turn = np.array([*missing[:2] / spread[3], missing[5] / spread[4]])
            bristles = bristles - turn
            if max(np.abs(change).max(), np.abs(turn).max()) < _SETTLED:
                break
        X = pin.SE3(pin.exp3(np.array((pose[1], pose[2], 0.0))), np.array((0.0, 0.0, -pose[0])))
        self._bodies.move(q, self._rest)
        joints = self._tree.arms[index].v_slice
        q = reached(self._tree.model, self._bodies.data, q, A, joints, B.pose * X)
        x = self._positions(q)[part]
        z = bristles[:2] + bristles[2] * np.column_stack((-r[:, 1], r[:, 0]))
        roots, within = self.state.roots.copy(), self.state.within.copy()
        roots[part], within[part], _ = points.settled(x, x[:, :2] - z, inside)
        self.state = self.state._replace(roots=roots, within=within)
        return q


def _cross(a: Array, b: Array) -> Array:
    """Return a x b of each row, shape (n, 3); numpy's own is slow for few rows."""
    (a_x, a_y, a_z), (b_x, b_y, b_z) = a.T, b.T
    return np.stack((a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x), axis=1)
