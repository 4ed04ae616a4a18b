"""Settings of sensors, drives and network with which tests run cells."""

from __future__ import annotations

NOISY = {
    "noise": {"force": 1.0, "moment": 0.05},
    "offset": {"force": (1.0, 0.0, 2.0)},
    "drift": {"force": 3.0},
}

SETTINGS = {
    "counting encoders": {
        "sensors": {
            "encoder": {"resolution": 1e-4, "noise": 1e-4, "offset": 1e-3},
            "velocity": {"kind": "difference"},
        }
    },
    "observer": {"sensors": {"encoder": {"noise": 1e-5}, "velocity": {"kind": "observer"}}},
    "one noisy arm": {"arm_sensors": {"right": {"encoder": {"noise": 1e-5}}}},
    "wrists": {"sensors": {"wrist": {**NOISY, "delay": 1}, "holding_torque_error": 0.1}},
    "one wrist, lost": {"arm_sensors": {"right": {"wrist": {**NOISY, "delay": 2, "lost": [[0.02, 0.03]]}}}},
    "one wrist, stuck": {"arm_sensors": {"right": {"wrist": {**NOISY, "delay": 1, "stuck_at": 0.02}}}},
    "slow wrists": {"sensors.wrist": NOISY, "sensors.wrist.rate_hz": 0.5},  # of the control rate
    "lag": {"actuators": {"lag": 0.01}},
    "rate limit": {"actuators": {"rate_limit": 30.0}},
    "everything of drives": {
        "actuators": {
            "lag": 0.01,
            "rate_limit": 30.0,
            "missed_ticks": 0.2,
            "gravity_compensation": {"mass_error": 0.1},
        },
        "cell.arms.left.torque_limits": 3.0,
    },
    "torque lost": {"arm_actuators": {"right": {"torque_lost_at": 0.0313}}},
    "commands lost": {"arm_actuators": {"right": {"commands_lost_at": 0.0313, "gravity_compensation": {}}}},
    "torque lost with lag": {"arm_actuators": {"left": {"torque_lost_at": 0.0313, "lag": 0.01}}},
    "everything at once": {
        "sensors": {
            "encoder": {"resolution": 1e-4, "noise": 1e-5},
            "velocity": {"kind": "difference"},
            "wrist": {**NOISY, "delay": 1, "lost": [[0.02, 0.03]]},
        },
        "actuators": {"lag": 0.005, "missed_ticks": 0.1, "gravity_compensation": {}},
        "arm_actuators": {"left": {"torque_lost_at": 0.0313, "rate_limit": 100.0}},
        "clock.record_every": 3,
    },
}
