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
# # Your own arms
#
# From two URDF files and a box to a run that you can look at. You will see
#
# 1. arms, payload and grasps in ten lines,
# 2. a check before anything runs: reach, singular poses, limits,
# 3. the box carried under gravity by a law that knows no mass,
# 4. the motion in 3-D, and the numbers.
#
# The notebook runs in about ten seconds. Put your own URDF in place of `"ur5"`.

# %%
# %matplotlib inline
from pathlib import Path

import numpy as np
import pandas as pd

import coop_pin as cp
from coop_pin import figures
from coop_pin.viz import notebook_view

# %% [markdown]
# ## Arms
# A path or a name of example-robot-data; the frame that grips; where the arm stands; and a posture, which chooses the elbow.
# If your file has defects, this is where you are told, with the link or joint and the line.

# %%
elbow = (0.1, -1.2, 1.6, -1.0, -1.4, 0.2)
arms = {
    "left": cp.Arm.from_urdf("ur5", tip="tool0", base=(-0.2, 0.0, 0.0), posture=elbow),
    "right": cp.Arm.from_urdf(
        "ur5", tip="tool0", base=cp.Pose(xyz=(1.1, 0.1, 0.05), rpy=(0.0, 0.0, 3.0)), posture=elbow
    ),
}

# %% [markdown]
# ## Payload and grasps
# The payload's frame P is at its centre of mass. A grasp is the pose of a tip in P: where it sits and how it is turned.
# A UR5's `tool0` looks out of the flange along z, so the left tip is turned to look along +x, into the box.

# %%
box = cp.Payload.box(mass=3.0, size=(0.3, 0.1, 0.1))
grasps = {
    "left": cp.Pose(xyz=(-0.15, 0.0, 0.0), rpy=(0.0, np.pi / 2, 0.0)),
    "right": cp.Pose(xyz=(0.15, 0.0, 0.0), rpy=(0.0, -np.pi / 2, 0.0)),
}
cell = cp.Cell(arms=arms, payload=box, grasps=grasps)

# %% [markdown]
# ## What it shall do
# Lift the box by 10 cm, carry it 10 cm to the side and turn it, squeezed by 15 N. The payload-space law knows none of the masses: its
# integral finds the weight.

# %% tags=["parameters"]
seconds = 6.0  # of the run

# %%
start = cp.Pose(xyz=(0.45, 0.05, 0.4))
goal = cp.Pose(xyz=(0.45, 0.15, 0.5), rpy=(0.0, 0.0, 0.3))
gains = {"pose_gain": 5, "sliding_gain": [600, 600, 600, 20, 20, 20], "sign_gain": 0.5, "transient_rate": 5}
scenario = cp.Scenario(
    name="two-ur5",
    summary="Two UR5 carry a box under gravity, without a model",
    cell=cell,
    start=start,
    motion=cp.LineMotion(start=start, goal=goal, duration=2.5),
    squeeze={"left": (-15, 0, 0, 0, 0, 0), "right": (15, 0, 0, 0, 0, 0)},
    controller={"kind": "payload-space", "gains": gains},
    clock={"rate_hz": 250, "steps_per_tick": 2},
    duration=seconds,
)

# %% [markdown]
# ## Check first
# Kinematics alone, along the whole motion: a second instead of a failed run.

# %%
check = cp.reachability(scenario)
print(check.text())

# %% [markdown]
# ## Run

# %%
result = cp.run(scenario)
metrics = {name: f"{value:.4g}" for name, value in result.metrics().items() if name != "window_s"}
pd.Series(metrics, name="value").to_frame()

# %%
print(result.limit_violations() or "no joint and no drive went beyond its limits")

# %% [markdown]
# ## Look
# Drag to turn; press play.

# %%
notebook_view(result)

# %%
figures.tracking_figure(result)

# %% [markdown]
# The box follows within a tenth of a millimetre. The squeeze is less faithful: the arms' own weight goes through the box, and no law
# without a model or a force sensor can tell it from a squeeze. Feedback of the internal wrench divides it.

# %%
measured = cp.run(
    scenario,
    {"controller.force_path": {"kind": "low-pass", "pole": 0.95}, "controller.gains.force_gain": 9.0},
)
for name, run in (("no force feedback", result), ("K_f = 9", measured)):
    force = run.internal_force()
    print(f"{name:18} axial {force.axial_mean:6.1f} N (desired -15), shear {force.shear_rms:5.2f} N rms")

# %% [markdown]
# ## Keep it
# The scenario is one file, which the command line runs as well: `coop-pin run out/two-ur5.toml --report`.

# %%
file = Path("out", "two-ur5.toml")
file.parent.mkdir(exist_ok=True)
scenario.save(file)
assert cp.Scenario.load(file) == scenario

# %% [markdown]
# ## Try
# - another payload: `cp.Payload.mesh("part.stl", density=2700, scale=0.001)`.
# - `cp.run(scenario, {"motion.goal.xyz": [0.45, 0.9, 0.5]})`: out of reach; read the message. `cp.reachability` tells it earlier.
# - `"cell.arms.left.calibration_error.xyz": [1e-4, 0, 0]`: an arm whose kinematics is off by 0.1 mm.
# - an arm with seven joints: `cp.Arm.from_urdf("panda", tip="panda_hand_tcp", locked={"panda_finger_joint1": 0.03})`.
