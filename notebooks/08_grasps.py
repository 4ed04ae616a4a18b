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
# # Grasps that give, let go and take hold
#
# A grasp is rigid by default. It can also be a spring and damper, open, and close again. This notebook
#
# 1. puts soft grasps into a cell whose gains were made for rigid ones, and reads what the check says,
# 2. lets one of three arms hand a plate over, retreat, come back and take hold,
# 3. opens a rigid grasp and closes it with an impulse,
# 4. lets a person hold the box at a handle,
# 5. takes the grasps away: two palms press a crate, and friction alone holds it. Why squeeze at all.
#
# The notebook runs in about half a minute.

# %%
# %matplotlib inline
import subprocess
import sys

import matplotlib.pyplot as plt
import numpy as np

import coop_pin as cp
from coop_pin.viz import notebook_view

# %% tags=["parameters"]
seconds = 4.0  # from the hand-over to the end of the run

# %% [markdown]
# ## Gains for rigid grasps on soft ones
# Rigid grasps let the damping of an arm act on the inertia of all arms and the payload. A spring leaves it
# alone with the arm's own, which is far lighter in the wrist. The radius of the sampled loop tells, and the
# stiffness from which the gains hold.

# %%
fields = []
for arm in ("left", "right"):
    fields += [f"--cell.grasps.{arm}.kind", "compliant", f"--cell.grasps.{arm}.stiffness", "paper"]
check = [sys.executable, "-m", "coop_pin", "check", "adept-anchored", *fields]
print(subprocess.run(check, capture_output=True, text=True).stdout)

# %% [markdown]
# ## A hand-over
# Three UR5 hold a plate by springs of 300 kN/m. The third hands its share over, lets go, retreats by 3 cm
# and comes back. All arms know the plan: load shares and squeeze move with it, and the free arm follows its
# retreat by the same law.

# %%
events = (
    cp.events.HandOver(
        time=0.5, arm="third", duration=0.2 * seconds, retreat=0.03, retreat_time=0.1 * seconds
    ),
    cp.events.Regrasp(
        time=0.5 + 0.6 * seconds,
        arm="third",
        approach_time=0.1 * seconds,
        wait=0.1 * seconds,
        duration=0.2 * seconds,
    ),
)
scenario = cp.Scenario.load("three-ur5-handover", {"events": [], "duration": 0.6 + seconds})
run = cp.run(scenario.replace(events=events))
data = run.data
print(run.summary().splitlines()[0])
error = 1e3 * np.linalg.norm(data.pose_error[:, :3], axis=1)
print(f"the payload stays within {error.max():.2f} mm of its path")

# %%
figure, (shares, forces) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
shares.plot(data.time, data.load_share, label=list(scenario.cell.arms))
shares.set(xlabel="time, s", ylabel="load share")
shares.legend()
forces.plot(data.time, np.linalg.norm(data.grasp_wrench[:, :, :3], axis=2))
forces.set(xlabel="time, s", ylabel="force of each grasp, N")
plt.show()

# %% [markdown]
# The replay says on top who let go and took hold. An arm that holds nothing is pale.

# %%
notebook_view(run)

# %% [markdown]
# ## A rigid grasp takes hold with an impulse
# Rigid grasps open and close as well, if the payload is no weld of the tree. The tip is kept where it is
# found, and the velocities meet at once: `work_payload_change` has the energy that this takes. What is not
# explained is what the integration leaves.

# %%
stiff = scenario.replace(cell=scenario.cell.rigid).override({"plant.payload": "free"})
taken = cp.run(stiff.replace(events=events), warn=False)
print(taken.summary().splitlines()[0])
impact = -taken.data.work_payload_change.values[-1]
print(f"the impact takes {impact:.2g} J; not explained: {taken.energy_balance_max():.1g} J")

# %% [markdown]
# ## A person at a handle
# A partner is a spring and damper to a moving point. Here a person holds a box that two Pandas carry, and
# would have it 3 cm lower. No law is told: to the arms the person is a load that they do not know, and
# their integral takes it.

# %%
person = cp.events.Partner(
    time=0.2,
    duration=1.0,
    motion=cp.motions.HoldMotion(pose=cp.Pose(xyz=(0.0, 0.0, 0.37))),
    handle=cp.Pose(xyz=(0.0, -0.12, 0.0)),
    stiffness=(300.0, 300.0, 300.0, 0.0, 0.0, 0.0),
    damping=(20.0, 20.0, 20.0, 0.0, 0.0, 0.0),
)
held = cp.run(cp.Scenario.load("two-pandas-box", {"duration": 1.5}).replace(events=(person,)), warn=False)
figure, (pulls, errors) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
pulls.plot(held.data.time, held.data.partner_wrench[:, 2])
pulls.set(xlabel="time, s", ylabel="vertical force of the person, N")
errors.plot(held.data.time, 1e3 * held.data.pose_error[:, 2])
errors.set(xlabel="time, s", ylabel="height of the box off its path, mm")
plt.show()

# %% [markdown]
# ## Why squeeze at all
# Every grasp so far holds the payload whatever the internal force is. Between palms it does not: of two palms
# with the friction $\mu$ each bears at most $\mu N$, and $N \ge m g / (2 \mu)$ is the least for a crate
# at rest. With seven tenths of it the crate slides; at 10 mm the arms give up, stay where they are,
# and it falls.

# %%
hold = {"motion": {"kind": "hold", "pose": {"xyz": (0.0, 0.0, 0.5)}}, "duration": 0.3}
crate = cp.Scenario.load("two-pandas-palms", hold)
least = crate.cell.payload.mass * 9.81 / (2.0 * crate.cell.grasps["left"].mu)
figure, (heights, uses) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
for part in (0.7, 1.5):
    force = part * least
    squeeze = {"left": (-force, 0, 0, 0, 0, 0), "right": (force, 0, 0, 0, 0, 0)}
    pressed = cp.run(crate.override({"squeeze": squeeze}), warn=False)
    print(f"{force:.1f} N, {part} of the least: {pressed.verdict()}")
    heights.plot(pressed.data.time, pressed.data.payload_position[:, 2], label=f"{part} of the least squeeze")
    uses.plot(pressed.data.time, pressed.friction_use().used[:, 0])
heights.set(xlabel="time, s", ylabel="height of the crate, m")
heights.legend()
uses.set(xlabel="time, s", ylabel="part of the friction in use", ylim=(0.0, 1.2))
plt.show()

# %% [markdown]
# `pick-carry-place` is the whole task by friction alone: three UR5 lift a crate from a table, hand it over on
# the way, and put it down on a table that is 2 mm higher than planned. It takes half a minute.

# %% [markdown]
# ## Try
# - `tolerance=1e-4` in `Regrasp`: the grasp does not happen, and the verdict and the replay say so.
# - `cp.events.Release(time=0.5, arm="third")` in place of the hand-over: all at once.
# - `cp.events.LoseArm(time=0.5, arm="left", form="braked")` in place of the person: brakes hold one arm.
