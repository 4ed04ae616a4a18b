"""The two arms of one robot carry a box: one URDF, named twice, each time with the rest of it locked.

A joint that moves both arms (a torso) is refused until it is locked in both. ``cp.new_cell(["baxter"])``
makes such a cell from the name of the robot alone.
"""

import coop_pin as cp

scenario = cp.Scenario.load("baxter-box", {"duration": 2.0})
for name, arm in scenario.cell.arms.items():
    print(f"{name}: {arm.tip}, {len(arm.locked)} joints of the robot are locked")
print("arms of one robot:", scenario.cell.siblings("left"))
result = cp.run(scenario)
force = result.internal_force(window=(1.0, 2.0))
print(f"{result.verdict()}; internal force {force.axial_mean:.1f} N along the box")
