# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#       jupytext_version: 1.19.6
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Sweeps: from one run to a stability map
#
# One run answers one question. You will see
#
# 1. a sweep over one gain,
# 2. a map over two parameters in fifteen lines, with the runs that diverge as part of the answer,
# 3. the measured boundary on top of the one that theory gives,
# 4. one run of the map opened and played.
#
# The notebook runs in about twenty seconds on two processors, and in none the second time: finished runs are kept.

# %%
# %matplotlib inline
import matplotlib.pyplot as plt
import numpy as np

import coop_pin as cp
from coop_pin.control import force_gain_bound
from coop_pin.viz import notebook_view

# %% tags=["parameters"]
gains, poles, force_gains = 6, 5, 12  # how many values of each; fewer are faster

# %% [markdown]
# ## One gain
# Fields have dotted names. Everything recorded is an xarray with the fields as axes.

# %%
quick = {"duration": 6.0, "events": []}
alphas = {"controller.gains.sign_gain": cp.linspace(0.0, 0.5, gains)}
line = cp.sweep("adept-paper", alphas, changes=quick, out="out/sweeps/sign-gain", workers=2, quiet=True)
print(line.summary())

# %%
figure, axes = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained")
for panel, metric in zip(axes, ("position_rms_m", "internal_shear_rms_N"), strict=True):
    line.values(metric).plot(ax=panel, marker="o")
    panel.set(title="", ylim=(0, None))

# %% [markdown]
# ## A map
# How much feedback of the internal force does the loop bear? The force passes a low-pass with pole $p$, and the law feeds it back
# with $K_f$. In a rigid chain this loop is pure gain with a delay, so it should break at $K_f = (1 + p) / (1 - p)$. The scenario
# would refuse such gains; `beyond_bound` insists.

# %%
field, pole = "controller.gains.force_gain", "controller.force_path.pole"
path = {"controller.force_path.kind": "low-pass", "beyond_bound": True, "duration": 2.0, "events": []}
grid = {pole: cp.linspace(0.0, 0.8, poles), field: cp.logspace(0.4, 18.0, force_gains)}
chart = cp.sweep("adept-paper", grid, changes=path, out="out/sweeps/force-gain", workers=2, quiet=True)
stable = chart.data["status"] == "ok"
p = np.linspace(0.0, 0.88, 60)
figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
axes.pcolormesh(chart.data[field], chart.data[pole], stable, cmap="Blues", vmin=-0.2, vmax=1.8)
axes.plot([force_gain_bound(value) for value in p], p, "k", label="(1 + p) / (1 - p)")
axes.set(xscale="log", xlabel="force gain $K_f$", ylabel="pole p", title="dark: the run came to its end")
axes.legend(loc="lower right")
plt.show()

# %% [markdown]
# Runs that diverge do not stop a sweep: each is recorded with what it said.

# %%
print(chart.counts())
print(chart.failures[0].parameters)
print(chart.failures[0].message)

# %% [markdown]
# The last stable and the first unstable gain, beside the theory:

# %%
boundary = chart.stability_boundary(field)
table = boundary.to_dataframe()
table["theory"] = [force_gain_bound(p) for p in table.index]
table.round(2)

# %% [markdown]
# ## One run of many
# Any point can be opened as a full result: here the calmest, with the smallest torque of all.

# %%
calmest = chart.best("torque_peak_Nm")[0]
print(calmest.parameters, f"{calmest.metrics['torque_peak_Nm']:.1f} N m")
notebook_view(chart.open(calmest.number))

# %% [markdown]
# ## Try
# - run the cell with the map again: nothing is computed. Change `duration`, and everything is.
# - two laws side by side: `cases={"law": {"printed": {}, "repaired": {"controller": {"kind": "payload-space", "gains": {...}}}}}`.
# - `sample={"fields": {...}, "count": 64, "method": "saltelli"}` and `result.sobol_indices(metric)`: which gain matters most?
# - on a cluster: `scheduler="tcp://...:8786"`.
