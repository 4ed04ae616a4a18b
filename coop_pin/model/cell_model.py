"""A cell as one Pinocchio tree: arms side by side, and the payload welded at the first tip or floating free."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.description.payload import Payload
from coop_pin.model.arm_model import load_arm_model
from coop_pin.model.joint_angles import JointAngles
from coop_pin.model.pinocchio_model import add_frame, append_arm, empty_model, frame_id, joint_id
from coop_pin.spatial import inverse_pose


class ArmPlace(NamedTuple):
    """Where an arm sits in the tree.

    Attributes:
        name: the arm.
        q: its entries of q.
        v: its entries of v.
        tip: index of its tip frame.
        drive: drive matrix T, shape (nv, nv).
        angles: reads joint angles from its entries of q.
    """

    name: str
    q: slice
    v: slice
    tip: int
    drive: Array
    angles: JointAngles


class CellModel:
    """The tree of a cell before its closures.

    Frames: ``<arm>/<frame of the URDF>``, ``<arm>/grasp`` (the tip E), ``payload`` (P) and ``payload/<arm>``
    (where the arm grips).

    Attributes:
        model: the Pinocchio model.
        arms: where each arm sits.
        closed_by_tree: names of arms whose grasp the tree itself holds (the first, when the payload is
            welded).
        payload_frame: index of frame P.
        payload_joint: the joint that carries the payload.
    """

    def __init__(
        self,
        cell: Cell,
        payload_joint: int,
        model: pin.Model,
        X_joint_payload: pin.SE3,
        rooted_at: str | None,
    ) -> None:
        self.model, self.payload_joint, self._X_joint_payload = model, payload_joint, X_joint_payload
        self.closed_by_tree = () if rooted_at is None else (rooted_at,)
        self._carrier_inertia = model.inertias[payload_joint].copy()
        self.payload_frame = add_frame(model, "payload", payload_joint, X_joint_payload)
        for name in cell.arms:
            add_frame(
                model, f"payload/{name}", payload_joint, X_joint_payload * pin.SE3(cell.grasps[name].matrix)
            )
        self.arms = tuple(_place(model, name, cell) for name in cell.arms)
        self.set_payload(cell.payload)

    def set_payload(self, payload: Payload) -> None:
        """Give the payload another mass and inertia, at once."""
        self.payload_inertia = pin.Inertia(payload.mass, np.zeros(3), payload.inertia_matrix)
        self.model.inertias[self.payload_joint] = self._carrier_inertia + self._X_joint_payload.act(
            self.payload_inertia
        )

    def configuration(self, arm_configurations: list[Array], X_WP: Array) -> Array:
        """Return q of the tree from each arm's entries of q and the payload pose."""
        q = pin.neutral(self.model)
        for arm, configuration in zip(self.arms, arm_configurations, strict=True):
            q[arm.q] = configuration
        if not self.closed_by_tree:
            q[self.model.idx_qs[self.payload_joint] :][:7] = pin.SE3ToXYZQUAT(pin.SE3(X_WP))
        return q


def welded_cell_model(cell: Cell) -> CellModel:
    """Return the tree with the payload welded at the first arm's tip: m - 1 grasps remain to be closed."""
    model = _arms_tree(cell)
    first = next(iter(cell.arms))
    tip = model.frames[frame_id(model, f"{first}/grasp")]
    X_EP = pin.SE3(inverse_pose(cell.grasps[first].matrix))
    return CellModel(cell, int(tip.parentJoint), model, tip.placement * X_EP, rooted_at=first)


def free_cell_model(cell: Cell) -> CellModel:
    """Return the tree with the payload on a free-flyer joint: all m grasps remain to be closed."""
    model = _arms_tree(cell)
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "payload")
    return CellModel(cell, int(joint), model, pin.SE3.Identity(), rooted_at=None)


CELL_MODELS: dict[str, Callable[[Cell], CellModel]] = {"welded": welded_cell_model, "free": free_cell_model}


def _arms_tree(cell: Cell) -> pin.Model:
    model = empty_model(cell.gravity)
    for name, arm in cell.arms.items():
        alone = load_arm_model(arm)
        tip = alone.frames[frame_id(alone, arm.tip)].copy()
        for frame in alone.frames:
            if frame.name == "grasp":  # a link of the URDF
                frame.name = "urdf/grasp"
        add_frame(alone, "grasp", tip.parentJoint, tip.placement)
        model = append_arm(model, alone, name, arm.base.matrix)
    return model


def _place(model: pin.Model, name: str, cell: Cell) -> ArmPlace:
    joints = [joint_id(model, joint) for joint in list(model.names) if joint.startswith(f"{name}/")]
    first, last = joints[0], joints[-1]
    q = slice(int(model.idx_qs[first]), int(model.idx_qs[last] + model.nqs[last]))
    v = slice(int(model.idx_vs[first]), int(model.idx_vs[last] + model.nvs[last]))
    drive = cell.arms[name].drive_matrix(v.stop - v.start)
    return ArmPlace(name, q, v, frame_id(model, f"{name}/grasp"), drive, JointAngles(model, first, last))
