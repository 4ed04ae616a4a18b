"""Cells of two arms on differential bases, planar and spatial; their robots on Pinocchio's planar joint."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from cells import SPATIAL_START, planar_scenario, spatial_cell

from coop_pin.base.schema.pose import Pose
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.differential_base import DifferentialBase
from coop_pin.model.pinocchio_model import load_arm_model

PLATFORM = {"mass": 90.0, "size": (0.7, 0.5, 0.3), "centre": 0.12, "ahead": 0.25, "wheel_radius": 0.1}
STARTS = {"planar": planar_scenario().start.matrix, "spatial": SPATIAL_START.matrix}


def on_wheels(cell: Cell, **fields: object) -> Cell:
    """The cell with each arm on a rolling base that heads along the x axis of its root link."""
    base = DifferentialBase(**(PLATFORM | fields))
    lift = np.eye(4)
    lift[:3, 3] = base.ahead, 0.0, base.wheel_radius + base.size[2]
    arms = {
        name: arm.replace(base=Pose.from_matrix(arm.base.matrix @ np.linalg.inv(lift)), mobile_base=base)
        for name, arm in cell.arms.items()
    }
    return cell.replace(arms=arms)


def rolling_cell(name: str, **fields: object) -> Cell:
    """A cell without friction at its joints, its arms on wheels."""
    cell = planar_scenario().cell if name == "planar" else spatial_cell()
    arms = {each: arm.replace(friction="none") for each, arm in cell.arms.items()}
    return on_wheels(cell.replace(arms=arms), **fields)


class PlanarRobot:
    """An arm on a platform by Pinocchio's planar joint, whose velocity is in the platform's axes.

    Attributes:
        model: the tree: the planar joint, then the arm's joints.
    """

    def __init__(self, cell: Cell, name: str) -> None:
        arm = cell.arms[name]
        base = arm.mobile_base
        assert isinstance(base, DifferentialBase)
        alone, tree = load_arm_model(arm.replace(mobile_base=None)), pin.Model()
        tree.gravity.linear = np.array(cell.gravity)
        joint = tree.addJoint(0, pin.JointModelPlanar(), pin.SE3(arm.base.matrix), "platform")
        (x, y, z), r = base.size, base.wheel_radius
        box = pin.Inertia.FromBox(base.mass, x, y, z)
        tree.appendBodyToJoint(joint, box, pin.SE3(np.eye(3), np.array((base.centre, 0.0, r + z / 2))))
        frame = pin.Frame("deck", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME)
        deck = tree.addFrame(frame)
        X = pin.SE3(np.eye(3), np.array((base.ahead, 0.0, r + z)))
        self.model = pin.appendModel(tree, alone, deck, X)
        self.model.gravity.linear = np.array(cell.gravity)
        self.data, self.tip = self.model.createData(), self.model.getFrameId(arm.tip)

    def terms(self, pose: np.ndarray, rates: np.ndarray, angles: np.ndarray, speeds: np.ndarray):
        """M, h, tip pose, Jacobian with drift, v and turn, at x, y, yaw of the platform and the angles."""
        turn = np.array(((np.cos(pose[2]), np.sin(pose[2])), (-np.sin(pose[2]), np.cos(pose[2]))))
        q = np.r_[pose[:2], np.cos(pose[2]), np.sin(pose[2]), angles]
        v = np.r_[turn @ rates[:2], rates[2], speeds]
        model, data = self.model, self.data
        M = pin.crba(model, data, q)
        M = np.triu(M) + np.triu(M, 1).T
        h = pin.nonLinearEffects(model, data, q, v).copy()
        J = pin.computeFrameJacobian(model, data, q, self.tip, pin.LOCAL_WORLD_ALIGNED).copy()
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        X = pin.updateFramePlacement(model, data, self.tip).homogeneous.copy()
        drift = pin.getFrameClassicalAcceleration(model, data, self.tip, pin.LOCAL_WORLD_ALIGNED)
        return M, h, X, J, drift.vector.copy(), v, turn
