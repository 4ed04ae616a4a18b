"""Reference plant: a second formulation of a cell in motion, written from the equations of the documentation.

It judges springs, contacts, partners, closures and the free payload, and shares no code with what computes
them in the package: of coop_pin it has the description of a cell, the Pinocchio model of each arm alone and
the motion that a partner wants. Arms and payload are separate bodies, each arm a tree of its own about its
own base, and they meet by wrenches at the tips:

    M_i(q_i) q_i'' + h_i(q_i, q_i') = T_i^T tau_i + friction_i + J_i^T F_i
    m (p'' - g) = f,    I w' + w x I w = n        (payload; f and n in world axes, about P)

The wrenches F_i come from springs, contacts or, at rigid grasps, from a dense solution of the closures. A
payload that is welded to the first arm with a rigid grasp has no coordinates of its own. ``replayed`` steps a
run again under the torques that it recorded, so that no law takes part.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.model.pinocchio_model import load_arm_model

LANDS_UP_TO = 1e-2
"""Depth up to which a point from beyond an edge lands on a plane, m; deeper ones pass below it."""
CORNERS_OF_A_FACE = 0.5
"""Part of a payload's corners that lie on a table at a time, and have its stiffness."""
WORKS = "work_actuation", "work_friction", "work_external", "work_payload_change", "work_grasps"


def se3(pose: Any) -> pin.SE3:
    """Return the pose of a description: position, and roll, pitch and yaw."""
    return pin.SE3(pin.rpy.rpyToMatrix(*pose.rpy), np.array(pose.xyz))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a x b; numpy's own is ten times as slow."""
    return np.array((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))


def wrench_about(force: np.ndarray, moment: np.ndarray, lever: np.ndarray) -> np.ndarray:
    """Return a wrench about another point, from which its own lies at a lever."""
    return np.concatenate((force, moment + cross(lever, force)))


def turned(R: np.ndarray, six: np.ndarray) -> np.ndarray:
    """Return six-vectors, or six rows, in other axes."""
    return np.concatenate((R @ six[:3], R @ six[3:]))


JOINT_ROWS = {"hinge": ((0, 1, 2), (0, 1)), "ball": ((0, 1, 2), ()), "cylinder": ((0, 1), (0, 1))}
"""Axes along which a joint holds positions, and those that it keeps across its z, by kind."""


def turned_to(axis: Any) -> np.ndarray:
    """Return a rotation whose z is along an axis."""
    z = np.array(axis) / np.linalg.norm(axis)
    return pin.Quaternion.FromTwoVectors(np.array((0.0, 0.0, 1.0)), z).matrix()


class Moving(NamedTuple):
    """Frame in motion: its pose, and velocity of its origin and angular velocity in world axes."""

    X: pin.SE3
    v: np.ndarray
    w: np.ndarray

    def fixed(self, X: pin.SE3) -> Moving:
        """Return a frame at a pose on the same body."""
        X_WF = self.X * X
        return Moving(X_WF, self.velocity_at(X_WF.translation), self.w)

    def velocity_at(self, p: np.ndarray) -> np.ndarray:
        """Return the velocity of the body's point at a place in the world."""
        return self.v + cross(self.w, p - self.X.translation)

    @property
    def twist(self) -> np.ndarray:
        """Velocity and angular velocity in the frame's own axes."""
        R = self.X.rotation.T
        return np.concatenate((R @ self.v, R @ self.w))


STANDING = Moving(pin.SE3.Identity(), np.zeros(3), np.zeros(3))
"""The world."""


# ------------------------------------------------------------ springs


class Spring:
    """Spring and damper that holds frame E at frame G: F = -[K_p p, vee(R G - G R^T)] - D V in axes of G."""

    def __init__(self, stiffness: Any, damping: Any) -> None:
        self.K, self.D = np.array(stiffness), np.array(damping)
        self.G = 0.5 * self.K[3:].sum() * np.eye(3) - np.diag(self.K[3:])

    def at(self, E: Moving, G: Moving) -> SimpleNamespace:
        """Return force and moment on E about its origin in world axes, with all that is recorded of them."""
        X, R_WG, p = G.X.actInv(E.X), G.X.rotation, E.X.translation
        RG = X.rotation @ self.G
        bent = RG - RG.T
        V = np.concatenate((R_WG.T @ (E.v - G.velocity_at(p)), R_WG.T @ (E.w - G.w)))
        still = -np.concatenate((self.K[:3] * X.translation, (bent[2, 1], bent[0, 2], bent[1, 0])))
        wrench = still - self.D * V
        in_world = turned(R_WG, wrench)
        return SimpleNamespace(
            force=in_world[:3],
            moment=in_world[3:],
            wrench=wrench,
            deflection=np.concatenate((X.translation, pin.log3(X.rotation))),
            energy=0.5 * float(X.translation @ (self.K[:3] * X.translation))
            + float(np.trace(self.G) - np.trace(RG)),
            dissipated=-float(V @ (self.D * V)),
        )


def critical(stiffness: np.ndarray, mobility: np.ndarray) -> np.ndarray:
    """Return damping with which each direction by itself does not swing: 2 sqrt(k / W)."""
    return np.array([2.0 * math.sqrt(k / w) for k, w in zip(stiffness, mobility, strict=True)])


# ------------------------------------------------------------ contacts with friction


class Contact:
    """Points of a body A on a bounded plane of a body B; see docs/concepts/friction-grasps.md."""

    def __init__(self, description: Any, points: np.ndarray, shares: float, bounds: Any) -> None:
        """Take stiffness, friction and bounds; shares is the number of points that have the stiffness."""
        self.points, self.mu = points, description.mu
        self.k, self.shear = description.stiffness / shares, description.shear_stiffness / shares
        self.ratio, self.shares, (self.lower, self.upper) = description.damping_ratio, shares, bounds
        self.c = self.shear_c = 0.0
        self.roots, self.within, self.slip = np.zeros((len(points), 2)), [False] * len(points), 0.0

    def start(self, A: Moving, B: Moving, roots: np.ndarray) -> None:
        """Start with roots of bristles; points within the bounds may touch."""
        self.roots, self.within = np.array(roots), [self.is_inside(x) for x in self.places(A, B)]

    def is_inside(self, x: np.ndarray) -> bool:
        """Return whether a point is within the bounds of the plane."""
        return bool(np.all(x[:2] >= self.lower) and np.all(x[:2] <= self.upper))

    def damp(self, along: float, across: float) -> None:
        """Set the damping, by the mobilities of A against B along the normal and across it."""
        self.c = 2.0 * self.ratio * math.sqrt(self.k * self.shares / along) / self.shares
        self.shear_c = 2.0 * self.ratio * math.sqrt(self.shear * self.shares / across) / self.shares

    def places(self, A: Moving, B: Moving) -> list[np.ndarray]:
        """Return the points in the plane's frame."""
        return [B.X.actInv(A.X.act(point)) for point in self.points]

    def at(self, A: Moving, B: Moving) -> SimpleNamespace:
        """Return force on A and its moment about the world's origin, with all that is recorded of them."""
        R, force, moment, wrench = B.X.rotation, np.zeros(3), np.zeros(3), np.zeros(6)
        touching, power, energy = 0, 0.0, 0.0
        for x, root, is_within in zip(self.places(A, B), self.roots, self.within, strict=True):
            depth = -x[2]
            if not is_within or depth <= 0.0:
                continue
            p = B.X.act(x)
            v = R.T @ (A.velocity_at(p) - B.velocity_at(p))
            N = max(0.0, self.k * depth - self.c * v[2])
            z = x[:2] - root
            friction = -(self.shear * z + self.shear_c * v[:2])
            size = float(np.hypot(*friction))
            if size > self.mu * N:
                friction = friction * (self.mu * N / size)
            f = np.array((*friction, N))
            wrench += np.concatenate((f, cross(x, f)))
            force += R @ f
            moment += cross(p, R @ f)
            touching += N > 0.0
            energy += 0.5 * self.k * depth**2 + 0.5 * self.shear * float(z @ z)
            power += float(f @ v) - self.k * depth * v[2] + self.shear * float(z @ v[:2])
        return SimpleNamespace(
            force=force, moment=moment, wrench=wrench, touching=touching, energy=energy, power=power
        )

    def settle(self, A: Moving, B: Moving) -> float:
        """Return the bristles to the cone after a step, which loses energy; return what it loses, J."""
        before, slid, touching = self.at(A, B).energy, 0.0, 0
        for j, x in enumerate(self.places(A, B)):
            depth = -x[2]
            self.within[j] = self.is_inside(x) and (self.within[j] or depth < LANDS_UP_TO)
            limit = self.mu * self.k * depth / self.shear if self.within[j] and depth > 0.0 else 0.0
            z = x[:2] - self.roots[j]
            length = float(np.hypot(*z))
            if length > limit:
                self.roots[j] = x[:2] - z * (limit / length)
                slid += length - limit if limit > 0.0 else 0.0
            touching += limit > 0.0
        self.slip += slid / max(touching, 1)
        return before - self.at(A, B).energy


def face_plane(press: str) -> pin.SE3:
    """Return the plane of a face in the grasp frame that is pressed along an axis: z points out of it."""
    axis, sign = "xyz".index(press[-1]), -1.0 if press.startswith("-") else 1.0
    e = np.eye(3)
    x, z = e[(axis + 1) % 3], -sign * e[axis]
    return pin.SE3(np.column_stack((x, cross(z, x), z)), np.zeros(3))


def face_bounds(payload: Any, X_PF: pin.SE3) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper corner in a plane of the face of the payload's box in which it lies."""
    corners = [X_PF.actInv(corner) for corner in box_corners(payload)]
    on_face = np.array([corner[:2] for corner in corners if abs(corner[2]) < 1e-9])
    assert len(on_face) == 4
    return on_face.min(axis=0), on_face.max(axis=0)


def box_corners(payload: Any) -> np.ndarray:
    """Return the corners of the payload's box in its axes."""
    X_PS, half = se3(payload.shape_pose), 0.5 * np.array(payload.size)
    signs = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return np.array([X_PS.act(half * sign) for sign in signs])


def pad_points(grasp: Any) -> np.ndarray:
    """Return the points of a pad in its plane: the middle, and a ring or the diagonals.

    Those of a rectangle are so far out that the mean distance of all is that of a point of the pad.
    """
    if grasp.radius is not None:
        around = [2.0 * math.pi * j / 8 for j in range(8)]
        ring = [(0.75 * grasp.radius * math.cos(a), 0.75 * grasp.radius * math.sin(a), 0.0) for a in around]
        return np.array([(0.0, 0.0, 0.0), *ring])
    a, b = 0.5 * np.array(grasp.size)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    # Mean distance over a quarter of the pad, in the polar coordinates of two triangles: r^2 / 2 dr dphi.
    mean = 0.0
    for near, far in ((a, b), (b, a)):
        edge = math.atan2(far, near)
        angles = 0.5 * edge * (nodes + 1.0)
        mean += 0.5 * edge * float(weights @ ((near / np.cos(angles)) ** 3 / 3.0))
    mean /= a * b
    out = 1.25 * mean / math.hypot(a, b)
    return np.array([(0.0, 0.0, 0.0), *((s * out * a, t * out * b, 0.0) for s in (-1, 1) for t in (-1, 1))])


# ------------------------------------------------------------ arms and payload


class Arm:
    """One arm by itself, in axes of its own base."""

    def __init__(self, description: Any) -> None:
        self.model, self.X_WB = load_arm_model(description), se3(description.base)
        self.nq, self.nv = self.model.nq, self.model.nv
        stated, self.model.armature = description.armature, np.zeros(self.nv)
        if hasattr(stated, "gear_ratio"):
            stated = np.square(stated.gear_ratio) * np.array(stated.inertia)
        self.rotors = np.diag(np.zeros(self.nv) + stated)
        self.data, self.tip = self.model.createData(), self.model.getFrameId(description.tip)
        self.lower = np.tril_indices(self.nv, -1)
        self.T = np.eye(self.nv) if description.drive is None else np.array(description.drive)
        friction = description.friction
        self.friction_axes = self.T
        if friction == "urdf":
            self.friction_axes = np.eye(self.nv)
            self.viscous, self.coulomb = self.model.damping.copy(), self.model.friction.copy()
            self.highest, self.speeds = self.coulomb, (0.05, 0.2)
        elif friction == "none":
            self.viscous = self.coulomb = self.highest = np.zeros(self.nv)
            self.speeds = 0.05, 0.2
        else:
            highest = friction.coulomb if friction.stiction is None else friction.stiction
            numbers = friction.viscous, friction.coulomb, highest
            self.viscous, self.coulomb, self.highest = (np.zeros(self.nv) + one for one in numbers)
            self.speeds = friction.coulomb_velocity, friction.stribeck_velocity

    def friction(self, v: np.ndarray) -> np.ndarray:
        """Return the generalised force of friction."""
        w, (coulomb, stribeck) = self.friction_axes @ v, self.speeds
        level = self.coulomb + (self.highest - self.coulomb) * np.exp(-((w / stribeck) ** 2))
        return -self.friction_axes.T @ (self.viscous * w + level * np.tanh(w / coulomb))

    def moved(self, q: np.ndarray, v: np.ndarray, gravity: np.ndarray) -> SimpleNamespace:
        """Return M, h, the tip with its Jacobian, and its acceleration where no joint accelerates."""
        model, data, R = self.model, self.data, self.X_WB.rotation
        model.gravity.linear = R.T @ gravity
        h = pin.rnea(model, data, q, v, np.zeros(self.nv)).copy()
        M = pin.crba(model, data, q).copy()
        M[self.lower] = M.T[self.lower]
        pin.forwardKinematics(model, data, q, v, np.zeros(self.nv))
        pin.updateFramePlacements(model, data)
        bias = pin.getFrameClassicalAcceleration(model, data, self.tip, pin.LOCAL_WORLD_ALIGNED).vector
        X_WE = self.X_WB * data.oMf[self.tip]
        J = pin.computeFrameJacobian(model, data, q, self.tip, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
        J = turned(R, J)
        twist = J @ v
        return SimpleNamespace(
            M=M + self.rotors,
            h=h,
            J=J,
            bias=turned(R, bias),
            tip=Moving(X_WE, twist[:3], twist[3:]),
        )

    def potential(self, q: np.ndarray, gravity: np.ndarray) -> float:
        """Return the potential energy, J; it is zero where the bodies are at the world's origin."""
        pin.forwardKinematics(self.model, self.data, q)
        bodies = zip(self.model.inertias.tolist()[1:], self.data.oMi.tolist()[1:], strict=True)
        return -sum(body.mass * float(gravity @ self.X_WB.act(X.act(body.lever))) for body, X in bodies)


def shifted(J: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Return the Jacobian, or a bias without centripetal part, of a body's point at r from another's."""
    return np.concatenate((J[:3] - pin.skew(r) @ J[3:], J[3:]))


class State(NamedTuple):
    """State of a reference plant: configuration of each arm and pose of the payload; all velocities."""

    q: tuple[np.ndarray, ...]
    X_WP: pin.SE3
    v: np.ndarray


def right_jacobian(u: np.ndarray) -> np.ndarray:
    """Return J with V = J u', the twist of X exp(u) in its axes: sum_k (-ad_u)^k / (k + 1)!."""
    A, term, J, k = -pin.Motion(u).action, np.eye(6), np.eye(6), 1
    while np.abs(term).max() > 1e-18:
        k += 1
        term = term @ A / k
        J = J + term
    return J


class ReferencePlant:
    """Arms that hold a payload, in motion under given torques of their drives."""

    def __init__(self, cell: Any, q: np.ndarray, payload: str = "welded") -> None:
        """Start at rest at a configuration of the package: all arms', then position and quaternion of P."""
        self.cell, self.names = cell, list(cell.arms)
        self.arms = [Arm(one) for one in cell.arms.values()]
        self.grasps = [se3(cell.grasps[name]) for name in self.names]
        kinds = [getattr(cell.grasps[name], "kind", "rigid") for name in self.names]
        self.carrier = kinds.index("rigid") if payload == "welded" and "rigid" in kinds else None
        closing = {"rigid", *JOINT_ROWS}
        self.closed = {i: X for i, X in enumerate(self.grasps) if kinds[i] in closing and i != self.carrier}
        self.axes = {
            i: (kind, turned_to(cell.grasps[self.names[i]].axis))
            for i, kind in enumerate(kinds)
            if kind in JOINT_ROWS
        }
        self.is_rigid = [kind == "rigid" for kind in kinds]
        self.mass, self.gravity = cell.payload.mass, np.array(cell.gravity)
        self.inertia = np.array(cell.payload.inertia_matrix)
        self.push, self.partners, self.work = np.zeros(6), list[Any](), dict.fromkeys(WORKS, 0.0)
        self.torques = [np.zeros(arm.nv) for arm in self.arms]
        edges = np.cumsum([0, *(arm.nv for arm in self.arms)]).tolist()
        self.columns = [slice(a, b) for a, b in itertools.pairwise(edges)]
        self.joints = slice(0, edges[-1])
        self.nv = edges[-1] + 6 * (self.carrier is None)
        self.springs, self.rests, self.opened = dict[int, Spring](), dict[int, pin.SE3](), set[int]()
        self.decay, self.decay_ratio = 10.0, 1.0  # of closure errors, rad/s and 1
        self.contacts: list[tuple[Contact, int | None, pin.SE3, pin.SE3]] = []
        self.state = State(*self._split(q), np.zeros(self.nv))
        self._start(kinds)

    def _split(self, q: np.ndarray) -> tuple[tuple[np.ndarray, ...], pin.SE3]:
        """Return the configuration of each arm and the pose of the payload."""
        edges = np.cumsum([0, *(arm.nq for arm in self.arms)]).tolist()
        parts = tuple(q[a:b].copy() for a, b in itertools.pairwise(edges))
        if self.carrier is None:
            return parts, pin.XYZQUATToSE3(q[edges[-1] :])
        return parts, self._carried(parts)

    def _carried(self, q: tuple[np.ndarray, ...]) -> pin.SE3:
        """Return the pose of a payload that is welded to an arm."""
        arm, X_PE = self.arms[self.carrier], self.grasps[self.carrier]
        pin.framesForwardKinematics(arm.model, arm.data, q[self.carrier])
        return arm.X_WB * arm.data.oMf[arm.tip] * X_PE.inverse()

    def _start(self, kinds: list[str]) -> None:
        """Make springs and contacts, with the damping that their ratios give at the start.

        Springs take arm and payload as free bodies. Contacts take the payload with the arm to which it is
        welded, if it is.
        """
        cell, X_WP, moved = self.cell, self.state.X_WP, self.moved(self.state)
        P = self.payload(self.state, moved)
        alone = np.zeros((6, 6))
        alone[:3, :3], alone[3:, 3:] = np.eye(3) / self.mass, np.linalg.inv(self._inertia(P))
        together = alone
        if self.carrier is not None:
            J = self._payload_jacobian(moved, P)[0][:, self.columns[self.carrier]]
            together = J @ np.linalg.inv(moved[self.carrier].M + J.T @ np.linalg.inv(alone) @ J) @ J.T
        for i, name in enumerate(self.names):
            arm, grasp, X_PG = moved[i], cell.grasps[name], self.grasps[i]
            lever = shifted(np.eye(6), arm.tip.X.translation - X_WP.translation)
            of_arm = arm.J @ np.linalg.inv(arm.M) @ arm.J.T
            if kinds[i] == "compliant":
                axes = np.kron(np.eye(2), (X_WP * X_PG).rotation)
                mobility = np.diag(axes.T @ (of_arm + lever @ alone @ lever.T) @ axes)
                stated = grasp.damping_ratio * critical(np.array(grasp.stiffness), mobility)
                self.springs[i] = Spring(grasp.stiffness, stated if grasp.damping is None else grasp.damping)
                self.rests[i] = X_PG
            elif kinds[i] == "patch":
                X_GF, points = face_plane(grasp.press), pad_points(grasp)
                half = None if grasp.face is None else 0.5 * np.array(grasp.face)
                bounds = face_bounds(cell.payload, X_PG * X_GF) if half is None else (-half, half)
                contact = Contact(grasp, points, len(points), bounds)
                self._damp(contact, X_WP * X_PG * X_GF, of_arm + lever @ together @ lever.T)
                self.contacts.append((contact, i, X_GF, X_PG * X_GF))
        for table in cell.tables.values():
            points, half = box_corners(cell.payload), 0.5 * np.array(table.size)
            contact = Contact(table, points, CORNERS_OF_A_FACE * len(points), (-half, half))
            self._damp(contact, se3(table), together)
            self.contacts.append((contact, None, pin.SE3.Identity(), se3(table)))

    @staticmethod
    def _damp(contact: Contact, plane: pin.SE3, mobility: np.ndarray) -> None:
        x, y, z = np.diag(plane.rotation.T @ mobility[:3, :3] @ plane.rotation)
        contact.damp(z, 0.5 * (x + y))

    # ------------------------------------------------------------ motion

    def moved(self, state: State) -> list[SimpleNamespace]:
        parts = zip(self.arms, state.q, self.columns, strict=True)
        return [arm.moved(q, state.v[columns], self.gravity) for arm, q, columns in parts]

    def payload(self, state: State, moved: list[SimpleNamespace]) -> Moving:
        """Return the payload in motion."""
        if self.carrier is None:
            R, twist = state.X_WP.rotation, state.v[-6:]
            return Moving(state.X_WP, R @ twist[:3], R @ twist[3:])
        return moved[self.carrier].tip.fixed(self.grasps[self.carrier].inverse())

    def motion(self, t: float, state: State) -> SimpleNamespace:
        """Return accelerations, wrenches, powers and energies at a time and a state."""
        moved = self.moved(state)
        P = self.payload(state, moved)
        p, tips = P.X.translation, [one.tip.X.translation for one in moved]
        springs = {i: spring.at(moved[i].tip, P.fixed(self.rests[i])) for i, spring in self.springs.items()}
        holding = [(i, one) for i, one in springs.items() if i not in self.opened]
        contacts = [row[0].at(*self.sides(row, moved, P)) for row in self.contacts]
        partners = [self._partner(each, t, P) for each in self.partners]
        outside = sum((one.about_P for one in partners), self.push)
        by_tables, on_arms = np.zeros(6), [np.zeros(6) for _ in tips]  # about P; about the tips
        for i, one in holding:
            on_arms[i] += np.concatenate((one.force, one.moment))
        for one, (_, i, *_) in zip(contacts, self.contacts, strict=True):
            if i is None:
                by_tables += wrench_about(one.force, one.moment, -p)
            else:
                on_arms[i] += wrench_about(one.force, one.moment, -tips[i])
        held = [wrench_about(F[:3], F[3:], tip - p) for F, tip in zip(on_arms, tips, strict=True)]
        tau = [arm.T.T @ torque for arm, torque in zip(self.arms, self.torques, strict=True)]
        losses = [arm.friction(state.v[cols]) for arm, cols in zip(self.arms, self.columns, strict=True)]
        rows = zip(tau, losses, moved, on_arms, strict=True)
        forces = [drives + loss - one.h + one.J.T @ F for drives, loss, one, F in rows]
        a, closing = self._accelerations(state, moved, P, forces, outside + by_tables - sum(held))
        for i, at_tip in closing.items():
            F = turned(moved[i].tip.X.rotation, at_tip)
            held[i] = wrench_about(F[:3], F[3:], tips[i] - p)
        inertia = self._inertia(P)
        if self.carrier is not None:
            J, b = self._payload_jacobian(moved, P)
            gained = J @ a + b
            gained = np.concatenate(
                (self.mass * gained[:3], inertia @ gained[3:] + cross(P.w, inertia @ P.w))
            )
            weight = np.concatenate((self.mass * self.gravity, np.zeros(3)))
            held[self.carrier] = outside + by_tables + weight - gained - sum(held)
        rates = state.v[self.joints]
        return SimpleNamespace(
            a=a,
            payload=P,
            tips=[one.tip for one in moved],
            held=held,
            springs=springs,
            contacts=contacts,
            partners=partners,
            outside=outside,
            powers={
                "work_actuation": float(np.concatenate(tau) @ rates),
                "work_friction": float(np.concatenate(losses) @ rates),
                "work_external": float(outside @ np.concatenate((P.v, P.w))),
                "work_grasps": sum(one.dissipated for _, one in holding) + sum(one.power for one in contacts),
            },
            elastic=sum(one.energy for _, one in holding) + sum(one.energy for one in contacts),
        )

    def _inertia(self, P: Moving) -> np.ndarray:
        """Return the payload's inertia in world axes."""
        return P.X.rotation @ self.inertia @ P.X.rotation.T

    def sides(self, row: Any, moved: list[SimpleNamespace], P: Moving) -> tuple[Moving, Moving]:
        """Return body A and the plane of body B of a contact."""
        _, arm, X_A, X_B = row
        return (P, STANDING.fixed(X_B)) if arm is None else (moved[arm].tip.fixed(X_A), P.fixed(X_B))

    def _partner(self, partner: Any, t: float, P: Moving) -> SimpleNamespace:
        """Return spring and damper of a partner, with the wrench about P."""
        target, X_PH = partner.motion.at(t), se3(partner.handle)
        body = Moving(pin.SE3(target.X_WP_d), target.V_WP_d[:3], target.V_WP_d[3:])
        handle = P.fixed(X_PH)
        one = Spring(partner.stiffness, partner.damping).at(handle, body.fixed(X_PH))
        one.about_P = wrench_about(one.force, one.moment, handle.X.translation - P.X.translation)
        return one

    def _payload_jacobian(self, moved: list[SimpleNamespace], P: Moving) -> tuple[np.ndarray, np.ndarray]:
        """Return J and b of [p'', w'] = J a + b, in world axes."""
        J, b = np.zeros((6, self.nv)), np.zeros(6)
        if self.carrier is None:
            R = P.X.rotation
            J[:3, -6:-3], J[3:, -3:] = R, R
            b[:3] = cross(P.w, P.v)  # the twist's own axes turn
            return J, b
        arm = moved[self.carrier]
        r = P.X.translation - arm.tip.X.translation
        J[:, self.columns[self.carrier]] = shifted(arm.J, r)
        b = shifted(arm.bias, r)
        b[:3] += cross(P.w, cross(P.w, r))
        return J, b

    def _accelerations(
        self, state: State, moved: list[SimpleNamespace], P: Moving, forces: list[np.ndarray], F: np.ndarray
    ) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Return the accelerations and the wrenches of closures on the tips in their axes."""
        M, right = np.zeros((self.nv, self.nv)), np.zeros(self.nv)
        for arm, columns, force in zip(moved, self.columns, forces, strict=True):
            M[columns, columns], right[columns] = arm.M, force
        J, b = self._payload_jacobian(moved, P)
        inertia = self._inertia(P)
        six = np.zeros((6, 6))
        six[:3, :3], six[3:, 3:] = self.mass * np.eye(3), inertia
        weight = np.concatenate((self.mass * self.gravity, -cross(P.w, inertia @ P.w)))
        M += J.T @ six @ J
        right += J.T @ (F + weight - six @ b)
        if not self.closed:
            return np.linalg.solve(M, right), {}
        rows, drift, wanted, maps = self._closures(state, moved, P)
        free, mobility = np.linalg.solve(M, right), rows @ np.linalg.solve(M, rows.T)
        multipliers = np.linalg.lstsq(mobility, wanted - drift - rows @ free, rcond=1e-11)[0]
        a = free + np.linalg.solve(M, rows.T @ multipliers)
        parts = np.split(multipliers, np.cumsum([each.shape[1] for each in maps])[:-1])
        return a, {i: each @ part for i, each, part in zip(self.closed, maps, parts, strict=True)}

    def _closures(
        self, state: State, moved: list[SimpleNamespace], P: Moving
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
        """Return J and drift of the closures' e'' = J a + drift, and the e'' that Baumgarte's terms want.

        Beside them maps from the multipliers to the wrench on the tip of each in its axes.
        """
        J_P, b_P = self._payload_jacobian(moved, P)
        rows, drift, wanted, maps = [], [], [], []
        omega, zeta = self.decay, self.decay_ratio
        for i, X_PG in self.closed.items():
            tip, J_E = moved[i].tip, np.zeros((6, self.nv))
            J_E[:, self.columns[i]] = moved[i].J
            if i in self.axes:
                J, b, e, on_tip = self._joint(i, moved[i], P, P.fixed(X_PG), J_E, J_P, b_P)
                rows.append(J)
                drift.append(b)
                wanted.append(-2.0 * zeta * omega * (J @ state.v) - omega**2 * e)
                maps.append(np.kron(np.eye(2), tip.X.rotation.T) @ on_tip)
                continue
            maps.append(np.eye(6))
            E, to_tip = tip.X, np.kron(np.eye(2), tip.X.rotation.T)
            to_payload = np.kron(np.eye(2), P.X.rotation.T)
            X_EP = E.actInv(P.X)
            V_E, V_P = tip.twist, X_EP.toActionMatrix() @ P.twist
            # Rates of twists in own axes: the classical acceleration less w x v.
            A_E = to_tip @ moved[i].bias - np.concatenate((cross(V_E[3:], V_E[:3]), np.zeros(3)))
            A_P = to_payload @ b_P - np.concatenate((cross(P.twist[3:], P.twist[:3]), np.zeros(3)))
            J = to_tip @ J_E - X_EP.toActionMatrix() @ to_payload @ J_P
            between = pin.Motion(V_E - V_P).cross(pin.Motion(V_P)).vector
            rows.append(J)
            drift.append(A_E - X_EP.toActionMatrix() @ A_P + between)
            e = -pin.log6(E.actInv(P.X * X_PG)).vector
            wanted.append(-2.0 * zeta * omega * (J @ state.v) - omega**2 * e)
        return np.concatenate(rows), np.concatenate(drift), np.concatenate(wanted), maps

    def _joint(
        self, arm: int, at: Any, P: Moving, G: Moving, J_E: np.ndarray, J_P: np.ndarray, b_P: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Return J, drift and error of a joint between tip E and grasp G, and its unit wrenches on the tip.

        With d an axis that is held, r from G to E and z the axis on the payload: d . r = 0, and d . z = 0.
        """
        kind, R_EC = self.axes[arm]
        (slides, turns), E = JOINT_ROWS[kind], at.tip
        lever = G.X.translation - P.X.translation
        J_G, b_G = shifted(J_P, lever), shifted(b_P, lever)
        b_G[:3] += cross(P.w, cross(P.w, lever))
        (a_E, alpha_E), (a_G, alpha_G) = np.split(at.bias, 2), np.split(b_G, 2)
        R, z = E.X.rotation @ R_EC, G.X.rotation @ R_EC[:, 2]
        w, alpha = (E.w, alpha_E) if turns else (np.zeros(3), np.zeros(3))  # those of a ball do not turn
        r, between = E.X.translation - G.X.translation, E.v - G.v
        rows, drift, error, wrenches = [], [], [], []
        for k in slides:
            d = R[:, k]
            rate = cross(w, d)
            leverage = cross(d, r) if turns else np.zeros(3)
            rows.append(d @ (J_E[:3] - J_G[:3]) + leverage @ J_E[3:])
            second = cross(alpha, d) + cross(w, rate)
            drift.append(d @ (a_E - a_G) + 2.0 * rate @ between + second @ r)
            error.append(d @ r)
            wrenches.append(np.concatenate((d, leverage)))
        for k in turns:
            d = R[:, k]
            n, rate = cross(d, z), cross(cross(E.w, d), z) + cross(d, cross(G.w, z))
            rows.append(n @ (J_E[3:] - J_G[3:]))
            drift.append(n @ (alpha_E - alpha_G) + rate @ (E.w - G.w))
            error.append(d @ z)
            wrenches.append(np.concatenate((np.zeros(3), n)))
        return np.array(rows), np.array(drift), np.array(error), np.array(wrenches).T

    # ------------------------------------------------------------ steps

    def displaced(self, state: State, u: np.ndarray, v: np.ndarray) -> State:
        """Return the state with other velocities whose configuration is displaced by an increment."""
        q = tuple(
            pin.integrate(arm.model, part, u[columns])
            for arm, part, columns in zip(self.arms, state.q, self.columns, strict=True)
        )
        if self.carrier is not None:
            return State(q, self._carried(q), v)
        return State(q, state.X_WP * pin.exp6(pin.Motion(u[-6:])), v)

    def _increment_rate(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return u' with which the displaced configuration moves with velocities v."""
        rate = v.copy()
        if self.carrier is None:
            rate[-6:] = np.linalg.solve(right_jacobian(u[-6:]), v[-6:])
        return rate

    def step(self, t: float, h: float) -> None:
        """Integrate over h seconds by the classical Runge-Kutta method on increments (Munthe-Kaas)."""
        start, k, a, powers = self.state, list[np.ndarray](), list[np.ndarray](), []
        state, u = start, np.zeros(self.nv)
        for node, ahead in ((0.0, 0.5), (0.5, 0.5), (0.5, 1.0), (1.0, None)):
            motion = self.motion(t + node * h, state)
            k.append(self._increment_rate(u, state.v))
            a.append(motion.a)
            powers.append(motion.powers)
            if ahead is not None:
                u = ahead * h * k[-1]
                state = self.displaced(start, u, start.v + ahead * h * a[-1])
        mean = [(first + 2.0 * (second + third) + last) * (h / 6.0) for first, second, third, last in (k, a)]
        self.state = self.displaced(start, mean[0], start.v + mean[1])
        for name in powers[0]:
            first, second, third, last = (power[name] for power in powers)
            self.work[name] += h / 6.0 * (first + 2.0 * second + 2.0 * third + last)
        moved = self.moved(self.state) if self.contacts else []
        for row in self.contacts:
            self.work["work_grasps"] -= row[0].settle(
                *self.sides(row, moved, self.payload(self.state, moved))
            )

    # ------------------------------------------------------------ events

    def energies(self, motion: SimpleNamespace) -> tuple[float, float, float]:
        """Return kinetic, potential and elastic energy at the present state, J."""
        state, P = self.state, motion.payload
        kinetic = 0.5 * (self.mass * float(P.v @ P.v) + float(P.w @ self._inertia(P) @ P.w))
        potential = -self.mass * float(self.gravity @ P.X.translation)
        for arm, q, columns, one in zip(self.arms, state.q, self.columns, self.moved(state), strict=True):
            kinetic += 0.5 * float(state.v[columns] @ one.M @ state.v[columns])
            potential += arm.potential(q, self.gravity)
        return kinetic, potential, motion.elastic

    def happens(self, change: Callable[[ReferencePlant], None]) -> None:
        """Change the plant; the energy that this adds counts as work."""
        before = sum(self.energies(self.motion(0.0, self.state)))
        change(self)
        self.work["work_payload_change"] += sum(self.energies(self.motion(0.0, self.state))) - before

    def open(self, arm: int) -> None:
        """Open the grasp of an arm."""
        self.opened.add(arm)
        self.closed.pop(arm, None)

    def close(self, arm: int, rest: str, distance: float, angle: float) -> None:
        """Close the grasp of an arm that is near enough, as found or at its nominal pose."""
        motion = self.motion(0.0, self.state)
        found = motion.payload.X.actInv(motion.tips[arm].X)
        gap = self.grasps[arm].actInv(found)
        if np.linalg.norm(gap.translation) > distance or np.linalg.norm(pin.log3(gap.rotation)) > angle:
            return
        self.opened.discard(arm)
        if arm in self.springs:
            self.rests[arm] = self.grasps[arm] if rest == "nominal" else found
            return
        self.closed = {i: self.closed.get(i, found) for i in sorted({*self.closed, arm})}
        self._meet()

    def _meet(self) -> None:
        """Make the velocities meet at all closures, by an impulse: M (v+ - v-) = J^T L and J v+ = 0."""
        state, moved = self.state, self.moved(self.state)
        P = self.payload(state, moved)
        M = np.zeros((self.nv, self.nv))
        for arm, columns in zip(moved, self.columns, strict=True):
            M[columns, columns] = arm.M
        J, _ = self._payload_jacobian(moved, P)
        M += self.mass * J[:3].T @ J[:3] + J[3:].T @ self._inertia(P) @ J[3:]
        rows = self._closures(state, moved, P)[0]
        spread = np.linalg.solve(M, rows.T)
        impulse = np.linalg.lstsq(rows @ spread, -rows @ state.v, rcond=1e-11)[0]
        self.state = state._replace(v=state.v + spread @ impulse)

    # ------------------------------------------------------------ what is recorded

    def observed(self, t: float) -> dict[str, Any]:
        """Return what a run records at a tick, by its names there."""
        state, motion = self.state, self.motion(t, self.state)
        P, m = motion.payload, len(self.arms)
        kinetic, potential, elastic = self.energies(motion)
        sample = {
            "configuration": np.concatenate(state.q),
            "velocity": state.v,
            "payload_position": P.X.translation,
            "payload_quaternion": pin.Quaternion(P.X.rotation).coeffs(),
            "payload_twist": np.concatenate((P.v, P.w)),
            "tip_position": np.array([tip.X.translation for tip in motion.tips]),
            "interaction_wrench": np.array(motion.held),
            "external_wrench": motion.outside,
            "kinetic_energy": kinetic,
            "potential_energy": potential,
            **{name: self.work[name] for name in WORKS[:-1]},
        }
        if self.springs or self.contacts:
            sample["elastic_energy"], sample["work_grasps"] = elastic, self.work["work_grasps"]
        if self.springs:
            rows = {"grasp_deflection": np.full((m, 6), np.nan), "grasp_wrench": np.full((m, 6), np.nan)}
            for i, one in motion.springs.items():
                rows["grasp_deflection"][i] = one.deflection
                rows["grasp_wrench"][i] = one.wrench if i not in self.opened else 0.0
            sample |= rows
        if self.contacts:
            sample["patch_wrench"] = np.array([one.wrench for one in motion.contacts])
            sample["patch_points"] = np.array([float(one.touching) for one in motion.contacts])
            sample["patch_slip"] = np.array([row[0].slip for row in self.contacts])
        for one in motion.partners:
            sample["partner_wrench"] = one.about_P
            sample["partner_deflection"], sample["partner_energy"] = one.deflection, one.energy
        return sample


# ------------------------------------------------------------ a run again


Change = Callable[[ReferencePlant], None]


def changes(events: Any, arms: list[str]) -> list[tuple[float, Change]]:
    """Return what events do to a plant, with their times."""
    found = list[tuple[float, Change]]()
    for event in events:
        match event.kind:
            case "payload-change":

                def change(plant: ReferencePlant, mass: float = event.mass) -> None:
                    plant.inertia, plant.mass = plant.inertia * (mass / plant.mass), mass

                found.append((event.time, change))
            case "gravity-turn":
                gravity = np.array(event.gravity)
                found.append((event.time, lambda plant, g=gravity: setattr(plant, "gravity", g)))
            case "wrench-pulse":
                for time, sign in ((event.time, 1.0), (event.time + event.duration, -1.0)):
                    push = sign * np.array(event.wrench)
                    found.append((time, lambda plant, F=push: setattr(plant, "push", plant.push + F)))
            case "partner":
                found.append((event.time, lambda plant, one=event: plant.partners.append(one)))
                end = event.time + event.duration
                found.append((end, lambda plant, one=event: plant.partners.remove(one)))
            case "release":
                arm = arms.index(event.arm)
                found.append((event.time, lambda plant, arm=arm: plant.open(arm)))
            case "grasp":
                how = arms.index(event.arm), event.rest, event.tolerance, event.angle_tolerance
                found.append((event.time, lambda plant, how=how: plant.close(*how)))
                found.append((event.time + event.duration, lambda _: None))  # a step ends there, too
            case other:
                raise NotImplementedError(other)
    return sorted(found, key=lambda row: row[0])


def replayed(
    scenario: Any, data: Any, bristles: Any = None
) -> Iterator[tuple[dict[str, Any], ReferencePlant]]:
    """Yield at each tick what a run of a scenario records, by the reference plant under the torques of a run.

    Args:
        scenario: the scenario, whose drives hold their torques over a tick.
        data: the run's record: its start and its torques are read.
        bristles: roots of the bristles at the start, in the order of patches and tables, shape (n, 2).
    """
    clock, cell = scenario.clock, scenario.cell
    period, steps = 1.0 / clock.rate_hz, clock.steps_per_tick
    plant, first = ReferencePlant(cell, data["configuration"].values[0], scenario.plant.payload), 0
    decay = scenario.plant.stabilisation
    plant.decay, plant.decay_ratio = decay.frequency, decay.damping_ratio
    moved = plant.moved(plant.state)
    for row in plant.contacts:
        last = first + len(row[0].points)
        row[0].start(*plant.sides(row, moved, plant.payload(plant.state, moved)), bristles[first:last])
        first = last
    waiting, near = changes(scenario.events, plant.names), 1e-9 * period / steps
    torques = data["torque"].values
    for tick in range(len(torques)):
        start, end = tick * period, (tick + 1) * period
        while waiting and waiting[0][0] <= start + near:
            plant.happens(waiting.pop(0)[1])
        plant.torques = [row[: arm.nv] for row, arm in zip(torques[tick], plant.arms, strict=True)]
        yield plant.observed(start), plant
        if tick + 1 == len(torques):
            return
        edges = [start + j * period / steps for j in range(steps)] + [end]
        cuts = [time for time, _ in waiting if start + near < time < end - near]
        edges += [time for time in cuts if min(abs(time - edge) for edge in edges) > near]
        edges.sort()
        for left, right in itertools.pairwise(edges):
            while waiting and waiting[0][0] <= left + near:
                plant.happens(waiting.pop(0)[1])
            plant.step(left, right - left)
