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
# # Two arms of your own
#
# Two robot arms hold one box. Are they crushing it, or tearing it apart? The motion does not tell. This
# notebook
#
# 1. puts two arms that have never met around a box, from two URDF files,
# 2. runs them, and shows the motion in 3-D with the force *inside* the box,
# 3. lets you push the box while it runs,
# 4. builds the same kind of cell by hand, with two UR5, and checks it before it runs,
# 5. saves it as a file for the command line.
#
# The notebook runs in about half a minute.

# %%
import site
import subprocess
import sys

WHEEL = ""  # address of a wheel of coop_pin to install first, for a notebook without a clone
if WHEEL:
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", WHEEL, "anywidget"], check=True)
    site.addsitedir(site.getsitepackages()[0])  # Pinocchio is found by a file that Python reads at its start

# %%
# %matplotlib inline
from pathlib import Path

import numpy as np
import pandas as pd

import coop_pin as cp
from coop_pin import figures
from coop_pin.viz import Panel, notebook_view

# %% [markdown]
# ## Two arms and a box
# Put the paths of your own URDF or xacro files in place of the names. `new_cell` places the bases around the
# box by the arms' reach, chooses the start where the arms have the largest margins, and proposes gains. Its
# summary says what limits each.

# %%
new = cp.new_cell(["xarm7", "ur10"], "box", mass=5.0)
print(new.summary().split("\n  ", 2)[1])

# %%
first = cp.run(new.scenario)
print(first.summary().splitlines()[0])

# %% [markdown]
# ## In 3-D
# Drag to turn the view; press play. The bar between the grasps is the force inside the box: dark where it is
# squeezed, orange where it is pulled apart.

# %%
notebook_view(first)

# %% [markdown]
# ## Push it
# The same run, live. Press **Start**, then drag the box: an arrow shows the force, and it acts when you let
# go. The sliders change gains, mass and squeeze.

# %%
panel = Panel(new.scenario.replace(duration=120.0))
panel

# %% [markdown]
# ## A cell by hand
# An arm is a URDF file or a name of example-robot-data, the frame that grips, the pose of the base, and a
# posture, which selects the branch (elbow). Defects of the file are reported here, with the link or joint
# and the line. The payload frame P is at the centre of mass, and a grasp is the pose of a tip in P. The z
# axis of a UR5's `tool0` points out of the flange: the left tip is turned until z points along +x, into the
# box.

# %%
elbow = (0.1, -1.2, 1.6, -1.0, -1.4, 0.2)
arms = {
    "left": cp.Arm.from_urdf("ur5", tip="tool0", base=(-0.2, 0.0, 0.0), posture=elbow),
    "right": cp.Arm.from_urdf(
        "ur5", tip="tool0", base=cp.Pose(xyz=(1.1, 0.1, 0.05), rpy=(0.0, 0.0, 3.0)), posture=elbow
    ),
}
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
# ## The run

# %%
result = cp.run(scenario)
print(result.limit_violations() or "all joints and drives stayed within their limits")
metrics = {name: f"{value:.3g}" for name, value in result.metrics().items()}
pd.Series(metrics, name="value").to_frame()

# %%
figures.tracking_figure(result)

# %% [markdown]
# The box keeps to its path. The squeeze is less accurate: while it moves, the weight of the arms changes and
# loads the box, and without a model or a force sensor no law can distinguish it from a squeeze. A measured
# internal wrench anchors the law's integral: the error goes.

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
