"""Pinocchio models of mechanisms from URDF: trees whose joints need no drives, and linked payloads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_array, as_number, require_path, require_type
from coop_pin.base.errors import ArgumentError, MimicJointError
from coop_pin.description.cell.closure import Closure
from coop_pin.description.cell.linkage import Linkage
from coop_pin.description.urdf import find_urdf, load_checked, text_checked
from coop_pin.description.urdf.loops import read_loops
from coop_pin.description.urdf.robot import Robot
from coop_pin.model.joint_angles import JointAngles
from coop_pin.model.pinocchio_model import add_frame, append_part, frame_id, joint_id, model_from_text

ROOT = "payload"
"""Name of the free-flyer joint of a free payload."""
_ITERATIONS, _TURNED = 50, 1e-14
"""Most steps of a joint towards a pose of P, and the step at which it is there, rad or m."""


def mechanism_model(
    path_or_xml: str | Path,
    gravity: ArrayLike,
    ignore_mimic: bool = False,
    package_dirs: Sequence[str] = (),
    xacro_args: Mapping[str, str] = MappingProxyType({}),
) -> tuple[pin.Model, tuple[Closure, ...]]:
    """Return the model of a URDF tree whose root link is fixed in the world, and the loops of the file.

    Args:
        path_or_xml: path of a URDF, name of a bundled or example-robot-data robot, or the XML text itself.
        gravity: m/s^2, in world axes, shape (3,).
        ignore_mimic: let mimic joints move independently.
        package_dirs: package folders, as for find_urdf.
        xacro_args: xacro arguments, as for find_urdf.

    Raises:
        UrdfError: there is no such file; it has structural defects, or loops that cannot be read;
            MimicJointError: it has mimic joints.
        ShapeError, OutOfRangeError: gravity is not three finite numbers.
    """
    along = as_array("gravity", gravity, 3)
    require_type("path_or_xml", path_or_xml, str, Path)
    require_type("package_dirs", package_dirs, Sequence)
    for folder in package_dirs:
        require_path("package_dirs", folder)
    require_type("xacro_args", xacro_args, Mapping)
    is_text = isinstance(path_or_xml, str) and path_or_xml.lstrip("\ufeff \t\r\n").startswith("<")
    name = "the text" if is_text else Path(path_or_xml).name
    if is_text:
        text = text_checked(str(path_or_xml), loops=True)
    else:
        text = load_checked(
            find_urdf(path_or_xml, package_dirs=package_dirs, xacro_args=xacro_args), loops=True
        )
    followers = Robot(text).mimics
    if followers and not ignore_mimic:
        raise MimicJointError(name, followers, "mimic", 'make their type "fixed" in the file')
    model = model_from_text(text, name)
    model.gravity.linear = along
    return model, read_loops(text)


def velocity_at(model: pin.Model, rates: Mapping[str, float]) -> Array:
    """Return the velocity with named joints at given rates and the others at rest, shape (nv,).

    Args:
        model: the tree.
        rates: joint velocities by joint name, rad/s, or m/s for a prismatic joint.

    Raises:
        NameNotFoundError: a joint does not exist.
        ArgumentError: a joint has more than one degree of freedom.
    """
    require_type("rates", rates, Mapping)
    v = np.zeros(model.nv)
    for name, rate in rates.items():
        joint = model.joints[joint_id(model, name)]
        if joint.nv != 1:
            raise ArgumentError(
                f"joint {name!r} has {joint.nv} degrees of freedom; set its entries of q and v directly"
            )
        v[joint.idx_v] = as_number(f"the value of joint {name!r}", rate)
    return v


class LinkedPayload:
    """Payload of several links in the tree of a cell; joints are named ``payload.<joint of the URDF>``.

    Attributes:
        model: tree of the cell with the payload.
        joints: indices of its joints, without the free-flyer of a free payload.
        root: index of the free-flyer; 0 of a payload with a base.
        q_slice: entries of q of the joints.
        v_slice: entries of v of the joints.
        angles: conversion between angles and entries of q.
        start: angles at which the grasps are stated, rad or m, shape (n,).
        joint: index of the joint that carries P.
        X_JP: pose of P in that joint.
    """

    def __init__(self, tree: pin.Model, links: Linkage) -> None:
        """Append the payload to a tree.

        Args:
            tree: tree of the arms.
            links: description of the payload.
        """
        part = model_from_text(links.text, "the payload")
        for index, name in enumerate(list(part.names)[1:], start=1):
            part.names[index] = f"payload.{name}"
        for frame in part.frames:
            frame.name = f"payload.{frame.name}"
        if links.base is None:
            free, X = pin.Model(), pin.SE3.Identity()
            free.addJoint(0, pin.JointModelFreeFlyer(), X, ROOT)
            part = pin.appendModel(free, part, add_frame(free, "payload.", 1, X), X)
        base = np.eye(4) if links.base is None else links.base.matrix
        self.model = append_part(tree, part, base)
        names = list(self.model.names)
        self.joints = tuple(index for index, name in enumerate(names) if name.startswith("payload."))
        self.root = int(self.model.getJointId(ROOT)) if links.base is None else 0
        first, last = self.joints[0], self.joints[-1]
        self.q_slice = slice(
            int(self.model.idx_qs[first]), int(self.model.idx_qs[last] + self.model.nqs[last])
        )
        self.v_slice = slice(
            int(self.model.idx_vs[first]), int(self.model.idx_vs[last] + self.model.nvs[last])
        )
        self.angles = JointAngles(self.model, self.joints)
        self.start = np.array([links.start[name] for name in self.joint_names])
        self.joint, self.X_JP = self.held(links.link, links.X_LP)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the URDF, in the order of q."""
        return tuple(name.removeprefix("payload.") for name in self.angles.names)

    def held(self, link: str, X_LE: Array) -> tuple[int, pin.SE3]:
        """Return the joint that moves a link, and the pose in it of a frame on the link."""
        frame = self.model.frames[frame_id(self.model, f"payload.{link}")]
        return int(frame.parentJoint), frame.placement * pin.SE3(X_LE)

    def configured(self, q: Array, X_WP: Array) -> Array:
        """Return a configuration of the tree with P at a pose, joints at the angles that it has.

        With a base the joint that moves P turns for it, as far as it can.

        Args:
            q: configuration of the tree, shape (nq,).
            X_WP: pose of P, shape (4, 4).
        """
        model, data, q = self.model, self.model.createData(), q.copy()
        if self.root:
            pin.forwardKinematics(model, data, q)
            X_0P = data.oMi[self.root].actInv(data.oMi[self.joint] * self.X_JP)
            entry = int(model.idx_qs[self.root])
            q[entry : entry + 7] = pin.SE3ToXYZQUAT(pin.SE3(X_WP) * X_0P.inverse())
            return q
        column, target = int(model.idx_vs[self.joint]), pin.SE3(X_WP)
        for _ in range(_ITERATIONS):
            pin.forwardKinematics(model, data, q)
            gap = pin.log6((data.oMi[self.joint] * self.X_JP).actInv(target)).vector
            s = self.X_JP.actInv(pin.Motion(data.joints[self.joint].S.ravel())).vector
            step = np.zeros(model.nv)
            step[column] = s @ gap / (s @ s)
            q = pin.integrate(model, q, step)
            if abs(step[column]) < _TURNED:
                break
        return q
