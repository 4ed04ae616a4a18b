"""Pinocchio tree of a cell: its arms, and the payload welded to a tip or on a free-flyer joint."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import inverse_pose
from coop_pin.description.cell.cell import Cell
from coop_pin.description.events import Surroundings
from coop_pin.model.joint_angles import JointAngles
from coop_pin.model.pinocchio_model import (
    add_frame,
    append_arm,
    empty_model,
    frame_id,
    load_arm_model,
)

PayloadAttachment: TypeAlias = Literal["welded", "free"]


class ArmPlace(NamedTuple):
    """Position of an arm in the tree of a cell, and its numbers that need no model.

    Attributes:
        name: Name of the arm.
        joints: Indices of its joints.
        q_slice: Entries of q that are its own.
        v_slice: Entries of v that are its own.
        tip: Index of its tip frame.
        drive: Drive matrix T, shape (nv, nv).
        from_drive: Inverse transmission T^-1, shape (nv, nv).
        angles: Conversion between its joint angles and its entries of q.
        posture: Angles of its posture, zero without one, rad or m, shape (nv,).
        share: Load share c.
    """

    name: str
    joints: tuple[int, ...]
    q_slice: slice
    v_slice: slice
    tip: int
    drive: Array
    from_drive: Array
    angles: JointAngles
    posture: Array
    share: float

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the arm's joints in its URDF, in the order of v."""
        return tuple(name.removeprefix(f"{self.name}/") for name in self.angles.names)


class CellModel:
    """Pinocchio tree of a cell, without its loop closures.

    Frames: ``<arm>/<frame of the URDF>``, ``<arm>/grasp`` (the tip E), ``payload`` (P) and ``payload/<arm>``
    (the grasp of an arm on the payload).

    Attributes:
        model: the Pinocchio model.
        arms: position of each arm in the tree.
        closed_by_tree: names of the arms whose grasp is a weld in the tree (the first one with a rigid grasp,
            if the payload is welded).
        payload_frame: index of frame P.
        payload_joint: index of the joint that carries the payload.
        surroundings: payload and gravity as they are set.
        payload_inertia: inertia of the payload in its own frame.
        carrier_inertia: inertia that the payload's joint carries besides the payload.
    """

    def __init__(self, cell: Cell, payload: PayloadAttachment) -> None:
        """Build the tree.

        Args:
            cell: the description.
            payload: "welded" to the tip of the first arm with a rigid grasp, or "free", on a free-flyer
                joint, as it always is if no grasp is rigid. The other rigid grasps need closures.
        """
        self.model = model = _arms_tree(cell)
        first = next((name for name, rows in cell.closing.items() if rows == "full"), None)
        if payload == "free" or first is None:
            self.closed_by_tree: tuple[str, ...] = ()
            self._X_JP = pin.SE3.Identity()
            joint = model.addJoint(0, pin.JointModelFreeFlyer(), self._X_JP, "payload")
        else:
            self.closed_by_tree = (first,)
            tip = model.frames[frame_id(model, f"{first}/grasp")]
            self._X_JP = tip.placement * pin.SE3(inverse_pose(cell.grasps[first].matrix))
            joint = tip.parentJoint
        self.payload_joint = int(joint)
        self.carrier_inertia = model.inertias[self.payload_joint].copy()
        self.payload_frame = add_frame(model, "payload", self.payload_joint, self._X_JP)
        for name in cell.arms:
            X_JE = self._X_JP * pin.SE3(cell.grasps[name].matrix)
            add_frame(model, f"payload/{name}", self.payload_joint, X_JE)
        self.arms = tuple(_place(model, name, cell) for name in cell.arms)
        self.surround(cell.surroundings)

    def surround(self, surroundings: Surroundings) -> None:
        """Set the payload's inertia and gravity in the model, which is changed in place."""
        self.surroundings = surroundings
        self.payload_inertia = pin.Inertia(surroundings.mass, np.zeros(3), surroundings.inertia)
        self.model.inertias[self.payload_joint] = self.carrier_inertia + self._X_JP.act(self.payload_inertia)
        self.model.gravity.linear = surroundings.gravity

    def configuration(self, arm_configurations: list[Array], X_WP: Array) -> Array:
        """Return q of the tree from each arm's configuration and the payload pose X_WP."""
        q = pin.neutral(self.model)
        for arm, configuration in zip(self.arms, arm_configurations, strict=True):
            q[arm.q_slice] = configuration
        if not self.closed_by_tree:
            q[self.model.idx_qs[self.payload_joint] :][:7] = pin.SE3ToXYZQUAT(pin.SE3(X_WP))
        return q


def _arms_tree(cell: Cell) -> pin.Model:
    model = empty_model(cell.gravity)
    for name, arm in cell.arms.items():
        alone = load_arm_model(arm)
        tip = alone.frames[frame_id(alone, arm.tip, f"{arm.urdf!r}, the tip of arm {name!r}")].copy()
        for frame in alone.frames:
            if frame.name == "grasp":  # a frame of the URDF, which must not hide the tip's
                frame.name = "urdf/grasp"
        add_frame(alone, "grasp", tip.parentJoint, tip.placement)
        model = append_arm(model, alone, name, arm.base.matrix)
    return model


def _place(model: pin.Model, name: str, cell: Cell) -> ArmPlace:
    joints = tuple(number for number, joint in enumerate(model.names) if joint.startswith(f"{name}/"))
    first, last = joints[0], joints[-1]
    q = slice(int(model.idx_qs[first]), int(model.idx_qs[last] + model.nqs[last]))
    v = slice(int(model.idx_vs[first]), int(model.idx_vs[last] + model.nvs[last]))
    arm, nv = cell.arms[name], v.stop - v.start
    return ArmPlace(
        name,
        joints,
        q,
        v,
        frame_id(model, f"{name}/grasp"),
        drive=arm.drive_matrix(nv),
        from_drive=np.asarray(np.linalg.inv(arm.drive_matrix(nv)), dtype=np.float64),
        angles=JointAngles(model, joints),
        posture=np.zeros(nv) if arm.posture is None else np.array(arm.posture),
        share=cell.share(name),
    )
