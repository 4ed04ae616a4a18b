"""The paper's experiment from Python: load, change a gain, run, print, save. Usage: run_paper.py [FOLDER]"""

import sys
from pathlib import Path

import coop_pin as cp
from coop_pin.viz import save_replay

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/run_paper")

scenario = cp.Scenario.load("adept-paper").override({"controller.gains.sign_gain": 0.1})
result = cp.run(scenario)

for name, value in result.metrics().items():
    print(f"{name:30} {value}")
left = result.data["internal_wrench"].sel(
    arm="left", axis=["x", "y"], time=slice(4.0, 10.0)
)  # an xarray: names, units, plots
print(f"mean internal force on the left arm, world axes: {left.mean('time').values} {left.units}")

result.save(folder / "result.nc")
save_replay(result, folder / "replay.html")
