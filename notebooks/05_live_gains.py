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
# # Live tuning: a panel with sliders
#
# Two arms carry a bar while you change the gains of the control law, the mass of the bar and the desired
# squeeze, and push the bar. The panel shows the effect on tracking and on the **internal force**, with
# which the arms press against each other.
#
# 1. Run the next cells; a 3-D view with strip charts appears, with buttons and sliders below it.
# 2. Press **Start**. Move a slider: it takes effect at the next tick, at most 12.5 ms later.
# 3. Press **Push**, or drag the bar: an arrow shows the force, and it acts when you let go.
#
# The panel speaks through the notebook's kernel: it needs neither a port nor a proxy.

# %%
# %matplotlib inline
import numpy as np

import coop_pin as cp
from coop_pin import figures
from coop_pin.viz import Panel, notebook_view

# %% [markdown]
# ## The run
# The paper's experiment without its events, which the panel replaces. After `duration` the run ends;
# **Reset** starts it again.

# %%
scenario = cp.Scenario.load("adept-paper").replace(duration=120.0, events=())
panel = Panel(scenario)
panel

# %% [markdown]
# ## The same from code
# The buttons and sliders call methods of `panel.run`. The next cell does three seconds of the simulation, as
# fast as it can, sets the sign gain to zero and pushes the bar with 150 N. The panel shows it.

# %%
run = panel.run
run.pause()
run.reset()


def advance(seconds):
    """Do the ticks of some seconds."""
    for _ in range(round(seconds * scenario.clock.rate_hz)):
        run.step()


advance(1.5)
run.change({"controller.gains.sign_gain": 0.0})
run.push((0.0, 150.0, 0.0, 0.0, 0.0, 0.0), duration=0.2)
advance(1.5)
print(f"stopped at t = {run.time:g} s")
print(*(f"{change.start:g} s: {change.text}" for change in run.changes), sep="\n")

# %% [markdown]
# ## The result
# `panel.result()` is a `RunResult` of everything since the last reset. Pushes and changes of mass are among
# its events; its caption lists the times at which gains or the squeeze were changed.

# %%
result = panel.result()
print(result.scenario.caption)
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
# ## Replay

# %%
notebook_view(result)

# %% [markdown]
# ## Try
# - **sign gain** to 0: the steady tracking error grows from 0.01 to 0.2 mm, and nothing carries an unknown
#   load. To 1: a push moves the bar less, but the internal-force error is 17 N instead of 0.1 N.
# - `cp.Scenario.load("adept-anchored")` in the first cell: the law that keeps both small. Its **anchor gain**
#   says how fast the measured internal wrench corrects the integral: at 0.1 the error is gone in a second.
# - **squeeze** to 30 N: the internal force grows, and the motion stays the same.
# - **payload** to half its mass while the bar moves: the law does not use the mass, and the motion hardly
#   changes.
# - **pose gain** to 10: after a push the bar is back within 5 mm in 0.3 s instead of 0.7 s; the
#   internal-force error is 6 N instead of 2 N.
# - **damping gain** to a third: a push of 150 N moves the bar by 52 mm instead of 18 mm. To three times its
#   value: unstable at 80 Hz; after a push the internal force reaches thousands of newtons. Lower it and
#   **Reset**.
# - `panel.close()` pauses the run, and the view shows no more.
