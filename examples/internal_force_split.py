"""Load and internal wrenches: torques J^T w with sum(w) = 0 add w to the internal wrenches only."""

import numpy as np

import coop_pin as cp
from coop_pin.spatial import internal_wrenches, load_wrenches

scenario = cp.Scenario.load("adept-paper")
cell, rows = scenario.cell, scenario.cell.task_rows
plant = cp.grasps.CellChain(cell)
q = plant.configuration(scenario.start.matrix)
v = np.zeros_like(q)

torque = np.array([3.0, -1.0, 0.5, 2.0, 1.0, -0.5])
squeezed = torque.copy()
for place, w in zip(plant.model.arms, ([10.0, 0.0, 0.0], [-10.0, 0.0, 0.0]), strict=True):
    arm = cp.model.CellArm(cell, place.name)
    squeezed[place.v_slice] += rows.select(arm.payload_jacobian(q[place.q_slice])).T @ np.array(w)

for name, tau in (("as it is", torque), ("squeezed", squeezed)):
    F = np.array([rows.select(wrench) for wrench in plant.interaction_wrenches(q, v, tau)])
    load, internal = load_wrenches(F, cell.shares)[0], internal_wrenches(F, cell.shares)[0]
    acceleration = plant.mechanism.forward_dynamics(q, v, tau).acceleration
    print(f"{name}: load {load.round(6)}, internal {internal.round(6)}, ", end="")
    print(f"joint accelerations {acceleration[:3].round(6)}")
