"""Batches with every sensor and drive of a scenario, and with every controller, against coop_pin.run."""

import itertools

import pytest
from batches import require_same_samples
from cells import ANCHORED, SCENARIOS

import coop_pin as cp
from coop_pin.batch import simulate_batch, support

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
QUICK_SETTINGS = [
    *[("planar", setting, "printed") for setting in ("observer", "everything of drives")],
    *[("planar", setting, "anchored") for setting in ("counting encoders", "one wrist, lost", "slow wrists")],
    ("spatial", "everything at once", "anchored"),
]


def in_setting(cell, setting, law, seed=0):
    """A short run of a test cell with a force path that filters and delays."""
    scenario = SCENARIOS[cell]()
    duration = 0.0625 if cell == "planar" else 0.04
    base = scenario.replace(duration=duration, events=(), beyond_bound=True, seed=seed)
    path = {"kind": "low-pass", "pole": 0.5, "delay": 1}
    controller = {"controller": ANCHORED[cell], "controller.force_path": path} if law == "anchored" else {}
    changes = controller | SETTINGS[setting]
    if (share := changes.get("sensors.wrist.rate_hz")) is not None:
        changes = changes | {"sensors.wrist.rate_hz": share * scenario.clock.rate_hz}
    return base.override(changes)


@pytest.mark.parametrize(
    ("cell", "setting", "law"),
    [
        pytest.param(*case, marks=[] if case in QUICK_SETTINGS else [pytest.mark.slow])
        for case in itertools.product(SCENARIOS, SETTINGS, ("printed", "anchored"))
    ],
)
def test_sensors_and_drives_of_batches_are_those_of_single_runs(cell, setting, law):
    """Every sample of two seeds; random numbers are the same ones."""
    scenarios = [in_setting(cell, setting, law, seed) for seed in range(2)]
    assert support(scenarios[0]) is None
    batch = simulate_batch(scenarios)
    assert batch.is_valid.all()
    for index, scenario in enumerate(scenarios):
        require_same_samples(batch.result(index).data, cp.run(scenario).data)
