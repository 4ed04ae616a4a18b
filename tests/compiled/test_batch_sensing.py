"""Batches with every sensor and drive of a scenario, and with every controller, against coop_pin.run."""

import itertools

import numpy as np
import pytest
from batches import require_same_bits, require_same_samples
from cells import ANCHORED, SCENARIOS
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from sensing_settings import SETTINGS

import coop_pin as cp
from coop_pin.compiled import simulate_batch, support

QUICK_SETTINGS = [
    ("planar", "everything of drives", "printed"),
    *[("planar", setting, "anchored") for setting in ("counting encoders", "one wrist, stuck")],
    ("spatial", "commands lost", "printed"),
]


TIERS = {("spatial", "everything at once", "anchored"): pytest.mark.gate}


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
        pytest.param(*case, marks=[] if case in QUICK_SETTINGS else [TIERS.get(case, pytest.mark.slow)])
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
        require_same_samples(batch.result(index).data, cp.run(scenario, warn=False).data)


def test_runs_that_differ_in_sensors_and_drives_are_one_batch():
    """Also in the times at which samples arrive: they are signals of the runs, as their noise is."""
    base = in_setting("planar", "one wrist, lost", "anchored")
    wrist, lag = "arm_sensors.right.wrist", {"lag": 0.01, "missed_ticks": 0.2}
    scenarios = [
        base.override({f"{wrist}.lost": [[0.02, 0.04]], f"{wrist}.rate_hz": 80.0, "actuators": lag}),
        base.override(
            {f"{wrist}.lost": [[0.0, 0.01]], f"{wrist}.rate_hz": 40.0, "actuators": lag, "seed": 3}
        ),
        base.override(
            {f"{wrist}.offset.force": 9.0, f"{wrist}.rate_hz": 20.0, "actuators": lag | {"lag": 0.003}}
        ),
    ]
    batch = simulate_batch(scenarios)
    for index, scenario in enumerate(scenarios):
        require_same_samples(batch.result(index).data, cp.run(scenario, warn=False).data)
    ages = batch.samples["measured_wrench_age"][:, :, 1]
    assert len({ages[index].tobytes() for index in range(3)}) == 3


@pytest.mark.slow
@pytest.mark.parametrize("cell", SCENARIOS)
def test_bits_of_noisy_batches_depend_on_nothing_else(cell):
    """Vector width, emitter, size of the batch and what folds."""
    scenarios = [in_setting(cell, "everything at once", "anchored", seed) for seed in range(3)]
    record = require_same_bits(scenarios)
    assert np.isfinite(simulate_batch(scenarios).samples["drive_velocity"]).all()
    assert not np.isnan(record).any()


def numbers(low, high):
    return st.floats(low, high, allow_nan=False)


@pytest.mark.slow
@pytest.mark.parametrize("cell", SCENARIOS)
@settings(
    max_examples=6,
    deadline=None,
    derandomize=True,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(data=st.data())
def test_random_cells_are_those_of_the_oracle_and_of_single_runs(cell, data):
    """Masses, bases, grasps, friction, calibration, gains, sensors and drives at random, of two runs each."""

    def drawn():
        draw = lambda low, high: data.draw(numbers(low, high))  # noqa: E731
        turn = [0.0, 0.0, draw(-0.1, 0.1)] if cell == "planar" else [draw(-0.1, 0.1) for _ in range(3)]
        grasp = base.cell.grasps["right"]
        return {
            "cell.payload.mass": draw(0.5, 2.0) * base.cell.payload.mass,
            "cell.arms.left.friction": {"viscous": draw(0.0, 3.0), "coulomb": draw(0.0, 0.3)},
            "cell.arms.right.calibration_error": {"tip": {"xyz": [draw(-1e-3, 1e-3), 0.0, 0.0]}},
            "cell.grasps.right.rpy": (np.array(grasp.rpy) + turn).tolist(),
            "controller.gains.transient_rate": draw(2.0, 8.0),
            "actuators": {"lag": draw(0.001, 0.01), "rate_limit": draw(30.0, 300.0)},
            "sensors": {
                "encoder": {"noise": draw(1e-6, 1e-5), "offset": draw(-1e-4, 1e-4)},
                "velocity": {"kind": "observer", "bandwidth_hz": draw(10.0, 30.0)},
                "wrist": {"noise": {"force": draw(0.1, 2.0)}, "delay": 1},
            },
            "seed": data.draw(st.integers(0, 2**32)),
        }

    base = in_setting(cell, "lag", "anchored")
    base = base.replace(duration=4.0 / base.clock.rate_hz)
    scenarios = [base.override(drawn()) for _ in range(2)]
    require_same_bits(scenarios)
    batch = simulate_batch(scenarios)
    assert batch.is_valid.all()
    for index, scenario in enumerate(scenarios):
        require_same_samples(batch.result(index).data, cp.run(scenario, warn=False).data)


def test_runs_with_and_without_an_error_of_the_kinematics_share_a_batch():
    """Each has the quantities of its own single run."""
    start = cp.Scenario.load("adept-anchored", {"duration": 0.1, "events": []})
    wrong = start.override({"cell.arms.left.calibration_error.tip.xyz": (1e-3, 0.0, 0.0)})
    batch = simulate_batch([start, wrong])
    for index, scenario in enumerate([start, wrong]):
        require_same_samples(batch.result(index).data, cp.run(scenario, warn=False).data)
