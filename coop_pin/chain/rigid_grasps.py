"""Rigid grasps of a cell: closures between tips and payload, which open and close."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.chain.closure import Closure
from coop_pin.chain.closure_set import ClosureError
from coop_pin.chain.grasp_springs import GraspsHeld, changed
from coop_pin.description.cell import Cell
from coop_pin.description.plant import PlantOptions
from coop_pin.model.cell_model import CellModel
from coop_pin.spatial import inverse_pose


class RigidGrasps:
    """Rigid grasps that are closures of the tree, and the mechanism with those that hold.

    A grasp that closes holds the tip where it is found. The velocities then meet by an impulse L at all
    closures, which do no work while they hold:

        M (v+ - v) = J^T L,    J v+ = 0

    Attributes:
        arms: indices of their arms.
        holds: grasps that hold, shape (n,).
        poses: poses of the tips on the payload that they keep, shape (n, 4, 4).
        closed: arms of the closures in their order, with the pose of the tip in its nominal grasp if it was
            closed elsewhere.
        mechanism: the tree with the closures of those that hold.
    """

    def __init__(self, cell: Cell, tree: CellModel, options: PlantOptions) -> None:
        """Close the grasps that are neither compliant, held by friction, nor a weld of the tree.

        Args:
            cell: Description.
            tree: Tree of the cell, which is kept.
            options: Formulation and stabilisation.
        """
        without = (*tree.closed_by_tree, *cell.unclosed)
        self.arms = [index for index, name in enumerate(cell.arms) if name not in without]
        self._tree, self._options, self._data = tree, options, tree.model.createData()
        self._nominal = np.array([cell.grasps[tree.arms[index].name].matrix for index in self.arms])
        self._nominal = self._nominal.reshape(-1, 4, 4)
        self.restore(GraspsHeld(np.ones(len(self.arms), dtype=bool), self._nominal))

    def held(self) -> GraspsHeld:
        """Return which grasps hold, and at which poses."""
        return GraspsHeld(self.holds, self.poses)

    def restore(self, held: GraspsHeld) -> None:
        """Return to grasps that held."""
        self.holds, self.poses = held
        self.closed = {
            index: None if np.array_equal(pose, nominal) else pin.SE3(inverse_pose(nominal) @ pose)
            for index, holds, pose, nominal in zip(self.arms, *held, self._nominal, strict=True)
            if holds
        }
        names, options = [arm.name for arm in self._tree.arms], self._options
        self.mechanism = ClosedChain(
            self._tree.model,
            [
                Closure(f"{names[index]}/grasp", f"payload/{names[index]}", X_BC=X and X.homogeneous)
                for index, X in self.closed.items()
            ],
            stabilisation=options.stabilisation,
            formulation=options.formulation,
        )

    def release(self, number: int) -> None:
        """Open a grasp."""
        self.restore(GraspsHeld(changed(self.holds, number, False), self.poses))

    def grasp(self, number: int, q: Array | None = None) -> None:
        """Close a grasp where its tip is found at a configuration, or at its nominal pose."""
        pose = self._nominal[number] if q is None else self._tip_pose(number, q).homogeneous
        poses = changed(self.poses, number, pose)
        self.restore(GraspsHeld(changed(self.holds, number, True), poses))

    def gap(self, number: int, q: Array) -> ClosureError:
        """Return distance and angle of a tip from its nominal grasp."""
        X = pin.SE3(self._nominal[number]).actInv(self._tip_pose(number, q))
        return ClosureError(float(np.linalg.norm(X.translation)), float(np.linalg.norm(pin.log3(X.rotation))))

    def _tip_pose(self, number: int, q: Array) -> pin.SE3:
        """Return X_PE of an arm at a configuration."""
        pin.framesForwardKinematics(self._tree.model, self._data, q)
        frames, tip = self._data.oMf, self._tree.arms[self.arms[number]].tip
        return frames[self._tree.payload_frame].actInv(frames[tip])
