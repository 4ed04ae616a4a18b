"""Stability map of delayed force feedback over gain and control rate. Usage: stability_map.py [FOLDER]"""

import sys

import coop_pin as cp

print(cp.run("adept-paper", {"duration": 5.0, "events": []}).internal_force(window=(4.0, 5.0)))

GAIN, RATE = "controller.gains.force_gain", "clock.rate_hz"
late = {"duration": 5.0, "events": [], "beyond_bound": True, "controller.force_path.kind": "late"}
axes = {RATE: [80, 160], GAIN: cp.sweeps.linspace(0.0, 1.25, 6)}
result = cp.sweep(
    "adept-paper", axes, changes=late, out=sys.argv[1] if len(sys.argv) > 1 else "out/stability"
)

print(result.data["failure"].to_pandas())
print(result.values("moving_internal_axial_rms_error_N").to_pandas())
print(result.stability_boundary(GAIN).to_dataframe())
