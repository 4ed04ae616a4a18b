"""Drake, discrete plant: reaction forces between moving bodies are zero before the first step."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia, UnitInertia, WeldJoint
from pydrake.systems.analysis import Simulator

plant, inertia = MultibodyPlant(1e-3), SpatialInertia(5.0, np.zeros(3), UnitInertia(0.1, 0.1, 0.1))
hand, load = plant.AddRigidBody("hand", inertia), plant.AddRigidBody("load", inertia)
plant.AddJoint(PrismaticJoint("slide", plant.world_frame(), hand.body_frame(), [1, 0, 0]))
grasp = plant.AddJoint(WeldJoint("grasp", hand.body_frame(), load.body_frame(), RigidTransform()))
plant.Finalize()
simulator = Simulator(plant)
simulator.Initialize()
for name in ("comes:", "right:"):
    forces = plant.get_reaction_forces_output_port().Eval(simulator.get_context())
    print(name, forces[int(grasp.index())].translational().round(4).tolist(), "N")
    simulator.AdvanceTo(1e-3)
