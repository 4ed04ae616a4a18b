"""Drake: the payload on the first hand by a joint, whose reaction is read; the other grasps as constraints."""

import importlib.metadata

import numpy as np
from cases import Case, Hand
from engine import hands_urdf, in_payload_axes, joints, start
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame, LinearBushingRollPitchYaw, RevoluteJoint, SpatialInertia, UnitInertia, WeldJoint,
)  # fmt: skip
from pydrake.systems.analysis import Simulator

H = 1e-3


class Drake:
    """Discrete MultibodyPlant: two ball constraints are a hinge, a bushing is a compliant grasp."""

    name = f"Drake {importlib.metadata.version('drake')}"
    settings = f"discrete MultibodyPlant (SAP), {H:g} s"
    reading = (
        "first hand: `get_reaction_forces_output_port` of its joint, on the child in its frame; the other:"
        " Newton-Euler of the payload with `get_body_spatial_accelerations_output_port`"
    )

    def wrenches(self, case: Case) -> np.ndarray:
        plant, hands = MultibodyPlant(H), list(enumerate(case.hands))
        Parser(plant).AddModelsFromString(hands_urdf(case), "urdf")
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("ground"))
        plant.mutable_gravity_field().set_gravity_vector(case.gravity)
        inertia = SpatialInertia(case.mass, np.zeros(3), UnitInertia(*np.array(case.inertia) / case.mass))
        payload = plant.AddRigidBody("payload", plant.AddModelInstance("payload"), inertia)
        grasps = [plant.AddFrame(FixedOffsetFrame(f"grasp{k}", payload.body_frame(), RigidTransform(h.pose))) for k, h in hands]
        tips = [plant.GetFrameByName(f"hand{k}_tip") for k, _ in hands]
        held = self.joint(plant, case.hands[0], tips[0], grasps[0])
        for (k, hand), tip, grasp in list(zip(hands, tips, grasps, strict=True))[1:]:
            if hand.grasp == "rigid":
                X = RigidTransform()
                plant.AddWeldConstraint(payload, RigidTransform(hand.pose), tip.body(), tip.GetFixedPoseInBodyFrame() @ X)
            elif hand.grasp == "hinge":
                for z in (-0.1, 0.1):
                    point = np.array((0.0, 0.0, z))
                    on_hand = tip.GetFixedPoseInBodyFrame() @ point
                    plant.AddBallConstraint(payload, RigidTransform(hand.pose) @ point, tip.body(), on_hand)
            else:
                K, D = np.array(hand.spring), np.array(hand.damper)
                plant.AddForceElement(LinearBushingRollPitchYaw(grasp, tip, K[3:], D[3:], K[:3], D[:3]))
        plant.Finalize()
        simulator = Simulator(plant)
        context, port = simulator.get_mutable_context(), plant.get_applied_generalized_force_input_port()
        drives = [[plant.GetJointByName(name) for name in joints(hand, f"hand{k}")] for k, hand in hands]
        for each, rate in ((j, start(case)[j.name()]) for drive in drives for j in drive):
            plant.SetVelocities(context, plant.GetVelocities(context))
            set_rate = each.set_translation_rate if "prismatic" in each.type_name() else each.set_angular_rate
            set_rate(context, rate)
        value = port.FixValue(context, np.zeros(plant.num_velocities()))
        simulator.Initialize()
        for tick in range(round(case.time / H)):
            u = np.zeros(plant.num_velocities())
            for (_, hand), drive in zip(hands, drives, strict=True):
                state = np.array([(each.GetOnePosition(context), each.GetOneVelocity(context)) for each in drive])
                u[[each.velocity_start() for each in drive]] = hand.force(*state.T)
            value.GetMutableData().set_value(u)
            simulator.AdvanceTo((tick + 1) * H)
        return self.read(case, plant, context, payload, held)

    def joint(self, plant: MultibodyPlant, hand: Hand, tip: object, grasp: object) -> object:
        if hand.grasp == "hinge":
            return plant.AddJoint(RevoluteJoint("held", tip, grasp, (0.0, 0.0, 1.0)))
        return plant.AddJoint(WeldJoint("held", tip, grasp, RigidTransform()))

    def read(self, case: Case, plant: MultibodyPlant, context: object, payload: object, held: object) -> np.ndarray:
        F = plant.get_reaction_forces_output_port().Eval(context)[int(held.index())]
        X_PC = held.frame_on_child().GetFixedPoseInBodyFrame()
        f, m = (X_PC.rotation().matrix() @ each for each in (F.translational(), F.rotational()))
        first = np.concatenate((f, m + np.cross(X_PC.translation(), f)))
        R = plant.EvalBodyPoseInWorld(context, payload).rotation().matrix()
        a = plant.get_body_spatial_accelerations_output_port().Eval(context)[int(payload.index())]
        w, inertia = R.T @ plant.EvalBodySpatialVelocityInWorld(context, payload).rotational(), np.diag(case.inertia)
        load = case.mass * (R.T @ (a.translational() - np.array(case.gravity)))
        moment = inertia @ (R.T @ a.rotational()) + np.cross(w, inertia @ w)
        return np.array((first, np.concatenate((load, moment)) - first))
