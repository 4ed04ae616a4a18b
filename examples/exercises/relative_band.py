"""Exercise 4: does a larger K_f converge faster? That depends on the band; K_f cancels in a relative one."""

import numpy as np

import coop_pin as cp

GAINS = (0.0, 1.0, 3.0, 9.0, 15.0)


def error(K_f):
    """Return time and internal-force error, axial and shear together, the worse arm, with alpha = 0."""
    data = cp.run(
        "adept-paper",
        {
            "events": [],
            "duration": 9.9875,
            "controller.gains.sign_gain": 0.0,
            "controller.gains.force_gain": K_f,
            "controller.force_path": {"kind": "low-pass", "pole": 0.9},
        },
    ).data
    force = np.hypot(data.internal_axial_error, data.internal_shear_error).max("arm")
    return data.time.values, force.values


def below_after(time, force, band):
    """Return the first time after which the error stays within a band."""
    outside = np.flatnonzero(force > band)
    return float(time[outside[-1] + 1]) if outside.size else 0.0


def compared(gains=GAINS):
    """Return rms from 4 s on, N, and the times to 0.1 N, to 0.2 N and to twice the rms, s, by K_f."""
    rows = {}
    for K_f in gains:
        time, force = error(K_f)
        rms = float(np.sqrt(np.mean(force[time >= 4.0] ** 2)))
        rows[K_f] = (rms, *(below_after(time, force, band) for band in (0.1, 0.2, 2.0 * rms)))
    return rows


if __name__ == "__main__":
    print(" K_f   rms, N   below 0.1 N   below 0.2 N   below twice its rms")
    for K_f, (rms, tenth, fifth, relative) in compared().items():
        print(f"{K_f:4g} {rms:8.4f} {tenth:11.2f} s {fifth:11.2f} s {relative:19.2f} s")
