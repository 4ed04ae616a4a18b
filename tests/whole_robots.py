"""Inverse dynamics of a whole robot from its URDF text in plain numpy: the second formulation of tests.

Every joint of the file moves; nothing here is shared with the package, and no model of Pinocchio is read.
"""

from __future__ import annotations

from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np


def _skew(p):
    return np.array(((0.0, -p[2], p[1]), (p[2], 0.0, -p[0]), (-p[1], p[0], 0.0)))


def _turn(axis, angle):
    K = _skew(axis)
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def _pose(xyz, rpy=(0.0, 0.0, 0.0)):
    X = np.eye(4)
    axes = np.eye(3)
    X[:3, :3] = _turn(axes[2], rpy[2]) @ _turn(axes[1], rpy[1]) @ _turn(axes[0], rpy[0])
    X[:3, 3] = xyz
    return X


def _numbers(element, name, default="0 0 0"):
    return np.array([float(x) for x in (default if element is None else element.get(name, default)).split()])


class Joint(NamedTuple):
    name: str
    kind: str
    parent: str
    child: str
    X: np.ndarray
    axis: np.ndarray


class WholeRobot:
    """Links and joints in world axes: Newton and Euler about each centre of mass, from the floor up."""

    def __init__(self, text, base=None):
        root = ET.fromstring(text)
        self.base = np.eye(4) if base is None else base
        self.links = {}
        for link in root.iter("link"):
            inertial = link.find("inertial")
            if inertial is None:
                continue
            tensor = np.diag([float(inertial.find("inertia").get(k)) for k in ("ixx", "iyy", "izz")])
            mass = float(inertial.find("mass").get("value"))
            self.links[link.get("name")] = (mass, _numbers(inertial.find("origin"), "xyz"), tensor)
        joints = []
        for each in root.iter("joint"):
            origin = each.find("origin")
            X = _pose(_numbers(origin, "xyz"), _numbers(origin, "rpy"))
            ends = (each.find(side).get("link") for side in ("parent", "child"))
            joints.append(
                Joint(each.get("name"), each.get("type"), *ends, X, _numbers(each.find("axis"), "xyz"))
            )
        children = {joint.child for joint in joints}
        self.root = next(joint.parent for joint in joints if joint.parent not in children)
        self.joints, known = [], {self.root}
        while len(self.joints) < len(joints):  # parents first
            for joint in joints:
                if joint.parent in known and joint.child not in known:
                    known.add(joint.child)
                    self.joints.append(joint)
        self.names = [joint.name for joint in self.joints if joint.kind != "fixed"]

    def motion(self, q, v, a):
        """Return pose, and velocity and acceleration (linear of the origin, angular) of every link."""
        X, V, A = {self.root: self.base}, {self.root: np.zeros(6)}, {self.root: np.zeros(6)}
        for joint in self.joints:
            at, (lin, om), (acc, al) = (
                X[joint.parent],
                np.split(V[joint.parent], 2),
                np.split(A[joint.parent], 2),
            )
            Y = at @ joint.X
            r, e = Y[:3, 3] - at[:3, 3], Y[:3, :3] @ joint.axis
            lin, acc = lin + np.cross(om, r), acc + np.cross(al, r) + np.cross(om, np.cross(om, r))
            if joint.kind == "prismatic":
                s, ds, dds = q[joint.name], v[joint.name], a[joint.name]
                Y = Y @ _pose(joint.axis * s)
                lin, acc = (
                    lin + np.cross(om, e * s) + e * ds,
                    acc
                    + np.cross(al, e * s)
                    + np.cross(om, np.cross(om, e * s))
                    + 2 * np.cross(om, e * ds)
                    + e * dds,
                )
            elif joint.kind != "fixed":
                s, ds, dds = q[joint.name], v[joint.name], a[joint.name]
                R = np.eye(4)
                R[:3, :3] = _turn(joint.axis, s)
                Y = Y @ R
                om, al = om + e * ds, al + e * dds + np.cross(om, e * ds)
            X[joint.child], V[joint.child], A[joint.child] = Y, np.r_[lin, om], np.r_[acc, al]
        return X, V, A

    def inverse_dynamics(self, q, v, a, gravity, forces=None):
        """Return the forces of the joints, and the wrench of the floor on the robot about the world's origin.

        Args:
            forces: wrenches on links about the world's origin, by name.
        """
        X, V, A = self.motion(q, v, a)
        below = {}
        for link, at in X.items():
            mass, c, inertia = self.links.get(link, (0.0, np.zeros(3), np.zeros((3, 3))))
            R, (_, om), (acc, al) = at[:3, :3], np.split(V[link], 2), np.split(A[link], 2)
            r = R @ c
            inertia = R @ inertia @ R.T
            f = mass * (acc + np.cross(al, r) + np.cross(om, np.cross(om, r)) - gravity)
            n = inertia @ al + np.cross(om, inertia @ om) + np.cross(at[:3, 3] + r, f)
            below[link] = np.r_[f, n] - (0.0 if forces is None else forces.get(link, 0.0))
        tau = {}
        for joint in reversed(self.joints):
            F, at = below[joint.child], X[joint.child]
            e = at[:3, :3] @ joint.axis
            about = F[3:] - np.cross(at[:3, 3], F[:3])
            if joint.kind != "fixed":
                tau[joint.name] = e @ (F[:3] if joint.kind == "prismatic" else about)
            below[joint.parent] = below[joint.parent] + F
        return tau, below[self.root]

    def terms(self, q, v, gravity, tips):
        """Return M and h in the order of ``names``, and of each tip its pose, Jacobian and Jdot v, (6, n)."""
        n = len(self.names)
        zero, unit = dict.fromkeys(self.names, 0.0), np.eye(n)
        of = lambda row: dict(zip(self.names, row, strict=True))  # noqa: E731
        column = lambda tau: np.array([tau[name] for name in self.names])  # noqa: E731
        still = np.zeros(3)
        M = np.array([column(self.inverse_dynamics(q, zero, of(row), still)[0]) for row in unit]).T
        h = column(self.inverse_dynamics(q, v, zero, gravity)[0])
        X, _, bias = self.motion(q, v, zero)
        each = [self.motion(q, of(row), zero)[1] for row in unit]
        frames = [(X[tip], np.array([V[tip] for V in each]).T, bias[tip]) for tip in tips]
        return M, h, frames
