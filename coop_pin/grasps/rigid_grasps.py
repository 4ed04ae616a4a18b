"""Rigid grasps and brakes of a cell: closures that come and go."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.spatial import inverse_pose, rotate_vector6, shift_wrench
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.chain.closure_set import Rolling
from coop_pin.chain.kkt_solver import constraint_svd
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.closure import Closure
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps.grasp_springs import GraspsHeld, changed
from coop_pin.model.cell_model import CellModel
from coop_pin.model.pinocchio_model import symmetric

_Z = np.array((0.0, 0.0, 1.0))
_INDETERMINATE = 1e-6
"""Part of a row of a wrench that rounding leaves, where multipliers cause no torques."""


class ClosuresHeld(NamedTuple):
    """Closures of a cell that hold; the arrays are not written to.

    Attributes:
        grasps: rigid grasps.
        brakes: closures of the joints that a brake holds.
    """

    grasps: GraspsHeld
    brakes: tuple[Closure, ...]


class RigidGrasps:
    """Rigid grasps that are closures of the tree, brakes, and the mechanism with those that hold.

    A grasp that closes holds the tip where it is, and a brake its joint. The velocities then meet by an
    impulse L at all closures, which do no work while they hold:

        M (v+ - v) = J^T L,    J v+ = 0

    Attributes:
        arms: indices of their arms.
        holds: grasps that hold, shape (n,).
        poses: poses of the tips on the payload that they keep, shape (n, 4, 4).
        closed: arms of the closures in their order, with the pose of the tip in its nominal grasp if it was
            closed elsewhere.
        brakes: closures of the joints that a brake holds.
        joints: X_EC of the grasps that are joints, by index of their arms; wrenches of closures are about C.
        mechanism: the tree with the closures of those that hold, brakes last, and the wheels of bases.
    """

    def __init__(self, cell: Cell, tree: CellModel, options: PlantOptions) -> None:
        """Close the grasps that are neither compliant, held by friction, nor a weld of the tree.

        Args:
            cell: Description.
            tree: Tree of the cell, which is kept.
            options: Formulation and stabilisation.
        """
        self._rows = {name: rows for name, rows in cell.closing.items() if name not in tree.closed_by_tree}
        self.arms = [index for index, name in enumerate(cell.arms) if name in self._rows]
        self._X_EC = {name: grasp.X_EC for name, grasp in cell.jointed.items()}
        self.joints = {
            index: pin.SE3(self._X_EC[name]) for index, name in enumerate(cell.arms) if name in self._X_EC
        }
        self._tree, self._options, self._data = tree, options, tree.model.createData()
        self._nominal = np.array([cell.grasps[tree.arms[index].name].matrix for index in self.arms])
        self._nominal = self._nominal.reshape(-1, 4, 4)
        self.restore(ClosuresHeld(GraspsHeld(np.ones(len(self.arms), dtype=bool), self._nominal), ()))

    def held(self) -> ClosuresHeld:
        """Return which grasps hold, at which poses, and the brakes."""
        return ClosuresHeld(GraspsHeld(self.holds, self.poses), self.brakes)

    def restore(self, held: ClosuresHeld) -> None:
        """Return to closures that held."""
        (self.holds, self.poses), self.brakes = held
        self.closed = {
            index: None if np.array_equal(pose, nominal) else pin.SE3(inverse_pose(nominal) @ pose)
            for index, holds, pose, nominal in zip(self.arms, *held.grasps, self._nominal, strict=True)
            if holds
        }
        names, options = [self._tree.arms[index].name for index in self.closed], self._options
        grasps = [
            self._closure(name, X and X.homogeneous)
            for name, X in zip(names, self.closed.values(), strict=True)
        ]
        self.mechanism = ClosedChain(
            self._tree.model,
            [*grasps, *self.brakes],
            stabilisation=options.stabilisation,
            formulation=options.formulation,
            rolling=[
                Rolling(*(str(self._tree.model.names[slot.joint]) for slot in places))
                for places in self._tree.wheels.values()
            ],
        )

    def _closure(self, name: str, X_GE: Array | None) -> Closure:
        """Return the closure of an arm's tip at a pose in its nominal grasp; about C of a joint."""
        X_EC = self._X_EC.get(name)
        X_GC = X_GE if X_EC is None else X_EC if X_GE is None else X_GE @ X_EC
        return Closure(f"{name}/grasp", f"payload/{name}", self._rows[name], X_AC=X_EC, X_BC=X_GC)

    def release(self, number: int) -> None:
        """Open a grasp."""
        grasps = GraspsHeld(changed(self.holds, number, False), self.poses)
        self.restore(self.held()._replace(grasps=grasps))

    def grasp(self, number: int, q: Array | None = None) -> None:
        """Close a grasp where its tip is at a configuration, or at its nominal pose."""
        pose = self._nominal[number] if q is None else self._tip_pose(number, q).homogeneous
        grasps = GraspsHeld(changed(self.holds, number, True), changed(self.poses, number, pose))
        self.restore(self.held()._replace(grasps=grasps))

    def brake(self, arm: int, q: Array) -> None:
        """Hold the joints of an arm at a configuration from now on."""
        tree, data = self._tree.model, self._data
        pin.forwardKinematics(tree, data, q, np.zeros(tree.nv))
        brakes = [_brake(tree, data, number) for number in self._tree.arms[arm].joints]
        self.restore(self.held()._replace(brakes=(*self.brakes, *brakes)))

    def determinate_rows(self, q: Array) -> Mask:
        """Return which rows of the interaction wrenches, about P in world axes, are determinate, shape (6,).

        Lagrange multipliers in the null space of J^T cause no joint torques. How the arms share the rows that
        such multipliers reach depends on their elasticity, not on rigid-body dynamics: for example the weight
        of a bar between two planar arms.
        """
        model, data, closed = self._tree.model, self._data, self.mechanism.closures
        state = closed.state(q, np.zeros(model.nv))
        svd = constraint_svd(symmetric(pin.crba(model, data, q)), state.jacobian)
        null_space = np.eye(len(state.position)) - svd.left @ svd.left.T
        pin.framesForwardKinematics(model, data, q)
        p_WP = data.oMf[self._tree.payload_frame].translation
        determinate = np.ones(6, dtype=bool)
        for (tip, _), wrench_map in zip(closed.sides, state.wrench_map, strict=True):
            X_WC = tip.pose(data)
            in_world = rotate_vector6(X_WC.rotation, (wrench_map @ null_space).T)
            about_P = shift_wrench(in_world, X_WC.translation - p_WP)
            determinate &= np.abs(about_P).max(axis=0, initial=0.0) < _INDETERMINATE
        return determinate

    def _tip_pose(self, number: int, q: Array) -> pin.SE3:
        """Return X_PE of an arm at a configuration."""
        pin.framesForwardKinematics(self._tree.model, self._data, q)
        frames, tip = self._data.oMf, self._tree.arms[self.arms[number]].tip
        return frames[self._tree.payload_frame].actInv(frames[tip])


def _brake(model: pin.Model, data: pin.Data, number: int) -> Closure:
    """Return the closure of one row that holds a joint of one degree of freedom where it is."""
    parent, subspace = int(model.parents[number]), np.asarray(data.joints[number].S).ravel()
    turns = bool(subspace[3:].any())
    axis = subspace[3:] if turns else subspace[:3]
    X_JC = pin.SE3(pin.Quaternion.FromTwoVectors(_Z, axis).matrix(), np.zeros(3))
    X_BC = data.oMi[parent].actInv(data.oMi[number]) * X_JC
    rows = [False] * 6
    rows[5 if turns else 2] = True
    a, b = str(model.names[number]), str(model.names[parent])
    return Closure(a, b, rows, X_AC=X_JC.homogeneous, X_BC=X_BC.homogeneous, name=f"brake of {a}")
