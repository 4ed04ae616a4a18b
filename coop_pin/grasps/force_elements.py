"""Force elements of a cell: wrenches between frames that act on its tree with torques and closures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.model.cell_model import CellModel
from coop_pin.model.pinocchio_model import jacobian_matrix

_NO_POSE = np.eye(4)


class Side(NamedTuple):
    """Frame on a joint of the tree.

    Attributes:
        joint: index of the joint.
        X_JF: pose of the frame in the joint's.
        X_WJ: pose of the joint; Pinocchio's own, so that it is the present one.
    """

    joint: int
    X_JF: Any
    X_WJ: Any

    @property
    def pose(self) -> Any:
        """X_WF."""
        return self.X_WJ * self.X_JF


class ForceElement(Protocol):
    """Wrenches between frames of a tree: a function of poses, twists and the element's own state."""

    def act(self) -> float:
        """Add the wrenches to F_J of the joints; return the power that the element dissipates, W, <= 0."""


class ForceElements:
    """Force elements of a cell, with the joints of its tree at a state in Pinocchio's own memory.

    Looking up single objects of Pinocchio takes longer than all the rest.

    Attributes:
        elements: the elements, which read poses and twists and add to the wrenches.
        X_WJ: poses of the joints as [R^T; p^T], shape (njoints, 4, 3).
        V_J: twists in axes of the joints, shape (njoints, 2, 3).
        F_J: wrenches on the bodies about the joints' origins in their axes, N and N m, shape (njoints, 6).
        wrenches: the same as F_J, as Pinocchio takes them.
        rows: X_WJ, V_J and F_J in a row each, as memory that is copied at once.
        model: the tree without gravity, so that inverse dynamics at rest is J^T of the wrenches.
        data: data of the model at the state.
    """

    def __init__(self, tree: CellModel) -> None:
        self.elements: Sequence[ForceElement] = ()
        self.model, self._rest = tree.model.copy(), np.zeros(tree.model.nv)
        self.model.gravity.setZero()
        self.data, count = self.model.createData(), self.model.njoints
        self.wrenches = pin.StdVec_Force([pin.Force.Zero()] * count)
        self._solution = self.model.createData()
        self.X_WJ = _rows(self.data.oMi[0].rotation, count, 4, 3)
        self.V_J = _rows(self.data.v[0].linear, count, 2, 3)
        self.F_J = _rows(self.wrenches[0].linear, count, 6)
        self.rows = [each.reshape(-1).data for each in (self.X_WJ, self.V_J, self.F_J)]
        self._F_J, self._no_wrenches = self.rows[2], np.zeros(self.F_J.size).data

    def move(self, q: Array, v: Array) -> None:
        """Move the joints to a state."""
        pin.forwardKinematics(self.model, self.data, q, v)

    def side(self, frame: int, X: Array = _NO_POSE) -> Side:
        """Return the side of a frame's joint, at a pose in the frame, shape (4, 4)."""
        named = self.model.frames[frame]
        joint = int(named.parentJoint)
        return Side(joint, named.placement * pin.SE3(X), self.data.oMi[joint])

    def jacobian(self, side: Side) -> Array:
        """Return the Jacobian of a side's joint about the world's origin, shape (6, nv)."""
        return jacobian_matrix(pin.getJointJacobian(self.model, self.data, side.joint, pin.WORLD))

    def act(self, q: Array, v: Array) -> float:
        """Move the joints, write the wrenches of all elements on them, return the power dissipated, W."""
        pin.forwardKinematics(self.model, self.data, q, v)
        self._F_J[:] = self._no_wrenches
        power = 0.0
        for element in self.elements:
            power += element.act()
        return power

    def force(self, q: Array) -> Array:
        """Return the generalised force of F_J at the configuration of the joints, shape (nv,)."""
        rest = self._rest
        return -pin.rnea(self.model, self._solution, q, rest, rest, self.wrenches)


def own_loads(loads: Array, arms: Sequence[int], poses: Sequence[Any], on_bodies: Array) -> Array:
    """Return loads of all arms, those of some about P by these arms' own kinematics, shape (m, 6).

    Args:
        loads: Wrenches on the arms about P in world axes, shape (m, 6).
        arms: Indices of some of them.
        poses: X_WP as each of these sees it.
        on_bodies: Their wrenches about the world's origin in world axes, shape (n, 6) or longer.
    """
    loads = loads.copy()
    for index, X_WP, F in zip(arms, poses, on_bodies, strict=False):
        loads[index] = pin.SE3(np.eye(3), X_WP.translation).actInv(pin.Force(F)).vector
    return loads


def _rows(first: Array, count: int, *shape: int) -> Array:
    """Return a view of count objects of Pinocchio in a row, from the numbers of the first on."""
    strides = np.cumprod((8, *reversed(shape)))[::-1].tolist()
    return np.lib.stride_tricks.as_strided(first, (count, *shape), strides)
