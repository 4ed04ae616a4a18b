# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Closing the chain, and what an internal force is
#
# Two arms that hold one bar are a closed chain: the bar's pose through the left arm *is* its pose through the right one. You will see
#
# 1. how the chain is closed, and in how many ways,
# 2. which numbers rigid bodies determine, and which nobody can know,
# 3. the wrench on each arm split into **load**, which moves the bar, and **internal force**, which moves nothing,
# 4. that a squeeze by the torques is felt at once and to the last digit,
# 5. the squeeze in 3-D.
#
# The notebook runs in a few seconds.

# %%
# %matplotlib inline
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import coop_pin as cp
from coop_pin.spatial import internal_wrenches, load_wrenches
from coop_pin.viz import notebook_view

np.set_printoptions(precision=3, suppress=True)

# %% [markdown]
# ## Close it
# A scenario states where the *payload* starts. Joint angles follow: each arm is closed onto its grasp, near its `posture`.

# %%
scenario = cp.Scenario.load("adept-paper")
cell = scenario.cell
plant = cp.CellChain(cell)
q = plant.configuration(scenario.start.matrix)
print("joint angles:", q)
for name, gap in zip(cell.arms, plant.closure_errors(q), strict=True):
    print(f"{name:6} tip is {gap.distance:.1e} m and {gap.angle:.1e} rad from its grasp")

# %% [markdown]
# There is more than one way to hold the bar there. The posture chooses.

# %%
for name, arm in cell.arms.items():
    model = cp.ArmModel(arm, cell.grasps[name].matrix)
    for branch in cp.ik_branches(name, model, scenario.start.matrix, arm.posture):
        print(f"{name:6} {branch}")

# %% [markdown]
# ## Count
# Six joints and one weld of six rows. In the plane only three of the rows are independent: the arms cannot lift or tilt the bar anyway.
# So 6 - 3 = 3 freedoms are left, those of a bar in the plane.

# %%
rest = np.zeros_like(q)
dynamics = plant.chain.forward_dynamics(q, rest, rest)
print(f"{len(q)} joints, 6 closure rows, rank {dynamics.rank}: {len(q) - dynamics.rank} freedoms")

# %% [markdown]
# The three dependent rows have a price: which arm carries how much of the bar's *weight* cannot be known from rigid bodies. coop_pin
# says NaN there; a number would be invented.

# %%
short = cp.run(scenario, {"duration": 0.5, "events": []})
determined = short.data["wrench_is_determined"]
print(dict(zip(determined["axis"].values.tolist(), determined.values.tolist(), strict=True)))

# %% [markdown]
# ## Split
# Accelerate the bar with some torques, and read the wrench F on each arm by the bar (about the bar's centre; x, y and the turn about z).
# With shares c = 1/2: load c ΣF, internal force f = F - c ΣF.

# %%
rows, shares = cell.task_rows, cell.shares
torque = np.array([3.0, -1.0, 0.5, 2.0, 1.0, -0.5])


def wrenches(torque):
    return np.array([rows.select(F) for F in plant.interaction_wrenches(q, rest, torque)])


F = wrenches(torque)
parts = {"F on the arm": F, "load": load_wrenches(F, shares), "internal": internal_wrenches(F, shares)}
columns = pd.MultiIndex.from_product([parts, ["x, N", "y, N", "turn, N m"]])
pd.DataFrame(np.hstack(list(parts.values())), index=list(cell.arms), columns=columns).round(3)

# %% [markdown]
# The internal parts sum to zero. Shares are bookkeeping: give the left arm 80 % of the load, and another part is called internal,
# with the same motion.

# %%
for split in ((0.5, 0.5), (0.8, 0.2)):
    print(f"shares {split}: internal force on the left arm {internal_wrenches(F, np.array(split))[0]}")

# %% [markdown]
# ## Squeeze
# Add torques $J_i^\top w_i$ with $\sum_i w_i = 0$. Nothing moves differently, and the internal wrench changes by exactly $-w_i$. It has no
# dynamics of its own: it is there at once.

# %%
w = {"left": np.array([10.0, 0.0, 0.0]), "right": np.array([-10.0, 0.0, 0.0])}
squeezed = torque.copy()
for name, place in zip(cell.arms, plant.tree.arms, strict=True):
    model = cp.ArmModel(cell.arms[name], cell.grasps[name].matrix)
    squeezed[place.v_slice] += rows.select(model.payload_jacobian(q[place.q_slice])).T @ w[name]
before, after = (plant.chain.forward_dynamics(q, rest, tau).acceleration for tau in (torque, squeezed))
print(f"accelerations differ by {np.abs(after - before).max():.1e} rad/s²")
print(
    "internal force on the left arm:",
    internal_wrenches(F, shares)[0],
    "->",
    internal_wrenches(wrenches(squeezed), shares)[0],
)

# %% [markdown]
# ## In a run
# The law squeezes by 10 N along the bar, in the axes of the bar, while it moves. Axial is along the line between the tips (negative:
# squeeze), shear across it.

# %%
ramp = {
    "kind": "ramp",
    "goal": {"left": [-30, 0, 0, 0, 0, 0], "right": [30, 0, 0, 0, 0, 0]},
    "start_time": 1.0,
    "duration": 3.0,
}
result = cp.run(scenario, {"squeeze": ramp, "controller.gains.sign_gain": 0.0, "duration": 6.0, "events": []})
notebook_view(result)

# %%
internal, desired = (
    result.data[name].sel(arm="left", axis=["x", "y"])
    for name in ("internal_wrench", "desired_internal_wrench")
)
figure, axes = plt.subplots(figsize=(7, 2.6))
for part, values in (("internal", internal), ("desired", desired)):
    axes.plot(
        result.data["time"], np.linalg.norm(values, axis=1), "-" if part == "internal" else "--", label=part
    )
axes.set(xlabel="time (s)", ylabel="size of the force (N)", title="internal force on the left arm")
axes.legend()
plt.show()

# %% [markdown]
# ## Try
# - `"controller.gains.sign_gain": 0.5` in the last run: the integrals of the two arms disagree, and the disagreement is internal force.
# - `"plant.payload": "free"`: the bar floats and both arms close on it. The same wrenches, computed another way.
# - `cp.Scenario.load("three-ur5-plate")`: three arms in space; how many freedoms, and how many internal components?
# - shares (1, 0): the left arm carries everything. Is the bar squeezed less?
