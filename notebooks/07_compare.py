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
# # Your law against three others
#
# A controller of your own joins the comparison by the name of its class. It gets the same cell, the same
# trials and the same measures as the others. This notebook
#
# 1. writes a law of twenty lines into a file,
# 2. compares it with three others under four trials,
# 3. draws the table, ranks the laws with their intervals, and replays one run.
#
# The notebook runs in about ten seconds.

# %%
# %matplotlib inline
import sys
from pathlib import Path

import coop_pin as cp
from coop_pin.comparison import benchmark_scenario, standard_trials
from coop_pin.figures import comparison_figure
from coop_pin.viz import notebook_view

# %% tags=["parameters"]
seconds = 8.0  # of each run; it is judged from 40 % of it on

# %% [markdown]
# ## A law of your own
# A spring and damper on the payload pose, shared like the load, and the desired squeeze. Options are keyword
# arguments; the state is what `init` and `step` return.

# %%
law = """
import numpy as np

import coop_pin as cp


class Spring(cp.ArmController):
    'tau = -J^T (c (K xtilde + D xtildedot) + f_d)'

    needs = ()  # besides kinematics

    def __init__(self, scenario, arm, stiffness=(4000.0, 4000.0, 200.0), damping=(800.0, 800.0, 40.0)):
        self.rows = scenario.cell.task_rows
        self.share = dict(zip(scenario.cell.arms, scenario.cell.shares, strict=True))[arm]
        self.K, self.D = np.array(stiffness), np.array(damping)

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        error = self.rows.pose_error(measurement.payload_pose, reference.pose)
        push = self.K * error + self.D * (measurement.payload_twist - reference.twist)
        f_d = self.rows.turn(measurement.payload_pose, reference.internal_wrench)
        return cp.ArmCommand(-measurement.payload_jacobian.T @ (self.share * push + f_d), state)
"""
Path("my_law.py").write_text(law)

# %% [markdown]
# ## The comparison
# Every run is stored in the folder: the same call repeats none. `*` marks cells with a
# simulation that is not sound, `†` those with a task that is not kept.

# %%
sys.path.append(".")  # my_law.py is in this folder
laws = {name: name for name in ("printed", "anchored", "computed-torque")} | {"mine": "my_law:Spring"}
table = cp.compare(
    "adept-anchored",
    laws,
    ["nominal", "push", "bias 1 mm", "noise"],
    out="out/compare",
    seeds=3,
    duration=seconds,
    execution=cp.Execution(workers=0, quiet=True),
)
print(table.summary())

# %%
comparison_figure(table, "adept-anchored")

# %% [markdown]
# ## Ranks
# The mean rank over all trials, with the interval in which it lies when the trials are drawn anew.

# %%
table.ranks("tracking_rms_mm")

# %% [markdown]
# ## One run
# Every cell of the table is a scenario that you can run by itself: here your law under the push.

# %%
scenario = benchmark_scenario(cp.Scenario.load("adept-anchored"), seconds)
push = standard_trials(scenario)["push"].changes
result = cp.run(scenario, {"controller": cp.UserController(target="my_law:Spring")} | push)
notebook_view(result)

# %% [markdown]
# ## Try
# - Other options: `laws["soft"] = cp.UserController(target="my_law:Spring", options={"stiffness": 1000.0})`.
# - All standard trials: leave the list out. All controllers: `cp.comparison.controller_names()`.
# - The same from a terminal: `coop-pin compare adept-anchored --controllers printed anchored my_law:Spring`.
