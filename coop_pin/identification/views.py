"""Views of the payload: its pose as the kinematics of each arm has it, and how errors of them move it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import inverse_pose
from coop_pin.model.cell_arm import CellArm

FRAME_AXES = ("x", "y", "z", "rx", "ry", "rz")


class View(NamedTuple):
    """Payload as one arm sees it at some times.

    Attributes:
        pose: X_WP, shape (n, 4, 4).
        jacobian: J_WP of the joints, shape (n, 6, nv).
        links: displacement from each joint to the next, from the last one to the tip, world axes, m, shape
            (n, 3, nv).
    """

    pose: Array
    jacobian: Array
    links: Array


def view_of(arm: CellArm, position: Array) -> View:
    """Return the payload as an arm sees it, with the kinematics that its law has.

    Args:
        arm: the arm.
        position: joint positions, shape (n, nv).
    """
    model, rows = arm.kinematics.model, len(position)
    data, payload = model.createData(), model.getFrameId("payload")
    view = View(np.empty((rows, 4, 4)), np.empty((rows, 6, arm.nv)), np.empty((rows, 3, arm.nv)))
    E_P = inverse_pose(arm.X_PE)[:3, 3]
    for k, angles in enumerate(position):
        q = arm.configuration(angles)
        J = pin.computeFrameJacobian(model, data, q, payload, pin.LOCAL_WORLD_ALIGNED)
        X = pin.updateFramePlacement(model, data, payload).homogeneous
        origins = np.array([placement.translation for placement in data.oMi])[1:]
        tip = X[:3, 3] - X[:3, :3] @ arm.X_PE[:3, :3] @ E_P
        view.pose[k], view.jacobian[k] = X, J.reshape(6, -1)
        view.links[k] = np.diff(np.vstack((origins, tip)), axis=0).T
    return view


def moved(view: View, arm: CellArm, tip: Array, base: Array, links: Array) -> Array:
    """Return the poses of the payload without errors of an arm's model, shape (n, 4, 4).

    Args:
        view: the view, of positions without the joint offsets.
        arm: the arm.
        tip: xyz and rpy of the tip's error, m and rad, as in ``calibration_error``, shape (6,).
        base: error of the base, likewise.
        links: relative errors of the link lengths, shape (nv,).
    """
    X = view.pose.copy()
    X[:, :3, 3] -= view.links @ links
    X_WB = arm.description.base.matrix
    before = X_WB @ inverse_pose(_pose(base)) @ inverse_pose(X_WB)
    after = arm.X_PE @ inverse_pose(_pose(tip)) @ inverse_pose(arm.X_PE)
    return np.asarray(before @ X @ after)


def _pose(xyz_rpy: Array) -> Array:
    return np.array(pin.SE3(pin.rpy.rpyToMatrix(xyz_rpy[3:]), xyz_rpy[:3]).homogeneous)


def columns(view: View, arm: CellArm) -> Array:
    """Return how errors of an arm's model move its view of P: by tip, base, joints, links, world axes.

    An error of a frame at p_F with axes R_F moves P by R_F t + (R_F w) x (p - p_F) and turns it by R_F w.

    Returns:
        Shape (n, 6, 12 + 2 nv).
    """
    X_WE = view.pose @ arm.X_PE
    X_WB = np.broadcast_to(arm.description.base.matrix, X_WE.shape)
    frames = [_of_frame(X[:, :3, :3], view.pose[:, :3, 3] - X[:, :3, 3]) for X in (X_WE, X_WB)]
    links = np.concatenate((view.links, np.zeros_like(view.links)), axis=1)
    return np.concatenate((*frames, view.jacobian, links), axis=2)


def _of_frame(R: Array, lever: Array) -> Array:
    """Return the columns of a frame's error, shape (n, 6, 6)."""
    G = np.zeros((len(R), 6, 6))
    G[:, :3, :3] = G[:, 3:, 3:] = R
    G[:, :3, 3:] = np.cross(R, lever[:, :, None], axisa=1, axisb=1, axisc=1)
    return G
