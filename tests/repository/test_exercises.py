"""Solutions of the exercises: their numbers, and those of the exercises' page."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.comparison import controllers_for
from coop_pin.comparison.trials import benchmark_scenario

FOLDER = Path(__file__).parents[2] / "examples" / "exercises"
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


@pytest.mark.gate
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


@pytest.mark.parametrize("cell", ["adept-anchored", "kinova-pair"])
def test_the_mean_pose_law_of_thirty_lines_is_that_of_the_package(solution, cell):
    scenario = benchmark_scenario(cp.Scenario.load(cell), 0.2)
    biased = {f"cell.arms.{next(iter(scenario.cell.arms))}.calibration_error.tip.xyz": [1e-3, 0.0, 0.0]}
    law = controllers_for(scenario, ["mean-pose"], tuned=False)["mean-pose"]
    own = solution("mean_pose").mean_pose(
        law | {"kind": "payload-space", "gains": law["gains"] | {"leak": 0.0}}
    )
    torques = [cp.run(scenario, {"controller": each} | biased, warn=False).data.torque for each in (law, own)]
    assert_allclose(*torques, rtol=0, atol=1e-9 * float(abs(torques[0]).max()))


@pytest.mark.gate
def test_freedoms_and_internal_wrenches_are_those_of_the_table(solution):
    table = (FOLDER.parents[1] / "docs" / "howto" / "grasps.md").read_text(encoding="utf-8")
    rows = re.findall(r"\| (?:two|three) (\w+?)s? \| ([\d, ]+) \| (\d) \|", table)
    shown = {kind: (*map(int, left.split(", ")), int(internal)) for kind, left, internal in rows}
    assert solution("count_freedoms").compared() == shown
    told = re.search(r"leave (\d) freedoms and (\d) internal .* (\d) and (\d), cylinders (\d) and (\d)", PAGE)
    four = [value for kind in ("rigid", "hinge", "cylinder") for value in (shown[kind][2], shown[kind][4])]
    assert list(map(int, told.groups())) == four


@pytest.mark.gate
def test_the_damping_of_a_light_wrist_is_predicted_and_proposed(solution):
    wrist = solution("light_wrist")
    rows = wrist.compared()
    assert_allclose(*zip(*rows.values(), strict=True), rtol=0.02)
    proposed = cp.suggest(wrist.hinged(8.0), poses=21).scenario.controller.posture.damping
    shown = re.search(r"8 N m s/rad of other cells give ([\d.]+), .* `suggest` takes ([\d.]+) N m", PAGE)
    assert_allclose([rows[8.0][1], proposed], [*map(float, shown.groups())], rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", [path.stem for path in FOLDER.glob("*.py")])
def test_the_commands_print_their_tables(name, tmp_path):
    command = [sys.executable, str(FOLDER / f"{name}.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=True)
    assert len(re.findall(r"\d\.\d", done.stdout)) >= 4
    assert done.stderr == ""
