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
# Two arms that hold one bar form a closed chain: the pose of the bar from the left arm's kinematics equals
# that from the right arm's. This notebook shows
#
# 1. inverse kinematics: how the chain is closed, and its branches,
# 2. which components of the wrenches rigid bodies determine, and which they do not,
# 3. the wrench on each arm split into **load**, which moves the bar, and **internal force**, which does
#    not,
# 4. that torques which squeeze the bar change the internal force instantly and exactly,
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
# ## Close the chain
# A scenario states the initial pose of the *payload*. The joint angles follow by inverse kinematics: each
# arm reaches its grasp at the solution nearest to its `posture`.

# %%
scenario = cp.Scenario.load("adept-paper")
cell = scenario.cell
plant = cp.grasps.CellChain(cell)
q = plant.configuration(scenario.start.matrix)
print("joint angles:", q)
for name, gap in zip(cell.arms, plant.closure_errors(q), strict=True):
    print(f"{name:6} tip is {gap.distance:.1e} m and {gap.angle:.1e} rad from its grasp")

# %% [markdown]
# Each arm has two inverse-kinematics branches there; the posture selects one.

# %%
for name, arm in cell.arms.items():
    model = cp.model.CellArm(cell, name)
    for branch in cp.model.ik_branches(model, scenario.start.matrix, posture=arm.posture):
        print(f"{name:6} {branch}")

# %% [markdown]
# ## Degrees of freedom
# Six joints and one weld of six rows. In the plane only three of the rows are independent, because the arms
# can neither lift nor tilt the bar. So 6 - 3 = 3 degrees of freedom are left, those of a bar in the plane.

# %%
rest = np.zeros_like(q)
dynamics = plant.mechanism.forward_dynamics(q, rest, rest)
print(f"{len(q)} joints, 6 closure rows, rank {dynamics.rank}: {len(q) - dynamics.rank} degrees of freedom")

# %% [markdown]
# Because three rows are dependent, rigid-body dynamics does not determine how much of the bar's *weight*
# each arm carries. coop_pin returns NaN for these rows instead of an arbitrary number.

# %%
short = cp.run(scenario, {"duration": 0.5, "events": []})
determined = short.data["wrench_is_determined"]
print(dict(zip(determined["axis"].values.tolist(), determined.values.tolist(), strict=True)))

# %% [markdown]
# ## Load and internal wrench
# Apply some torques and compute the wrench F on each arm by the bar (about the bar's centre; rows x, y and
# the rotation about z). With load shares c = 1/2: load c ΣF, internal force f = F - c ΣF.

# %%
rows, shares = cell.task_rows, cell.shares
torque = np.array([3.0, -1.0, 0.5, 2.0, 1.0, -0.5])


def wrenches(torque):
    return np.array([rows.select(F) for F in plant.interaction_wrenches(q, rest, torque)])


F = wrenches(torque)
parts = {"F on the arm": F, "load": load_wrenches(F, shares), "internal": internal_wrenches(F, shares)}
columns = pd.MultiIndex.from_product([parts, ["x, N", "y, N", "about z, N m"]])
pd.DataFrame(np.hstack(list(parts.values())), index=list(cell.arms), columns=columns).round(3)

# %% [markdown]
# The internal parts sum to zero. The load shares only define the split: with 80 % of the load assigned to
# the left arm, another part of the wrench is internal, and the motion is the same.

# %%
for split in ((0.5, 0.5), (0.8, 0.2)):
    print(f"shares {split}: internal force on the left arm {internal_wrenches(F, np.array(split))[0]}")

# %% [markdown]
# ## Squeeze
# Add torques $J_i^\top w_i$ with $\sum_i w_i = 0$. The motion does not change, and the internal wrench
# changes by exactly $-w_i$. It has no dynamics of its own: it changes in the same instant.

# %%
w = {"left": np.array([10.0, 0.0, 0.0]), "right": np.array([-10.0, 0.0, 0.0])}
squeezed = torque.copy()
for place in plant.model.arms:
    model = cp.model.CellArm(cell, place.name)
    squeezed[place.v_slice] += rows.select(model.payload_jacobian(q[place.q_slice])).T @ w[place.name]
before, after = (plant.mechanism.forward_dynamics(q, rest, tau).acceleration for tau in (torque, squeezed))
print(f"accelerations differ by {np.abs(after - before).max():.1e} rad/s²")
print(
    "internal force on the left arm:",
    internal_wrenches(F, shares)[0],
    "->",
    internal_wrenches(wrenches(squeezed), shares)[0],
)

# %% [markdown]
# ## In a run
# The desired squeeze is a ramp to 30 N along the bar, in the axes of the bar, while the bar moves.

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
axes.set(xlabel="time (s)", ylabel="magnitude (N)", title="internal force on the left arm")
axes.legend()
plt.show()

# %% [markdown]
# ## Try
# - `"controller.gains.sign_gain": 0.5` in the last run: the integrals of the two arms differ, and the
#   difference is internal force.
# - `"plant.payload": "free"`: the bar is a floating body with a closure to each arm. The wrenches are the
#   same.
# - `cp.Scenario.load("three-ur5-plate")`: three arms in space. How many degrees of freedom, and how many
#   internal components?
# - shares (1, 0): the left arm carries the whole load. Is the bar squeezed less?
