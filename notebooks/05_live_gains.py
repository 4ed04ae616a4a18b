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
# # Gains under the hand
#
# Two arms carry a bar while you change the gains of their law, the mass of the bar and the desired squeeze, and push the bar. You see
# at once what that does to tracking and to the **internal force**, with which the arms work against each other.
#
# 1. Let the next cells run; a 3-D view with strip charts appears, with buttons and sliders below it.
# 2. Press **Start**. Move a slider: it acts on the running loop at its next tick, 12.5 ms later at most.
# 3. Press **Push**.
#
# Behind a JupyterHub or another proxy your browser cannot reach the view of this machine; you get a still picture there, which says so,
# and the replay at the end works everywhere.

# %%
# %matplotlib inline
import time

import numpy as np

import coop_pin as cp
from coop_pin import figures
from coop_pin.viz import Panel, notebook_view

# %% [markdown]
# ## The run
# The paper's experiment without its events: those are in your hands now. `duration` is how long you can play before **Reset**.

# %%
scenario = cp.Scenario.load("adept-paper").replace(duration=120.0, events=())
panel = Panel(scenario)
panel

# %% [markdown]
# ## The same from code
# Everything that the buttons and sliders do can be written down. The next cell plays by itself for three seconds: the sign gain goes to
# zero, and a push of 150 N moves the bar.

# %%
run = panel.run
run.start()
time.sleep(1.5)
run.change({"controller.gains.sign_gain": 0.0})
run.push((0.0, 150.0, 0.0, 0.0, 0.0, 0.0), duration=0.2)
time.sleep(1.5)
run.pause()
print(f"paused at t = {run.time:g} s")

# %% [markdown]
# ## What happened
# `panel.result()` is an ordinary result of everything since the last reset. Pushes and changes of mass are among its events; its
# summary says when gains or the squeeze were changed.

# %%
result = panel.result()
print(result.scenario.summary)
print(*result.scenario.events, sep="\n")
error = np.linalg.norm(result.data["pose_error"].values[:, :3], axis=1)
print(f"position error: {1000 * error[-1]:.2f} mm at the end, {1000 * error.max():.1f} mm at most")

# %%
figures.tracking_figure(result)

# %%
figures.torque_figure(result)

# %%
figures.error_figure(result)

# %% [markdown]
# ## Once more, with a slider for time

# %%
notebook_view(result)

# %% [markdown]
# ## Try
# - **sign gain** to 0: the internal force comes to rest at what you asked for, and the steady tracking error grows from 0.04 to 0.3 mm.
#   To 1: a push moves the bar less, but the internal force is off by 19 N instead of 2 N. Each arm pushes for itself.
# - **squeeze** to 30 N: the arrows of the internal force grow, the motion stays the same.
# - **payload** to half its mass while the bar moves: nothing in the law knows the mass, and hardly anything changes.
# - **pose gain** to 10: 0.3 s after a push the bar is back within 5 mm, not 0.7 s; the internal force is off by 6 N instead of 2 N.
# - **damping gain** to a third: a push of 150 N moves the bar by 52 mm instead of 18 mm. To three times: too much for a law that is
#   sampled 80 times a second; after a push the arms fight each other with thousands of newtons. Lower it again and **Reset**.
# - `panel.close()` ends the view's process; it ends with the notebook's kernel in any case.
