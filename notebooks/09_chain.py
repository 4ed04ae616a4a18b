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
# # A closed chain for control people
#
# Two planar arms hold a bar. Below the laws, a closed chain is a mechanical system with fewer degrees of
# freedom than drives. This notebook
#
# 1. linearises the chain and finds the torques that hold it and squeeze,
# 2. predicts the gain at which the sampled loop becomes unstable, and measures it in runs,
# 3. plans the carry of least time within the limits of the drives,
# 4. plays it in closed loop with a law that has no model.
#
# The notebook runs in about half a minute. The equations are on the page "Closed chains for control people".

# %%
# %matplotlib inline
import matplotlib.pyplot as plt
import numpy as np

import coop_pin as cp
from coop_pin.viz import notebook_view

# %% tags=["parameters"]
factors = np.linspace(0.5, 4.0, 15)  # of the sliding gain, at which eigenvalues are drawn

# %% [markdown]
# ## The chain
# Six drives move three degrees of freedom; the other three directions only squeeze. So the torques of a
# motion are not unique: an internal wrench of choice makes them so.

# %%
scenario = cp.Scenario.load("adept-anchored", {"events": [], "duration": 1.5})
chain = cp.CellChain(scenario.cell)
q = chain.configuration(scenario.start.matrix)
still = np.zeros(chain.mechanism.model.nv)
squeeze = np.zeros((2, 6))
squeeze[:, :3] = np.outer((-10.0, 10.0), scenario.start.matrix[:3, 0])
held = chain.inverse_dynamics(q, still, still, internal=squeeze)
model = chain.linearise(q, still, held.torque)
print(f"{len(still)} drives, {len(model.joints)} degrees of freedom: {', '.join(model.joints)}")
print("torques of a squeeze of 10 N at rest, N m:", held.torque.round(2))
print("inertia at P, kg and kg m^2:")
print(chain.effective_inertia(q).round(2))

# %% [markdown]
# ## The bound of a gain
# Eigenvalues of the sampled loop: plant, law, sensors and force path in one map from tick to tick. The loop
# is stable while all are inside the unit circle.

# %%
resting = scenario.replace(motion=cp.HoldMotion(pose=scenario.start), beyond_bound=True)
locus = cp.root_locus(resting, "controller.gains.sliding_gain", factors)
print(locus.summary())
cp.figures.root_locus_figure(locus)

# %% [markdown]
# Runs tell the same. A push of 0.1 N disturbs two of them, 3 % below the bound and 3 % above it.

# %%
push = cp.WrenchPulse(time=0.1, duration=0.05, wrench=(0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
for part in (0.97, 1.03):
    near = resting.override({"controller.gains.sliding_gain": part * locus.bounds[-1] * locus.value})
    predicted = cp.eigenvalues(near).radius
    data = cp.run(near.replace(events=(push,)), warn=False).data
    speed = np.linalg.norm(data.payload_twist, axis=1)
    plt.semilogy(data.time[10:], speed[10:], label=f"{part:g} of the bound")
    grown = (speed[-1] / speed[-31]) ** (1.0 / 30.0)
    print(f"{part:g} of the bound: |z| predicted {predicted:.4f}, growth from tick to tick {grown:.4f}")
plt.xlabel("time, s")
plt.ylabel("speed of the bar")
plt.legend()
plt.show()

# %% [markdown]
# ## The carry of least time
# Half a metre and 60 degrees, with the squeeze, within a quarter of the drives' efforts. The path is given,
# so that the torques are affine in $\ddot s$ and $\dot s^2$, and the least time is a matter of intervals.

# %%
limits = {f"cell.arms.{arm}.torque_limits": (75.0, 50.0, 12.5) for arm in ("left", "right")}
fast = scenario.override(limits | {"clock.rate_hz": 500.0, "clock.steps_per_tick": 1})
start = cp.Pose(xyz=(0.55, 0.45, 0.0), rpy=(0.0, 0.0, 0.1))
goal = cp.Pose(xyz=(0.45, -0.04, 0.0), rpy=(0.0, 0.0, 1.1472))
plan = cp.plan_carry(fast.cell, start, goal, squeeze=fast.squeeze, smoothing=0.03)
print(plan.summary())
for arm, torques in plan.torques.items():
    plt.plot(
        plan.motion.times, np.array(torques) / (75.0, 50.0, 12.5), label=[f"{arm} {k}" for k in (1, 2, 3)]
    )
plt.axhline(0.95, color="0.7")
plt.axhline(-0.95, color="0.7")
plt.xlabel("time, s")
plt.ylabel("torque, part of its limit")
plt.legend(ncols=2)
plt.show()

# %% [markdown]
# A quintic would take 15 % longer. Where torques are the limit all the way, no timing of the path gains more
# than 17 %; where speeds are, or limits change along the line, 30 to 40 %.
#
# ## Played
# The law measures joints and a wrench; it has no model. The plan's torques are a part of the scenario: what
# they have beyond the law's own commands is added.

# %%
run = cp.run(plan.played_by(fast, rest=0.3), warn=False)
data = run.data
moving = data.time >= 1.0
error = np.linalg.norm(data.pose_error[moving, :2], axis=1).max()
force = np.abs(data.internal_axial_error[moving]).max()
print(f"{1e6 * error:.0f} um off the path at most, internal force {force:.1f} N off")
print(f"limits exceeded: {list(run.limit_violations())}")
print(f"closure error {run.metrics()['closure_error_max_m']:.1g} m")
notebook_view(run)

# %% [markdown]
# The 1.5 N are those of torques that are held over 2 ms; at 1 kHz half of them remain. Without the
# feed-forward the law lags behind, and the same motion asks for more than the drives have.

# %%
alone = cp.run(run.scenario.replace(feed_forward=None), warn=False)
off = np.linalg.norm(alone.data.pose_error[:, :2], axis=1).max()
print(f"{1e3 * off:.0f} mm off the path, {np.abs(alone.data.internal_axial_error).max():.0f} N off")
print(*alone.limit_violations(), sep="\n")

# %% [markdown]
# ## Try
# - `cp.plan_carry(..., duration=1.0)`: the carry of least effort in a second.
# - `controller` of `adept-paper` in place of the anchored law: the plan plays with it as well.
# - An event `cp.PayloadChange(time=0.5, mass=12.0)` in the played scenario: the law corrects what the plan
#   does not know.
