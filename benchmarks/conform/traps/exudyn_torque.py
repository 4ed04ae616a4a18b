"""Exudyn, generic joint: `TorqueLocal` has multipliers of its rows; about y and z with the other sign."""

import exudyn as exu
import numpy as np
from exudyn.itemInterface import LoadTorqueVector, MarkerBodyRigid
from exudyn.rigidBodyUtilities import RigidBodyInertia

mbs = exu.SystemContainer().AddSystem()
ground, body = mbs.CreateGround(), mbs.CreateRigidBody(inertia=RigidBodyInertia(2.0, 0.1 * np.eye(3)))
joint = mbs.CreateGenericJoint(itemNumbers=[ground, body], position=[0, 0, 0], show=False)
marker = mbs.AddMarker(MarkerBodyRigid(bodyNumber=body))
mbs.AddLoad(LoadTorqueVector(markerNumber=marker, loadVector=[0.5, -0.3, 0.2]))  # the joint holds against it
mbs.Assemble()
settings = exu.SimulationSettings()
settings.timeIntegration.endTime, settings.solution.file.write = 0.1, False
mbs.SolveDynamic(settings, storeSolver=False)
m = mbs.GetObjectOutput(joint, exu.OutputVariableType.TorqueLocal)
print("comes:", m.round(6).tolist(), "N m on the ground")
print("right:", (m * (1, -1, -1)).round(6).tolist(), "N m on the ground")
