"""MuJoCo model of a cell's tree: joints and inertias of Pinocchio's, and a weld for each closed grasp."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array

_PLACEHOLDER = "1 1 1"


class Weld(NamedTuple):
    """Two frames of the tree that a soft weld keeps together.

    Attributes:
        joints: indices of the joints that carry them, in the tree.
        poses: their poses on these, SE3.
    """

    joints: tuple[int, int]
    poses: tuple[pin.SE3, pin.SE3]


def unlike_mujoco(tree: pin.Model) -> str:
    """Return the name of the first joint that is not a single turn or slide; empty if all are."""
    joints = zip(tree.names[1:], tree.joints[1:], strict=True)
    return next((str(name) for name, joint in joints if joint.nv != 1), "")


def mjcf(tree: pin.Model, welds: Sequence[Weld], *, time_constant: float, impedance: float) -> str:
    """Return the model of a tree of turning and sliding joints, as MJCF.

    Bodies stand in the frames of Pinocchio's joints and have their names; torques are applied by
    ``qfrc_applied``. Contacts, limits and friction of joints are off. Inertias are set by ``set_inertias``.

    Args:
        tree: Pinocchio tree whose joints have one degree of freedom.
        welds: Pairs of frames that are welded.
        time_constant: Time in which a weld's error decays, s.
        impedance: d of the welds (``solimp``), which MuJoCo keeps below 0.9999.
    """
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian", autolimits="false", boundmass="1e-9", boundinertia="1e-9")
    option = ET.SubElement(
        root,
        "option",
        integrator="RK4",
        jacobian="dense",
        tolerance="1e-15",
        iterations="200",
        gravity=_text(tree.gravity.linear),
    )
    off = ("contact", "limit", "frictionloss", "clampctrl", "refsafe")
    ET.SubElement(option, "flag", dict.fromkeys(off, "disable"))
    bodies = [ET.SubElement(root, "worldbody")]
    data = tree.createData()
    pin.forwardKinematics(tree, data, pin.neutral(tree), np.zeros(tree.nv))
    for number in range(1, tree.njoints):
        parent, name = bodies[tree.parents[number]], str(tree.names[number])
        body = ET.SubElement(parent, "body", _placed(tree.jointPlacements[number]), name=name)
        S = np.asarray(data.joints[number].S).ravel()
        turns = bool(S[3:].any())
        kind, axis = ("hinge", S[3:]) if turns else ("slide", S[:3])
        ET.SubElement(body, "joint", name=name, type=kind, axis=_text(axis))
        ET.SubElement(body, "inertial", pos="0 0 0", mass="1", diaginertia=_PLACEHOLDER)
        bodies.append(body)
    equality = ET.SubElement(root, "equality") if welds else None
    for number, weld in enumerate(welds):
        sites = [f"weld{number}/{side}" for side in "ab"]
        for site, joint, pose in zip(sites, *weld, strict=True):
            ET.SubElement(bodies[joint], "site", _placed(pose), name=site)
        ET.SubElement(
            equality,
            "weld",
            site1=sites[0],
            site2=sites[1],
            solref=_text((time_constant, 1.0)),
            solimp=_text((impedance, impedance, 1e-3, 0.5, 2.0)),
        )
    return ET.tostring(root, encoding="unicode")


def set_inertias(model: Any, tree: pin.Model) -> None:
    """Set mass, centre and inertia of every body as in the tree, by principal axes.

    Args:
        model: MjModel that ``mjcf`` describes.
        tree: Its tree.
    """
    import mujoco

    for body, inertia in enumerate(tree.inertias.tolist()[1:], start=1):
        moments, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        model.body_mass[body], model.body_ipos[body] = inertia.mass, inertia.lever
        model.body_inertia[body], model.body_iquat[body] = moments, _quaternion(axes)
    model.opt.gravity[:] = tree.gravity.linear
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _placed(pose: pin.SE3) -> dict[str, str]:
    """Return position and quaternion of a pose as attributes."""
    return {"pos": _text(pose.translation), "quat": _text(_quaternion(pose.rotation))}


def _quaternion(R: Array) -> Array:
    """Return the quaternion of a rotation, scalar first."""
    return np.roll(pin.Quaternion(R).coeffs(), 1)


def _text(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
