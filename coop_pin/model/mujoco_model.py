"""MuJoCo model of a cell's tree: its joints, its inertias, and a soft weld for each loop closure."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.errors import needs_extra
from coop_pin.description.plant import MujocoOptions
from coop_pin.model.pinocchio_model import frame_id

_LEAST = "1e-14"
"""Mass, kg, and inertia, kg m^2, of links that have none: MuJoCo refuses moving bodies without any."""
_INTEGRATORS = {"rk4": "RK4", "semi-implicit-euler": "Euler"}
_SAME = 1e-9


class WeldForces(NamedTuple):
    """Accelerations and forces of welds at a state.

    Attributes:
        a: acceleration of the tree, shape (nv,).
        wrenches: wrench on the first frame of each weld, about it in its axes.
    """

    a: Array
    wrenches: list[pin.Force]


def unlike_mujoco(tree: pin.Model) -> str:
    """Return what of a tree MuJoCo does not have; empty if it has all."""
    for name, joint, inertia in list(zip(tree.names, tree.joints, tree.inertias, strict=True))[1:]:
        if joint.nv != 1:
            return f"joint {name!r} is neither a single turn nor a slide"
        least, middle, largest = np.linalg.eigvalsh(inertia.inertia)
        if least + middle < largest - _SAME * abs(largest):
            return f"the inertia behind joint {name!r} breaks the triangle inequality"
    return ""


def mjcf(
    tree: pin.Model,
    welds: Sequence[tuple[str, str]],
    options: MujocoOptions,
    *,
    step: float,
    integrator: str = "rk4",
    start: Array | None = None,
) -> str:
    """Return the model of a cell's tree as MJCF; ``unlike_mujoco`` says what cannot be.

    Bodies stand in the frames of the joints and have their names, frames that are welded, and P, are sites.
    Contacts and limits are off; torques are generalised forces, ``qfrc_applied``.

    Args:
        tree: Pinocchio tree.
        welds: Names of two frames each.
        options: Stiffness of the welds.
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
        S = np.asarray(data.joints[number].S).ravel()
        kind, axis = ("hinge", S[3:]) if S[3:].any() else ("slide", S[:3])
        rotor = tree.armature[tree.idx_vs[number]]
        stated = {"armature": _text([rotor])} if rotor else {}
        ET.SubElement(body, "joint", stated, name=name, type=kind, axis=_text(axis))
        moments, pose = _principal(tree.inertias[number])
        mass = _text([tree.inertias[number].mass])
        ET.SubElement(body, "inertial", _pose(pose), mass=mass, diaginertia=_text(moments))
        bodies.append(body)
    for name in dict.fromkeys(("payload", *itertools.chain(*welds))):
        frame = tree.frames[frame_id(tree, name)]
        ET.SubElement(bodies[frame.parentJoint], "site", _pose(frame.placement), name=name)
    for a, b in welds:
        equality = root.find("equality")
        ET.SubElement(
            ET.SubElement(root, "equality") if equality is None else equality,
            "weld",
            site1=a,
            site2=b,
            solref=_text((options.time_constant * step, 1.0)),
            solimp=_text((options.impedance, options.impedance, 1e-3, 0.5, 2.0)),
            torquescale=_text([options.torque_scale]),
        )
    if start is not None:
        x = pin.difference(tree, pin.neutral(tree), start)
        ET.SubElement(ET.SubElement(root, "keyframe"), "key", name="start", qpos=_text(x))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def mujoco_module() -> Any:
    """Return MuJoCo.

    Raises:
        MissingExtraError: it is not installed.
    """
    with needs_extra("mujoco", "mujoco", "for the engine 'mujoco'"):
        import mujoco
    return mujoco


class MujocoModel:
    """Tree with soft welds in MuJoCo: accelerations and forces of welds."""

    def __init__(self, tree: pin.Model, text: str, options: MujocoOptions) -> None:
        """Compile a model.

        Args:
            tree: Pinocchio tree, which may change its inertias.
            text: MJCF of it, as of ``mjcf``.
            options: Stiffness of the welds.

        Raises:
            MissingExtraError: mujoco is not installed.
        """
        self._mujoco, self._tree, self._options = mujoco_module(), tree, options
        self.model = self._mujoco.MjModel.from_xml_string(text)
        self.data, self._neutral = self._mujoco.MjData(self.model), pin.neutral(tree)
        self._jacobians = np.zeros((4, 3, tree.nv))

    def reweigh(self, joint: int) -> None:
        """Take over gravity, and the inertia that a joint of the tree carries."""
        model, inertia = self.model, self._tree.inertias[joint]
        model.body_inertia[joint], pose = _principal(inertia)
        model.body_mass[joint], model.body_ipos[joint] = inertia.mass, inertia.lever
        model.body_iquat[joint] = _quaternion(pose.rotation)
        model.opt.gravity[:] = self._tree.gravity.linear
        self._mujoco.mj_setConst(model, self._mujoco.MjData(model))

    def soften(self, step: float) -> None:
        """Let the gaps of the welds close in the time constant for a time step, s.

        MuJoCo takes no time constant below two of its own steps.
        """
        self.model.opt.timestep = step
        self.model.eq_solref[:, 0] = self._options.time_constant * step

    def acceleration(self, q: Array, v: Array, tau: Array) -> Array:
        """Return the acceleration under a generalised force, shape (nv,), until the next call."""
        self.data.qpos[:] = pin.difference(self._tree, self._neutral, q)
        self.data.qvel[:], self.data.qfrc_applied[:] = v, tau
        self._mujoco.mj_forward(self.model, self.data)
        a: Array = self.data.qacc
        return a

    def forces(self, q: Array, v: Array, tau: Array) -> WeldForces:
        """Return accelerations and forces of welds under a generalised force.

        The generalised force J^T f of a weld's rows is (J_1 - J_2)^T F with the Jacobians of its two sites,
        linear and angular, in the world; of the wrenches F on the first one it is the smallest.
        """
        a, model, data = self.acceleration(q, v, tau).copy(), self.model, self.data
        rows, wrenches = data.efc_J.reshape(-1, model.nv), list[pin.Force]()
        for weld, sites in enumerate(zip(model.eq_obj1id, model.eq_obj2id, strict=True)):
            for site, jacobian in zip(sites, self._jacobians.reshape(2, 2, 3, -1), strict=True):
                self._mujoco.mj_jacSite(model, data, *jacobian, site)
            J = np.concatenate(self._jacobians[:2] - self._jacobians[2:])
            at, R = slice(6 * weld, 6 * weld + 6), data.site_xmat[sites[0]].reshape(3, 3)
            F = np.linalg.lstsq(J.T, rows[at].T @ data.efc_force[at], rcond=_SAME)[0]
            wrenches.append(pin.Force(F[:3] @ R, F[3:] @ R))
        return WeldForces(a, wrenches)


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
