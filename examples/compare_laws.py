"""Two laws on one experiment: the printed one, and the payload-space law, with less internal force."""

import coop_pin as cp

quiet = {"duration": 10.0, "events": []}
gains = cp.PayloadSpaceGains(
    pose_gain=2.0, sliding_gain=(800.0, 800.0, 40.0), sign_gain=0.2, transient_rate=5.0
)
# The scenario has the printed law; overrides change its fields, or replace it.
laws = {
    "printed, alpha = 0.2": {},
    "printed, alpha = 0": {"controller.gains.sign_gain": 0.0},
    "payload-space, alpha = 0.2": {"controller": cp.PayloadSpace(gains=gains)},
}

print("law                          position, mm rms   internal-force error, N rms   torque peak, N m")
for name, changes in laws.items():
    result = cp.run("adept-paper", quiet | changes)
    force = result.internal_force()
    print(
        f"{name:28} {result.position_rms() * 1e3:16.3f} {force.force_rms_error:29.2f}"
        f" {result.torque_peak():18.1f}"
    )
