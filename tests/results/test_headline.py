"""What a run tells first: the largest error of its data, and tracking metrics that are no NaN."""

import re

import numpy as np
import pytest

import coop_pin as cp

CELLS = {"planar": "adept-anchored", "spatial": "two-pandas-box"}
UNITS = {"mm": 1e-3, "N": 1.0}
ALWAYS = (
    *("position_error_max_m", "orientation_error_max_rad"),
    *("internal_force_error_max_N", "internal_moment_error_max_Nm"),
)


def pushed(rng, name):
    """A cell for 0.5 to 20 s, pushed for a tenth of a second at any time."""
    duration = 0.5 * 40.0 ** rng.random()
    push = {"kind": "wrench-pulse", "time": rng.uniform(0.0, duration - 0.15), "duration": 0.1}
    push["wrench"] = (*rng.uniform(-8.0, 8.0, 2), *np.zeros(4))
    if name == "spatial":
        push["wrench"] = (*rng.uniform(-15.0, 15.0, 3), *rng.uniform(-1.0, 1.0, 3))
    return cp.Scenario.load(CELLS[name]).override({"duration": duration, "events": [push]})


def assert_the_largest_is_told(result):
    """In metrics to the bit, from the times that are told, and in the verdict to its digits."""
    data, metrics = result.data, result.metrics()
    errors = {
        "position_error_max_m": np.linalg.norm(data.pose_error.values[:, :3], axis=1),
        "internal_force_error_max_N": np.nanmax(
            np.hypot(data.internal_axial_error.values, data.internal_shear_error.values), axis=1
        ),
    }
    for name, values in errors.items():
        ((begin, end),) = result.windows_of(name)
        assert end == data.time.values[-1]
        assert metrics[name] == values[data.time.values >= begin - 1e-9].max()
        first = min((event.time for event in result.scenario.events), default=end)
        left_out = (data.time.values >= first) & (data.time.values <= begin)
        assert (np.diff(values[left_out]) <= 0.0).all()  # after a push it only decays
    if result.task.kept:
        for word, name in (
            ("position", "position_error_max_m"),
            ("internal force", "internal_force_error_max_N"),
        ):
            number, unit = re.search(rf"{word} to ([\d.e-]+) (mm|N)", result.task.text).groups()
            assert float(number) * UNITS[unit] == pytest.approx(metrics[name], rel=0.06)
    assert np.isfinite([metrics[name] for name in ALWAYS]).all()


@pytest.mark.parametrize("name", CELLS)
def test_the_largest_error_of_a_pushed_run_is_the_maximum_of_its_data(name):
    rng = np.random.default_rng(5)
    assert_the_largest_is_told(cp.run(pushed(rng, name).replace(duration=0.5, events=()), warn=False))


@pytest.mark.slow
@pytest.mark.parametrize("name", CELLS)
@pytest.mark.parametrize("seed", [20261201])
def test_the_largest_error_is_the_maximum_of_the_data_whenever_a_push_comes(name, seed):
    rng = np.random.default_rng(seed)
    for _ in range(20):
        assert_the_largest_is_told(cp.run(pushed(rng, name), engine="auto", warn=False))


@pytest.mark.slow
@pytest.mark.parametrize("name", cp.scenario_names())
def test_a_scenario_of_the_catalogue_has_numbers_for_its_tracking(name):
    """For motion and for rest, where its reference moves and rests, the start's decay and events apart."""
    result = cp.run(name, engine="auto", warn=False)
    metrics, speeds = result.metrics(), np.linalg.norm(result.data.desired_twist.values, axis=1)
    assert np.isfinite([metrics[key] for key in ALWAYS]).all()
    phases = {"moving": (speeds > 0.0).mean(), "rest": (speeds == 0.0).mean()}
    for phase, part in phases.items():
        assert np.isfinite(metrics[f"{phase}_position_rms_m"]) == (part > 0.01), (phase, part)
