"""MuJoCo model of a cell's tree: its joints, its inertias, and soft equalities for each loop closure."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.errors import needs_extra
from coop_pin.description.cell.closure import Closure
from coop_pin.description.plant import MujocoOptions
from coop_pin.model.pinocchio_model import frame_id

_LEAST = "1e-14"
"""Mass, kg, and inertia, kg m^2, of links that have none: MuJoCo refuses moving bodies without any."""
_INTEGRATORS = {"rk4": "RK4", "semi-implicit-euler": "Euler"}
_SAME = 1e-9
_FREE = 6
"""Degrees of freedom of a free joint, whose linear velocity MuJoCo has in axes of the world."""
_EQUALITIES = {"full": ("weld", (0.0,)), "point": ("connect", (0.0,)), "axis": ("connect", (-0.02, 0.02))}
"""What holds the rows of a closure, and where on z of C, as parts of the scale of rotations, m: two points of
an axis hold a hinge. Their rows along it are one row twice, which their softness shares."""


class WeldForces(NamedTuple):
    """Accelerations and forces of closures at a state.

    Attributes:
        a: acceleration of the tree, shape (nv,).
        wrenches: wrench on frame a of each closure, about C in its axes.
    """

    a: Array
    wrenches: list[pin.Force]


def unlike_mujoco(tree: pin.Model) -> str:
    """Return what of a tree MuJoCo does not have; empty if it has all."""
    for name, joint, inertia in list(zip(tree.names, tree.joints, tree.inertias, strict=True))[1:]:
        if joint.nv not in (1, _FREE):
            return f"joint {name!r} is neither a single turn nor a slide"
        least, middle, largest = np.linalg.eigvalsh(inertia.inertia)
        if least + middle < largest - _SAME * abs(largest):
            return f"the inertia behind joint {name!r} breaks the triangle inequality"
    return ""


def mjcf(
    tree: pin.Model,
    closures: Sequence[Closure],
    options: MujocoOptions,
    *,
    step: float,
    integrator: str = "rk4",
    start: Array | None = None,
) -> str:
    """Return the model of a cell's tree as MJCF; ``unlike_mujoco`` says what cannot be.

    Bodies stand in the frames of the joints and have their names, frames that are held, and P, are sites.
    Contacts and limits are off; torques are generalised forces, ``qfrc_applied``.

    Args:
        tree: Pinocchio tree.
        closures: Closures of rows "full", which are welds, "point", a connect, or "axis", two connects.
        options: Stiffness of the closures.
        step: Time step, s.
        integrator: Integrator, as of PlantOptions.
        start: Configuration of key frame "start", shape (nq,).
    """
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian", autolimits="false", boundmass=_LEAST, boundinertia=_LEAST)
    solver = {"jacobian": "dense", "tolerance": "1e-15", "iterations": "200"}
    motion = {"timestep": repr(step), "integrator": _INTEGRATORS[integrator]}
    option = ET.SubElement(root, "option", motion | solver, gravity=_text(tree.gravity.linear))
    ET.SubElement(option, "flag", dict.fromkeys(("contact", "limit"), "disable"))
    bodies = [ET.SubElement(root, "worldbody")]
    data = tree.createData()
    pin.forwardKinematics(tree, data, pin.neutral(tree), np.zeros(tree.nv))
    for number in range(1, tree.njoints):
        parent, name = bodies[tree.parents[number]], str(tree.names[number])
        body = ET.SubElement(parent, "body", _pose(tree.jointPlacements[number]), name=name)
        if tree.nvs[number] == _FREE:
            ET.SubElement(body, "freejoint", name=name)
        else:
            S = np.asarray(data.joints[number].S).ravel()
            kind, axis = ("hinge", S[3:]) if S[3:].any() else ("slide", S[:3])
            rotor = tree.armature[tree.idx_vs[number]]
            stated = {"armature": _text([rotor])} if rotor else {}
            ET.SubElement(body, "joint", stated, name=name, type=kind, axis=_text(axis))
        moments, pose = _principal(tree.inertias[number])
        mass = _text([tree.inertias[number].mass])
        ET.SubElement(body, "inertial", _pose(pose), mass=mass, diaginertia=_text(moments))
        bodies.append(body)
    _add_site(tree, bodies, "payload", "payload", pin.SE3.Identity())
    equalities = ET.SubElement(root, "equality") if closures else root
    softness = {"solref": _text((options.time_constant * step, 1.0))}
    softness["solimp"] = _text((options.impedance, options.impedance, 1e-3, 0.5, 2.0))
    for closure in closures:
        kind, points = _EQUALITIES[str(closure.rows)]
        scale = {"torquescale": _text([options.torque_scale])} if kind == "weld" else {}
        for number, point in enumerate(points):
            X_CP = pin.SE3(np.eye(3), np.array((0.0, 0.0, point * options.torque_scale)))
            equality = ET.SubElement(equalities, kind, softness | scale)
            for side, frame, X in (
                ("1", closure.frame_a, closure.X_AC),
                ("2", closure.frame_b, closure.X_BC),
            ):
                name, X_FC = (
                    f"{frame}.{number}" if point else frame,
                    np.eye(4) if X is None else np.asarray(X),
                )
                equality.set(f"site{side}", name)
                _add_site(tree, bodies, name, frame, pin.SE3(X_FC) * X_CP)
    if start is not None:
        qpos = _text(_coordinates(tree, start))
        ET.SubElement(ET.SubElement(root, "keyframe"), "key", name="start", qpos=qpos)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _add_site(tree: pin.Model, bodies: list[ET.Element], name: str, on: str, X: pin.SE3) -> None:
    """Add a site at a pose X in a frame of the tree."""
    frame = tree.frames[frame_id(tree, on)]
    ET.SubElement(bodies[frame.parentJoint], "site", _pose(frame.placement * X), name=name)


def mujoco_module() -> Any:
    """Return MuJoCo.

    Raises:
        MissingExtraError: it is not installed.
    """
    with needs_extra("mujoco", "mujoco", "for the engine 'mujoco'"):
        import mujoco
    return mujoco


class MujocoModel:
    """Tree with soft closures in MuJoCo: accelerations and forces of closures.

    Its free joint, that of a payload, has the linear velocity in axes of the world: R v for Pinocchio's v,
    with the acceleration R (a + w x v) and the force R f.
    """

    def __init__(
        self, tree: pin.Model, closures: Sequence[Closure], options: MujocoOptions, *, step: float
    ) -> None:
        """Compile a model.

        Args:
            tree: Pinocchio tree, which may change its inertias.
            closures: Closures, as of ``mjcf``.
            options: Stiffness of the closures.
            step: Time step, s.

        Raises:
            MissingExtraError: mujoco is not installed.
        """
        self._mujoco, self._tree, self._options = mujoco_module(), tree, options
        text, ids = mjcf(tree, closures, options, step=step), itertools.count()
        self.model = self._mujoco.MjModel.from_xml_string(text)
        self.data = self._mujoco.MjData(self.model)
        self._held = [[next(ids) for _ in _EQUALITIES[str(closure.rows)][1]] for closure in closures]
        self._free = next((joint for joint in tree.joints if joint.nv == _FREE), None)

    def reweigh(self, joint: int) -> None:
        """Take over gravity, and the inertia that a joint of the tree carries."""
        model, inertia = self.model, self._tree.inertias[joint]
        model.body_inertia[joint], pose = _principal(inertia)
        model.body_mass[joint], model.body_ipos[joint] = inertia.mass, inertia.lever
        model.body_iquat[joint] = _quaternion(pose.rotation)
        model.opt.gravity[:] = self._tree.gravity.linear
        self._mujoco.mj_setConst(model, self._mujoco.MjData(model))

    def soften(self, step: float) -> None:
        """Let the gaps of the closures close in the time constant for a time step, s.

        MuJoCo takes no time constant below two of its own steps.
        """
        self.model.opt.timestep = step
        self.model.eq_solref[:, 0] = self._options.time_constant * step

    def acceleration(self, q: Array, v: Array, tau: Array) -> Array:
        """Return the acceleration under a generalised force, shape (nv,), until the next call."""
        data, free = self.data, self._free
        data.qpos[:], data.qvel[:] = _coordinates(self._tree, q), v
        data.qfrc_applied[:] = tau
        if free is None:
            self._mujoco.mj_forward(self.model, data)
            return np.asarray(data.qacc)
        linear, w = slice(free.idx_v, free.idx_v + 3), v[free.idx_v + 3 :][:3]
        R = pin.XYZQUATToSE3(q[free.idx_q :][:7]).rotation
        data.qvel[linear], data.qfrc_applied[linear] = R @ v[linear], R @ tau[linear]
        self._mujoco.mj_forward(self.model, data)
        a: Array = data.qacc.copy()
        a[linear] = R.T @ a[linear] - np.cross(w, v[linear])
        return a

    def power(self) -> float:
        """Return the power of the closures at the last acceleration, W; they store and lose it."""
        return float(self.data.qfrc_constraint.dot(self.data.qvel))

    def forces(self, q: Array, v: Array, tau: Array) -> WeldForces:
        """Return accelerations and forces of closures under a generalised force.

        The generalised force J^T f of a closure's rows is (J_1 - J_2)^T F with the Jacobians of its sites,
        linear and angular, in the world, or the mean of those of its two points, which is that of C; of the
        wrenches F on side a it is the smallest.
        """
        a, data, wrenches = self.acceleration(q, v, tau).copy(), self.data, list[pin.Force]()
        rows = data.efc_J.reshape(-1, self.model.nv)
        for equalities in self._held:
            at = np.isin(data.efc_id, equalities)
            R = data.site_xmat[self.model.eq_obj1id[equalities[0]]].reshape(3, 3)
            J = np.mean([self._jacobian(equality) for equality in equalities], axis=0)
            F = np.linalg.lstsq(J.T, rows[at].T @ data.efc_force[at], rcond=_SAME)[0]
            wrenches.append(pin.Force(F[:3] @ R, F[3:] @ R))
        return WeldForces(a, wrenches)

    def _jacobian(self, equality: int) -> Array:
        """Return J_1 - J_2 of the sites of an equality, shape (6, nv)."""
        model, J = self.model, np.zeros((2, 2, 3, self.model.nv))
        sites = model.eq_obj1id[equality], model.eq_obj2id[equality]
        for site, jacobian in zip(sites, J, strict=True):
            self._mujoco.mj_jacSite(model, self.data, *jacobian, site)
        return np.concatenate(J[0] - J[1])


def _coordinates(tree: pin.Model, q: Array) -> Array:
    """Return MuJoCo's coordinates of a configuration."""
    x: Array = pin.difference(tree, pin.neutral(tree), q)
    for joint in tree.joints:
        if joint.nv == _FREE:
            pose = q[joint.idx_q :][:7]
            x = np.concatenate((x[: joint.idx_v], pose[:3], np.roll(pose[3:], 1), x[joint.idx_v + _FREE :]))
    return x


def _principal(inertia: pin.Inertia) -> tuple[Array, pin.SE3]:
    """Return the principal moments of inertia, and the pose of their axes in the joint's frame."""
    moments, axes = np.linalg.eigh(inertia.inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return moments, pin.SE3(axes, inertia.lever)


def _pose(pose: pin.SE3) -> dict[str, str]:
    """Return position and quaternion of a pose as attributes."""
    return {"pos": _text(pose.translation), "quat": _text(_quaternion(pose.rotation))}


def _quaternion(R: Array) -> Array:
    """Return the quaternion of a rotation, scalar first."""
    return np.roll(pin.Quaternion(R).coeffs(), 1)


def _text(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
