"""Solutions of the exercises: their numbers, and those of the exercises' page."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
from numpy.testing import assert_allclose

import coop_pin as cp

FOLDER = Path(__file__).parent.parent / "examples" / "exercises"
PAGE = (FOLDER.parents[1] / "docs" / "exercises.md").read_text(encoding="utf-8")


@pytest.fixture
def solution(monkeypatch):
    """Return a solution by name, imported as its command does."""
    monkeypatch.syspath_prepend(str(FOLDER))
    yield importlib.import_module
    for path in FOLDER.glob("*.py"):
        sys.modules.pop(path.stem, None)


def test_every_solution_is_on_the_page_and_every_one_there_exists():
    assert set(re.findall(r"python examples/exercises/(\w+)\.py", PAGE)) == {
        path.stem for path in FOLDER.glob("*.py")
    }


def test_the_force_under_one_millimetre_is_predicted_and_halved(solution):
    rows = solution("one_millimetre").compared()
    assert_allclose([force for force, _ in rows.values()], [0.25, 0.125, 0.125], rtol=1e-9)
    assert_allclose([force for _, force in rows.values()], [0.25, 0.125, 0.125], rtol=0.02)


@pytest.mark.slow
def test_gains_beyond_the_cubics_rule_grow(solution):
    cubic = solution("break_the_cubic")
    assert cubic.roots(11.9, 20.0, 20.0).real.max() < 0.0 < cubic.roots(11.9, 28.0, 28.0).real.max()
    assert cubic.last_second(20.0) < 1e-4
    assert cubic.last_second(28.0) > 0.1


@pytest.mark.slow
def test_the_force_gain_cancels_in_a_relative_band(solution):
    rows = solution("relative_band").compared((0.0, 9.0))
    (_, *slow), (_, *fast) = rows.values()
    assert_allclose(slow, [5.8, 1.28, 1.30], rtol=0.02)
    assert_allclose(fast, [0.83, 0.10, 1.45], rtol=0.02)


STORED = {"pose_gain": 7.19894, "sign_gain": 115.522}
"""Gains of payload-pi on adept-anchored at 4824ca2."""


def law(**changes):
    gains = {"sliding_gain": [800.0, 800.0, 40.0], "anchor_gain": 0.0, "leak": 0.0, "transient_rate": 5.0}
    saturation = {"kind": "saturation", "width": 10.0}
    return {"kind": "payload-space", "switching": saturation, "gains": gains | STORED | changes}


def run_of(cell, controller, changes, duration):
    """Position, mm, and internal-force error, N, rms from 0.4 of the run on."""
    from coop_pin.comparison.trials import benchmark_scenario

    scenario = benchmark_scenario(cp.Scenario.load(cell), duration)
    result = cp.run(scenario, {"controller": controller} | changes)
    window = (0.4 * duration, duration)
    return 1e3 * result.position_rms(window=window), result.internal_force(window=window).force_rms_error


def tip_of(cell, bias=1e-3):
    first = next(iter(cp.Scenario.load(cell).cell.arms))
    return {f"cell.arms.{first}.calibration_error.tip.xyz": [bias, 0.0, 0.0]}


def test_exchanged_poses_cure_a_bias_and_not_friction(solution):
    """Under 1 mm of bias 0.1 N are left; friction leaves more than the anchored law by a factor of five."""
    study = solution("mean_pose")
    mean = study.mean_pose(law())
    biased = run_of("adept-anchored", mean, tip_of("adept-anchored"), 5.0)
    assert_allclose(biased, [0.504, 0.105], rtol=0.01)
    rough = solution("friction").TRIALS["2 N m Coulomb, 3 N m stiction"]
    _, by_pose = run_of("adept-anchored", mean, rough, 5.0)
    anchored = law(pose_gain=6.38034, sign_gain=0.53399, anchor_gain=0.0500622, leak=None)
    anchored |= {"force_path": {"kind": "late"}, "switching": {"kind": "saturation", "width": 0.05}}
    _, by_wrench = run_of("adept-anchored", anchored, rough, 5.0)
    assert_allclose([by_pose, by_wrench], [4.03, 0.369], rtol=0.01)
    assert by_pose > 5.0 * by_wrench


@pytest.mark.slow
def test_exchanged_poses_do_not_drift_in_a_minute(solution):
    mean = solution("mean_pose").mean_pose(law())
    _, early = run_of("adept-anchored", mean, tip_of("adept-anchored"), 20.0)
    position, late = run_of("adept-anchored", mean, tip_of("adept-anchored"), 60.0)
    assert_allclose([early, position], [0.0787, 0.5], rtol=0.01)
    assert late < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "gains", "expected"),
    [
        ("two-pandas-box", (1.01932, 173.616), (0.473, 0.0485)),
        ("panda-ur5-bar", (1.12452, 163.272), (0.480, 0.0385)),
        ("three-ur5-plate", (1.00439, 189.11), (0.312, 0.0502)),
        ("kinova-pair", (1.24677, 198.318), (0.488, 0.0079)),
        ("five-joint-pair", (7.89657, 197.473), (0.506, 1.14)),
    ],
)
def test_exchanged_poses_in_the_cells_in_space(solution, cell, gains, expected):
    """With the gains of payload-pi at 4824ca2; the five-joint cell without the spring of its spare joints."""
    K = cp.Scenario.load(cell).controller.gains.sliding_gain
    stored = law(pose_gain=gains[0], sign_gain=gains[1], sliding_gain=list(K))
    if cell == "five-joint-pair":
        stored["posture"] = {"stiffness": 0.0}
    mean = solution("mean_pose").mean_pose(stored)
    assert_allclose(run_of(cell, mean, tip_of(cell), 5.0), expected, rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", [path.stem for path in FOLDER.glob("*.py")])
def test_the_commands_print_their_tables(name, tmp_path):
    command = [sys.executable, str(FOLDER / f"{name}.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=True)
    assert len(re.findall(r"\d\.\d", done.stdout)) >= 4
    assert done.stderr == ""
