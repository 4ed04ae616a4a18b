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
# # Closed chains for control people
#
# A cell of arms that hold one object is a mechanism with few degrees of freedom and many motors. This
# notebook
#
# 1. computes its torques: of least effort, with a squeeze, and with the least squeeze that friction needs,
# 2. linearises it, and compares the linear model with the nonlinear one,
# 3. predicts the gain from which a sampled loop is unstable, and lets runs show it,
# 4. plans the fastest carry of a box within all limits, and plays it.
#
# The equations stand on the page "Closed chains for control people". The notebook runs in a quarter of a
# minute.

# %%
# %matplotlib inline
import matplotlib.pyplot as plt
import numpy as np

import coop_pin as cp
from coop_pin.viz import notebook_view

# %% [markdown]
# ## Torques
# Two Pandas hold a crate of 3 kg by its sides. Their fourteen torques move eight degrees of freedom, so that
# the internal wrench is free to choose. All functions take one state or many: here twelve poses at rest, as
# the crate rises by 12 cm. The pads are those of the catalogue's palms, with friction of 0.6.

# %%
palms = cp.Scenario.load("two-pandas-palms")
grasps = {name: cp.Pose(xyz=grasp.xyz, rpy=grasp.rpy) for name, grasp in palms.cell.grasps.items()}
pads = {name: cp.Pad(mu=0.6, radius=0.03, press="z") for name in grasps}
crate = cp.grasps.CellChain(palms.cell.replace(grasps=grasps, pads=pads))

heights = np.linspace(0.46, 0.58, 12)
q = np.array([crate.configuration(cp.Pose(xyz=(0.0, 0.0, z)).matrix) for z in heights])
still = np.zeros((len(q), crate.mechanism.model.nv))
least = crate.friction_squeeze(q, still, still)
stated = np.zeros((2, 6))
stated[:, 0] = (-60.0, 60.0)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
choices = {"least effort": None, "60 N of squeeze": stated, "least squeeze by friction": least.internal}
for name, internal in choices.items():
    torque = crate.inverse_dynamics(q, still, still, internal=internal).torque
    axes.plot(heights, np.linalg.norm(torque, axis=1), label=name)
axes.set(xlabel="height of the crate, m", ylabel="norm of the torques, N m")
axes.legend()
plt.show()
print("normal forces of the least squeeze:", least.normal[0].round(1), "N")

# %% [markdown]
# ## A linear model
# `linearise` eliminates the closures: x has the deviations of as many joints as there are degrees of freedom,
# and their rates; y is the motion of the payload. `sampled` holds the torque over a period. Here the planar
# pair of the catalogue is pushed by a torque for 50 ms, by both models.

# %%
scenario = cp.Scenario.load("adept-anchored").replace(events=())
pair = cp.grasps.CellChain(scenario.cell)
chain, start = pair.mechanism, pair.configuration(scenario.motion.at(0.0).X_WP_d)
rest = np.zeros(chain.model.nv)
model = pair.linearise(start, rest, rest)
print(f"{len(model.joints)} degrees of freedom: {', '.join(model.joints)}")

torque = np.array((2.0, -1.0, 0.5, 1.0, 0.0, 0.0))
sampled = model.sampled(0.05)
by_model = sampled.C @ sampled.B @ torque
before = pair.payload_pose(start)[:2, 3]


def moved(size):
    """Displacement of the payload by the nonlinear model, mm."""
    motion = chain.integrate(start, rest, duration=0.05, step=1e-3, torque=lambda *_: size * torque)
    return 1e3 * (pair.payload_pose(motion.q[-1])[:2, 3] - before)


for size in (1.0, 10.0, 100.0):
    print(f"{size:5.0f} times: {moved(size)} mm, by the linear model {1e3 * size * by_model[:2]} mm")

# %% [markdown]
# ## The bound of a gain
# `eigenvalues` linearises the whole sampled loop: plant, law, sensors, force path, drives. `root_locus` does
# so over a gain, and finds where an eigenvalue leaves the unit circle.

# %%
held = scenario.replace(motion=cp.motions.HoldMotion(pose=scenario.start))
locus = cp.stability.root_locus(held, "controller.gains.sliding_gain", [1.0, 1.5, 2.0, 2.5, 3.0])
print(locus.summary())
cp.figures.root_locus_figure(locus)

# %% [markdown]
# Runs show it: a push of 0.1 N for a tick dies away at 0.98 of the bound, and grows at 1.02. The dotted line
# has the slope of the eigenvalue.

# %%
push = cp.events.WrenchPulse(time=0.5, duration=0.0125, wrench=(0.1, 0.05, 0.0, 0.0, 0.0, 0.01))
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for part in (0.98, 1.02):
    gain = (part * locus.bounds[-1] * locus.value).tolist()
    loop = held.replace(duration=2.4, beyond_bound=True).override({"controller.gains.sliding_gain": gain})
    pushed, calm = (cp.run(loop.replace(events=events), warn=False) for events in ((push,), ()))
    apart = np.linalg.norm((pushed.data.torque - calm.data.torque).values, axis=(1, 2))
    time, radius = pushed.data.time.values, cp.stability.eigenvalues(loop).radius
    axes.semilogy(time[42:], apart[42:], label=f"{part} of the bound, |z| = {radius:.4f}")
axes.semilogy(time[80:], apart[80] * radius ** np.arange(len(time) - 80.0), "k:")
axes.set(xlabel="time, s", ylabel="change of the torques, N m")
axes.legend()
plt.show()

# %% [markdown]
# ## Plan and play
# Two Pandas carry their box by 0.26 m and 23 degrees, as fast as torques and speeds allow, with 10 N of
# squeeze. The law of the catalogue corrects what deviates from the planned torques.

# %%
box = cp.Scenario.load("two-pandas-box")
begin, end = cp.Pose(xyz=(0.09, -0.1, 0.51), rpy=(0.0, 0.0, -0.4)), cp.Pose(xyz=(0.08, 0.1, 0.35))
plan = cp.carry.plan_carry(box.cell, begin, end, squeeze=box.squeeze, places=41)
print(plan.summary())
run = cp.run(plan.played_by(box, start_time=0.5, rest=0.3), warn=False)
print(run.summary().splitlines()[0])
error = np.abs(run.data.internal_axial_error.sel(time=slice(0.5, None))).max().item()
print(f"largest error of the internal force on the way {error:.2f} N")
notebook_view(run)

# %% [markdown]
# ## Try
# - `cp.grasps.CellChain.effective_inertia`: what a push on the payload meets at P.
# - `friction=pair.friction(v)` in `inverse_dynamics`: torques that overcome the friction of the joints.
# - `"controller.gains.anchor_gain"` or `"actuators.lag"` in `root_locus`.
# - `time=1.0` in `root_locus`: the loop at a later moment of the motion.
