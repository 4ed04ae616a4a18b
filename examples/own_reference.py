"""User-written functions of time as motion and squeeze: a figure of eight, pressed harder and harder."""

import numpy as np

import coop_pin as cp
from coop_pin.spatial import make_pose

CENTRE, TURN = np.array([0.5, 0.05, 0.0]), np.pi / 3


def eight(time, size=0.06, period=6.0):
    """X_WP_d; its twist comes from central differences. It starts slowly, so that the start is at rest."""
    phase = 2.0 * np.pi * time / period * min(time / 2.0, 1.0)
    return make_pose(
        CENTRE + size * np.array([np.sin(phase), np.sin(2.0 * phase) / 2.0, 0.0]), (0.0, 0.0, TURN)
    )


def press(time):
    """f_d of each arm about P in payload axes; they sum to zero."""
    force = np.array([5.0 + 2.0 * time, 0.0, 0.0, 0.0, 0.0, 0.0])
    return {"left": -force, "right": force}


if __name__ == "__main__":
    changes = {
        "motion": {"kind": "function", "target": "own_reference:eight"},
        "squeeze": {"kind": "function", "target": "own_reference:press"},
        "start": {"xyz": CENTRE.tolist(), "rpy": [0.0, 0.0, TURN]},
        "controller.gains.sign_gain": 0.05,
        "duration": 8.0,
        "events": [],
    }
    result = cp.run("adept-paper", changes)
    print(f"position error {1e3 * result.position_rms(window=(4.0, 8.0)):.3f} mm rms")
    for time in (2.0, 4.0, 6.0, 8.0):
        f = result.data["internal_wrench"].sel(arm="left", axis=["x", "y"]).sel(time=time, method="nearest")
        print(f"t = {time:g} s: pressed with {np.linalg.norm(f):5.2f} N, desired {5.0 + 2.0 * time:5.2f} N")
