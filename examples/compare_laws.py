"""Laws on the paper's experiment: the printed one, and the payload-space law without and with a sensor."""

import coop_pin as cp

quiet = {"duration": 10.0, "events": []}
filtered = {"sensors.wrist": {}, "controller.force_path": {"kind": "low-pass", "pole": 0.9}}
unsensed = {"controller.force_path": {"kind": "none"}}
sgn = {
    "controller.switching": {"kind": "sign"},
    "controller.gains.sign_gain": 0.2,
    "controller.gains.leak": 0.0,
}
# A scenario holds its law; overrides change its fields.
laws = {
    "printed, alpha = 0.002": ("adept-paper", {}),
    "printed, alpha = 0.002, K_f = 9": ("adept-paper", filtered | {"controller.gains.force_gain": 9.0}),
    "printed, alpha = 0.2": ("adept-paper", {"controller.gains.sign_gain": 0.2}),
    "printed, alpha = 0": ("adept-paper", {"controller.gains.sign_gain": 0.0}),
    "payload-space, sgn": ("adept-anchored", unsensed | sgn),
    "payload-space, no sensor": ("adept-anchored", unsensed),
    "payload-space, anchored": ("adept-anchored", {}),
}

print("law                              position, mm rms   internal-force error, N rms   torque peak, N m")
for name, (scenario, changes) in laws.items():
    result = cp.run(scenario, quiet | changes)
    force = result.internal_force(window=(4.0, 10.0))
    print(
        f"{name:32} {result.position_rms(window=(4.0, 10.0)) * 1e3:16.3f} {force.force_rms_error:29.4f}"
        f" {result.metrics()['torque_peak_Nm']:18.1f}"
    )
