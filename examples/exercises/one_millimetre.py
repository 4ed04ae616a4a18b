"""Exercise 1: predict the internal force that a bias of 1 mm leaves under the anchored law, then halve it."""

import coop_pin as cp

BIAS = {"cell.arms.left.calibration_error.tip.xyz": [1e-3, 0.0, 0.0]}
QUIET = {"events": [], "duration": 7.0}


def predicted(scenario, bias=1e-3):
    """c k_I K gamma |b - bbar| / beta for two equal arms, |b - bbar| = b / 2, beta = g / T."""
    gains, (c, _) = scenario.controller.gains, scenario.cell.shares
    k_I = gains.sign_gain / scenario.controller.switching.width
    beta = gains.anchor_gain / scenario.clock.period
    return c * k_I * gains.sliding_gain[0] * gains.pose_gain * (bias / 2) / beta


def compared():
    """Return predicted and simulated force, N, by gains."""
    scenario = cp.Scenario.load("adept-anchored", QUIET | BIAS)
    gains = scenario.controller.gains
    changes = {
        "as shipped": {},
        "twice g": {"controller.gains.anchor_gain": 2 * gains.anchor_gain},
        "half k_I": {"controller.gains.sign_gain": gains.sign_gain / 2},
    }
    rows = {}
    for name, change in changes.items():
        result = cp.run(scenario, change)
        rows[name] = predicted(result.scenario), result.internal_force(window=(6.0, 7.0)).force_rms_error
    return rows


if __name__ == "__main__":
    for name, (expected, simulated) in compared().items():
        print(f"{name:11} predicted {expected:.3f} N, simulated {simulated:.3f} N")
