"""Sweep in a loop: feedback divides the internal-force error by 1 + K_f, up to K_f = 1 when a tick late."""

import math

import coop_pin as cp

late = {"controller.force_path.kind": "late", "beyond_bound": True, "duration": 10.0, "events": []}
alone = None

print("  K_f   error, N, rms   1 / (1 + K_f)   ratio to K_f = 0")
for K_f in (0.0, 0.25, 0.5, 0.75, 0.9, 1.1):
    try:
        result = cp.run("adept-paper", late | {"controller.gains.force_gain": K_f})
    except cp.CoopPinError as error:
        print(f"{K_f:5.2f}   {error}")
        continue
    force = result.internal_force(window=(4.0, 10.0))
    error = math.hypot(force.axial_rms_error, force.shear_rms)
    alone = alone or error
    print(f"{K_f:5.2f} {error:15.3f} {1 / (1 + K_f):15.3f} {error / alone:18.3f}")
