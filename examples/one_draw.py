"""One run is one draw: the internal-force error of the printed law over starts that differ by millimetres."""

import coop_pin as cp

scenario = cp.Scenario.load("adept-paper", {"duration": 10.0, "events": []})
x, y, z = scenario.start.xyz
print("start moved along x, mm    alpha = 0.2, N rms    alpha = 0, N rms")
for moved in (-3, -2, -1, 0, 1, 2):
    start = {"start.xyz": [x + 1e-3 * moved, y, z]}
    runs = [cp.run(scenario, start | {"controller.gains.sign_gain": alpha}) for alpha in (0.2, 0.0)]
    printed, without = (run.internal_force(window=(4.0, 10.0)).force_rms_error for run in runs)
    print(f"{moved:23d} {printed:22.1f} {without:19.3f}")
