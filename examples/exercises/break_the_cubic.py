"""Exercise 2: a motion that grows, by gains within every bound but lambda > gamma k_I / (gamma + k_I)."""

import numpy as np

import coop_pin as cp

LEAST_RATE = 11.9
"""Least eigenvalue of A^-1 K along the motion of adept-anchored, 1/s."""
WIDTH = 10.0
"""A layer that nothing leaves: the integral is linear, k_I = sign_gain / WIDTH."""

DURATION = 5.0
"""Of a run, s."""


def roots(rate, gamma, k_I):
    """Return the roots of z^3 + rate (z + gamma)(z + k_I)."""
    return np.roots([1.0, rate, rate * (gamma + k_I), rate * gamma * k_I])


def last_second(gain):
    """Return the rms position error of the last second with gamma = k_I = gain, m."""
    result = cp.run(
        "adept-anchored",
        {
            "events": [],
            "duration": DURATION,
            "clock.rate_hz": 400.0,
            "clock.steps_per_tick": 1,
            "controller.force_path": {"kind": "none"},
            "controller.switching.width": WIDTH,
            "controller.gains.pose_gain": gain,
            "controller.gains.sign_gain": gain * WIDTH,
            "controller.gains.leak": 0.0,
        },
        warn=False,  # of the loop, which is unstable on purpose
    )
    return result.position_rms(window=(DURATION - 1.0, DURATION))


if __name__ == "__main__":
    print("gamma = k_I   least lambda   largest real part of the roots   error, m rms in the last second")
    for gain in (20.0, 28.0):
        real = roots(LEAST_RATE, gain, gain).real.max()
        print(f"{gain:11.0f} {gain / 2:14.1f} {real:32.2f} {last_second(gain):34.2g}")
