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
# A sweep runs a scenario for many values of its parameters. This notebook shows
#
# 1. a sweep over one gain,
# 2. a map over two parameters in fifteen lines, including runs that diverge,
# 3. the measured stability boundary beside the theoretical one,
# 4. one run of the map, opened and replayed.
#
# The notebook runs in about twenty seconds on two processors. The second time it computes nothing, because
# finished runs are kept.

# %%
# %matplotlib inline
import matplotlib.pyplot as plt
import numpy as np

import coop_pin as cp
from coop_pin.laws import force_gain_bound
from coop_pin.viz import notebook_view

# %% tags=["parameters"]
gains, poles, force_gains, workers = 6, 5, 12, 2  # number of values of each, and of processes

# %% [markdown]
# ## One gain
# Fields have dotted names. The metrics of all runs are an xarray Dataset with the fields as dimensions.

# %%
quick = {"duration": 6.0, "events": []}
alphas = {"controller.gains.sign_gain": cp.sweeps.linspace(0.0, 0.5, gains)}
line = cp.sweep(
    "adept-paper",
    alphas,
    changes=quick,
    out="out/sweeps/sign-gain",
    execution=cp.Execution(workers=workers, quiet=True),
)
print(line.summary())

# %%
figure, axes = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained")
for panel, metric in zip(axes, ("moving_position_rms_m", "moving_internal_shear_rms_N"), strict=True):
    line.values(metric).plot(ax=panel, marker="o")
    panel.set(title="", ylim=(0, None))

# %% [markdown]
# ## A map
# Up to which gain is feedback of the internal force stable? The measured force passes a low-pass filter
# with pole $p$, and the law feeds it back with the gain $K_f$. In a rigid chain this loop is a pure gain
# with a delay of one tick, so it should become unstable at $K_f = (1 + p) / (1 - p)$. A scenario with such
# gains is refused unless `beyond_bound` is true.

# %%
field, pole = "controller.gains.force_gain", "controller.force_path.pole"
path = {"controller.force_path.kind": "low-pass", "beyond_bound": True, "duration": 2.0, "events": []}
grid = {pole: cp.sweeps.linspace(0.0, 0.8, poles), field: cp.sweeps.logspace(0.4, 18.0, force_gains)}
chart = cp.sweep(
    "adept-paper",
    grid,
    changes=path,
    out="out/sweeps/force-gain",
    execution=cp.Execution(workers=workers, quiet=True),
)
stable = chart.data["status"] == "ok"
p = np.linspace(0.0, 0.88, 60)
figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
axes.pcolormesh(chart.data[field], chart.data[pole], stable, cmap="Blues", vmin=-0.2, vmax=1.8)
axes.plot([force_gain_bound(value) for value in p], p, "k", label="(1 + p) / (1 - p)")
axes.set(xscale="log", xlabel="force gain $K_f$", ylabel="pole p", title="dark: the run was completed")
axes.legend(loc="lower right")
plt.show()

# %% [markdown]
# Runs that diverge do not stop a sweep: each is recorded with its error message.

# %%
print(chart.counts())
print(chart.failures[0].parameters)
print(chart.failures[0].message)

# %% [markdown]
# The last stable and the first unstable gain, and the theoretical bound:

# %%
boundary = chart.stability_boundary(field)
table = boundary.to_dataframe()
table["theory"] = [force_gain_bound(p) for p in table.index]
table.round(2)

# %% [markdown]
# ## One run of the map
# Every run can be opened as a full result: here the one with the smallest peak torque.

# %%
best = chart.best("torque_peak_Nm")[0]
print(best.parameters, f"{best.metrics['torque_peak_Nm']:.1f} N m")
notebook_view(chart.open(best.number))

# %% [markdown]
# ## Try
# - run the cell with the map again: nothing is computed. Change `duration`, and every run is computed.
# - two laws: `cases={"law": {"printed": {}, "payload-space": {"controller": cp.laws.PayloadSpace(...)}}}`.
# - `sample={"fields": {...}, "count": 64, "method": "saltelli"}` and `result.sobol_indices(metric)`:
#   sensitivity of a metric to each gain.
# - on a cluster: `execution=cp.Execution(scheduler="tcp://...:8786")`.
