"""Pinocchio tree of a cell: its arms, and the payload welded to a tip or on a free-flyer joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import inverse_pose
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.miscalibration import Miscalibration
from coop_pin.description.cell.shared_joint import SharedJoints
from coop_pin.description.events import Surroundings
from coop_pin.model.joint_angles import JointAngles
from coop_pin.model.mechanism_model import LinkedPayload
from coop_pin.model.pinocchio_model import (
    add_frame,
    append_arm,
    append_part,
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


class SharedPlace(NamedTuple):
    """Position of a shared joint in the tree of a cell.

    Attributes:
        joint: Index of the joint, which the tree names ``shared.<joint of the URDF>``.
        q_slice: Entries of q that are its own.
        v_slice: Entry of v that is its own.
        angles: Conversion between its angle and its entries of q.
        start: Angle at the start, m or rad.
        effort: Effort limit of the URDF, N or N m.
        resistance: Viscous and Coulomb friction of the URDF, N s/m and N, or N m s/rad and N m.
    """

    joint: int
    q_slice: slice
    v_slice: slice
    angles: JointAngles
    start: float
    effort: float
    resistance: tuple[float, float]


class CellModel:
    """Pinocchio tree of a cell, without its loop closures.

    Frames: ``<arm>/<frame of the URDF>``, ``<arm>/grasp`` (the tip E), ``payload`` (P) and ``payload/<arm>``
    (the grasp of an arm on the payload).

    Attributes:
        model: the Pinocchio model.
        arms: position of each arm in the tree.
        carrier: shared joints with the arms that they carry; None without any.
        shared: position of each shared joint, from the root on, or of x, y and yaw of each base that rolls.
        wheels: positions of x, y and yaw of each base that rolls, by the name of its arm.
        fixed: inertia of the fixed part of the robot on shared joints, in world axes; none without any.
        closed_by_tree: names of the arms whose grasp is a weld in the tree (the first one with a rigid grasp,
            if the payload is welded).
        linked: the joints of a payload of several links, which no grasp welds; None of one body.
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
        self.carrier = cell.carrier
        self.model, self.fixed = _arms_tree(cell, self.carrier)
        model = self.model
        first = next((name for name, rows in cell.closing.items() if rows == "full"), None)
        links = cell.payload.links
        self.linked = None if links is None else LinkedPayload(model, links)
        self.closed_by_tree: tuple[str, ...] = ()
        if self.linked is not None:
            self.model = model = self.linked.model
            joint, self._X_JP = self.linked.joint, self.linked.X_JP
        elif payload == "free" or first is None:
            self._X_JP = pin.SE3.Identity()
            joint = model.addJoint(0, pin.JointModelFreeFlyer(), self._X_JP, "payload")
        else:
            self.closed_by_tree = (first,)
            tip = model.frames[frame_id(model, f"{first}/grasp")]
            self._X_JP = tip.placement * pin.SE3(inverse_pose(cell.grasps[first].matrix))
            joint = tip.parentJoint
        self.payload_joint = int(joint)
        self.carrier_inertia = model.inertias[self.payload_joint].copy()
        if self.linked is not None:  # less the link of P, which ``surround`` adds
            body = pin.Inertia(cell.payload.mass, np.zeros(3), cell.payload.inertia_matrix)
            self.carrier_inertia -= self._X_JP.act(body)
        self.payload_frame = add_frame(model, "payload", self.payload_joint, self._X_JP)
        for name in cell.arms:
            held, X_JE = self.payload_joint, self._X_JP * pin.SE3(cell.grasps[name].matrix)
            if self.linked is not None and links is not None and (link := cell.held_links.get(name)):
                held, X_JE = self.linked.held(link, inverse_pose(links.pose(link)) @ cell.grasps[name].matrix)
            add_frame(model, f"payload/{name}", held, X_JE)
        self.arms = tuple(_place(model, name, cell) for name in cell.arms)
        self.wheels = {name: _wheel_places(model, name) for name in cell.wheels}
        rolling = (wheel for wheels in self.wheels.values() for wheel in wheels)
        self.shared = (*_shared_places(model, cell, self.carrier), *rolling)
        self.surround(cell.surroundings)

    def surround(self, surroundings: Surroundings) -> None:
        """Set the payload's inertia and gravity in the model, which is changed in place."""
        self.surroundings = surroundings
        self.payload_inertia = pin.Inertia(surroundings.mass, np.zeros(3), surroundings.inertia)
        self.model.inertias[self.payload_joint] = self.carrier_inertia + self._X_JP.act(self.payload_inertia)
        self.model.gravity.linear = surroundings.gravity

    def root_joint(self, arm: str) -> int:
        """Return the joint that carries the root link of an arm: the world, 0, or the yaw of its base."""
        return self.wheels[arm][-1].joint if arm in self.wheels else 0

    def configuration(self, arm_configurations: list[Array], X_WP: Array) -> Array:
        """Return q of the tree from each arm's configuration and the payload pose X_WP."""
        q = pin.neutral(self.model)
        for arm, configuration in zip(self.arms, arm_configurations, strict=True):
            q[arm.q_slice] = configuration
        for slot in self.shared:
            q[slot.q_slice] = slot.angles.configuration(np.array([slot.start]))
        if self.linked is not None:
            q[self.linked.q_slice] = self.linked.angles.configuration(self.linked.start)
            return self.linked.configured(q, X_WP)
        if not self.closed_by_tree:
            q[self.model.idx_qs[self.payload_joint] :][:7] = pin.SE3ToXYZQUAT(pin.SE3(X_WP))
        return q


def _arms_tree(cell: Cell, carrier: SharedJoints | None) -> tuple[pin.Model, pin.Inertia]:
    """Return the tree of the arms, and the fixed part of the robot on shared joints, if there is one."""
    model, fixed = empty_model(cell.gravity), pin.Inertia.Zero()
    carried = () if carrier is None else carrier.arms
    for name, arm in cell.arms.items():
        if name not in carried:
            alone = load_arm_model(arm)
            _add_grasp(alone, arm, name)
            if arm.wheels is not None:
                model = _append_rolling(model, alone, name, arm)
            else:
                model = append_arm(model, alone, name, arm.base.matrix)
        elif name == carried[0]:
            whole, X_WB = _carried_tree(cell, carried), arm.base.matrix
            fixed = pin.SE3(X_WB).act(whole.inertias[0])
            model = append_part(model, whole, X_WB)
    return model, fixed


def _append_rolling(tree: pin.Model, alone: pin.Model, name: str, arm: Arm) -> pin.Model:
    """Return the tree with an arm on a rolling base added: x, y and yaw in axes of B, then its joints."""
    assert arm.wheels is not None
    base, joint = pin.Model(), 0
    axes = zip(("x", "y", "yaw"), (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRZ()), strict=True)
    for axis, kind in axes:
        joint = base.addJoint(joint, kind, pin.SE3.Identity(), f"shared.{name}.base_{axis}")
        base.addJointFrame(joint)  # of brakes of the joints above
    base.armature = arm.wheels.rotors
    deck = add_frame(base, f"shared.{name}.deck", joint, pin.SE3.Identity())
    return append_part(tree, append_arm(base, alone, name, np.eye(4), deck), arm.base.matrix)


def _add_grasp(alone: pin.Model, arm: Arm, name: str, prefix: str = "") -> None:
    tip = alone.frames[frame_id(alone, prefix + arm.tip, f"{arm.urdf!r}, the tip of arm {name!r}")].copy()
    for frame in alone.frames:
        if frame.name == f"{prefix}grasp":  # a frame of the URDF, which must not hide the tip's
            frame.name = f"{prefix}urdf/grasp"
    add_frame(alone, f"{prefix}grasp", tip.parentJoint, tip.placement)


def carried_robot(cell: Cell, names: Sequence[str]) -> Arm:
    """Return the robot on shared joints as one arm, in which these and the joints of all its arms move."""
    arms = [cell.arms[name] for name in names]
    locked = {
        joint: angle
        for joint, angle in arms[0].locked.items()
        if joint not in cell.shared_joints and all(joint in arm.locked for arm in arms)
    }
    bare = {"posture": None, "drive": None, "friction": "urdf", "torque_limits": "urdf", "armature": 0.0}
    return arms[0].replace(locked=locked, calibration_error=Miscalibration(), **bare)


def _carried_tree(cell: Cell, names: Sequence[str]) -> pin.Model:
    """Return the tree of a robot on shared joints: its links once, joints and frames by the arm they move."""
    whole = load_arm_model(carried_robot(cell, names))
    owners = {joint: name for name in names for joint in cell.arms[name].moving_joints()}
    rotors = {
        joint: rotor
        for name in names
        for joint, rotor in zip(
            cell.arms[name].moving_joints(), load_arm_model(cell.arms[name]).armature, strict=True
        )
    }
    whole.armature = np.array([rotors.get(joint, 0.0) for joint in list(whole.names)[1:]])
    for index, joint in enumerate(list(whole.names)[1:], start=1):
        whole.names[index] = f"{owners[joint]}/{joint}" if joint in owners else f"shared.{joint}"
    frames = [frame.copy() for frame in whole.frames]  # adding one moves the others in memory
    for frame in whole.frames:
        frame.name = f"{names[0]}/{frame.name}"
    for name in names[1:]:
        for frame in frames[1:]:
            add_frame(whole, f"{name}/{frame.name}", frame.parentJoint, frame.placement)
    for joint in cell.shared_joints:  # of brakes of the joints above
        index = int(whole.getJointId(f"shared.{joint}"))
        add_frame(whole, f"shared.{joint}", index, pin.SE3.Identity())
    for name in names:
        _add_grasp(whole, cell.arms[name], name, f"{name}/")
    return whole


def _shared_places(model: pin.Model, cell: Cell, carrier: SharedJoints | None) -> tuple[SharedPlace, ...]:
    """Return the position of each shared joint in the tree."""
    if carrier is None:
        return ()
    places, has_friction = [], cell.arms[carrier.arms[0]].friction == "urdf"
    for joint, start in zip(carrier.joints, carrier.start.tolist(), strict=True):
        index = int(model.getJointId(f"shared.{joint}"))
        q, v = int(model.idx_qs[index]), int(model.idx_vs[index])
        resistance = float(model.damping[v]), float(model.friction[v])
        places.append(
            SharedPlace(
                index,
                slice(q, q + int(model.nqs[index])),
                slice(v, v + 1),
                JointAngles(model, (index,)),
                start,
                float(model.upperEffortLimit[v]),
                resistance if has_friction else (0.0, 0.0),
            )
        )
    return tuple(places)


def _wheel_places(model: pin.Model, name: str) -> tuple[SharedPlace, ...]:
    """Return the positions of x, y and yaw of a rolling base in the tree."""
    places = []
    for axis in ("x", "y", "yaw"):
        index = int(model.getJointId(f"shared.{name}.base_{axis}"))
        q, v, angles = int(model.idx_qs[index]), int(model.idx_vs[index]), JointAngles(model, (index,))
        places.append(SharedPlace(index, slice(q, q + 1), slice(v, v + 1), angles, 0.0, np.inf, (0.0, 0.0)))
    return tuple(places)


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
