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
# From two URDF files and a box to a run in 3-D. This notebook shows
#
# 1. arms, payload and grasps in ten lines,
# 2. a check before the run: reachability, singular poses, joint limits,
# 3. the box carried under gravity by a control law without a dynamic model,
# 4. the motion in 3-D, and the metrics.
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
# An arm is a URDF file or a name of example-robot-data, the frame that grips, the pose of the base, and a
# posture, which selects the branch (elbow). Defects of the file are reported here, with the link or joint
# and the line.

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
# The payload frame P is at the centre of mass. A grasp is the pose of a tip in P. The z axis of a UR5's
# `tool0` points out of the flange, so the left tip is turned until z points along +x, into the box.

# %%
box = cp.Payload.box(mass=3.0, size=(0.3, 0.1, 0.1))
grasps = {
    "left": cp.Pose(xyz=(-0.15, 0.0, 0.0), rpy=(0.0, np.pi / 2, 0.0)),
    "right": cp.Pose(xyz=(0.15, 0.0, 0.0), rpy=(0.0, -np.pi / 2, 0.0)),
}
cell = cp.Cell(arms=arms, payload=box, grasps=grasps)

# %% [markdown]
# ## The motion
# Lift the box by 10 cm, carry it 10 cm to the side and turn it, while squeezing it with 15 N. The
# payload-space law uses no mass: its integral term compensates the weight.

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
    motion=cp.motions.LineMotion(start=start, goal=goal, duration=2.5),
    squeeze={"left": (-15, 0, 0, 0, 0, 0), "right": (15, 0, 0, 0, 0, 0)},
    controller={"kind": "payload-space", "gains": gains},
    clock={"rate_hz": 500},
    duration=seconds,
)

# %% [markdown]
# ## Check before the run
# Reachability, distance to singularities and joint limits along the whole motion, from kinematics alone.

# %%
check = cp.feasibility.reachability(scenario)
print(check.summary())

# %% [markdown]
# ## Run

# %%
result = cp.run(scenario)
metrics = {name: f"{value:.4g}" for name, value in result.metrics().items()}
pd.Series(metrics, name="value").to_frame()

# %%
print(result.limit_violations() or "all joints and drives stayed within their limits")

# %% [markdown]
# ## In 3-D
# Drag to turn the view; press play.

# %%
notebook_view(result)

# %%
figures.tracking_figure(result)

# %% [markdown]
# The box follows within a tenth of a millimetre. The squeeze is less accurate: while it moves, the weight of
# the arms changes and loads the box, and without a model or a force sensor no law can distinguish it from a
# squeeze. A measured internal wrench anchors the law's integral: the error goes.

# %%
measured = cp.run(scenario, {"controller.force_path": {"kind": "late"}})
for name, run in (("no force sensor", result), ("anchored", measured)):
    force = run.internal_force()
    print(f"{name:18} axial {force.axial_mean:6.1f} N (desired -15), shear {force.shear_rms:5.2f} N rms")

# %% [markdown]
# ## Save the scenario
# The scenario is one file, which also runs from the command line: `coop-pin run out/two-ur5.toml --report`.

# %%
file = Path("out", "two-ur5.toml")
file.parent.mkdir(exist_ok=True)
scenario.save(file)
assert cp.Scenario.load(file) == scenario

# %% [markdown]
# ## Try
# - another payload: `cp.Payload.mesh("part.stl", density=2700, scale=0.001)`.
# - `cp.run(scenario, {"motion.goal.xyz": [0.45, 0.9, 0.5]})`: the goal is out of reach; read the error
#   message. `cp.feasibility.reachability` reports it before the run.
# - `"cell.arms.left.calibration_error.tip.xyz": [1e-4, 0, 0]`: an arm with a kinematic error of 0.1 mm.
# - a seven-joint arm:
#   `cp.Arm.from_urdf("panda", tip="panda_hand_tcp", locked={"panda_finger_joint1": 0.03})`.
