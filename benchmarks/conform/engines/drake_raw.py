"""Drake: the first hand holds the payload by a joint, whose reaction is read, the others by constraints."""

import importlib.metadata

import numpy as np
from cases import Case
from engine import about_P, hands_urdf, joints, load, start
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    LinearBushingRollPitchYaw,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
    WeldJoint,
)
from pydrake.systems.analysis import Simulator

H = 1e-3


class Drake:
    """Two ball constraints are a hinge, a bushing is a compliant grasp."""

    name = f"Drake {importlib.metadata.version('drake')}"
    settings = f"discrete MultibodyPlant, SAP, {H:g} s"
    reading = (
        "first hand: `get_reaction_forces_output_port` of its joint, on the child in its frame; the other:"
        " what Newton and Euler leave of `get_body_spatial_accelerations_output_port`"
    )

    def wrenches(self, case: Case) -> np.ndarray:
        plant, hands = MultibodyPlant(H), list(enumerate(case.hands))
        Parser(plant).AddModelsFromString(hands_urdf(case), "urdf")
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("ground"))
        plant.mutable_gravity_field().set_gravity_vector(case.gravity)
        inertia = SpatialInertia(case.mass, np.zeros(3), UnitInertia(*np.array(case.inertia) / case.mass))
        payload = plant.AddRigidBody("payload", plant.AddModelInstance("payload"), inertia)
        poses = [RigidTransform(hand.pose) for hand in case.hands]
        frames = [FixedOffsetFrame(f"grasp{k}", payload.body_frame(), X) for k, X in enumerate(poses)]
        grasps = [plant.AddFrame(frame) for frame in frames]
        tips = [plant.GetFrameByName(f"hand{k}_tip") for k, _ in hands]
        is_hinge, first = case.hands[0].grasp == "hinge", ("held", tips[0], grasps[0])
        joint = RevoluteJoint(*first, (0.0, 0.0, 1.0)) if is_hinge else WeldJoint(*first, RigidTransform())
        held = plant.AddJoint(joint)
        for hand, tip, grasp, X_PE in list(zip(case.hands, tips, grasps, poses, strict=True))[1:]:
            X_HE, body = tip.GetFixedPoseInBodyFrame(), tip.body()
            if hand.grasp == "rigid":
                plant.AddWeldConstraint(payload, X_PE, body, X_HE)
            elif hand.grasp == "hinge":
                for point in (np.array((0.0, 0.0, z)) for z in (-0.1, 0.1)):
                    plant.AddBallConstraint(payload, X_PE @ point, body, X_HE @ point)
            else:
                K, D = np.array(hand.spring), np.array(hand.damper)
                plant.AddForceElement(LinearBushingRollPitchYaw(grasp, tip, K[3:], D[3:], K[:3], D[:3]))
        plant.Finalize()
        simulator, v = Simulator(plant), np.zeros(plant.num_velocities())
        context, port = simulator.get_mutable_context(), plant.get_applied_generalized_force_input_port()
        drives = [[plant.GetJointByName(name) for name in joints(hand, f"hand{k}")] for k, hand in hands]
        for each in (joint for drive in drives for joint in drive):
            v[each.velocity_start()] = start(case)[each.name()]
        plant.SetVelocities(context, v)
        value = port.FixValue(context, np.zeros_like(v))
        for tick in range(round(case.time / H)):
            u = np.zeros_like(v)
            for (_, hand), drive in zip(hands, drives, strict=True):
                state = [(each.GetOnePosition(context), each.GetOneVelocity(context)) for each in drive]
                u[[each.velocity_start() for each in drive]] = hand.force(*np.array(state).T)
            value.GetMutableData().set_value(u)
            simulator.AdvanceTo((tick + 1) * H)
        F = plant.get_reaction_forces_output_port().Eval(context)[int(held.index())]
        first = about_P(case.hands[0], F.translational(), F.rotational())
        V = plant.EvalBodySpatialVelocityInWorld(context, payload)
        a = plant.get_body_spatial_accelerations_output_port().Eval(context)[int(payload.index())]
        twist, rate = (np.concatenate((each.translational(), each.rotational())) for each in (V, a))
        R_P = plant.EvalBodyPoseInWorld(context, payload).rotation().matrix()
        return np.array((first, load(case, R_P, twist, rate) - first))
