"""Newtons of causes: by runs where no formula covers the law, the law's shares, and ranks of blind draws."""

import itertools

import numpy as np
import pytest
from blame_ranking import answers, is_first, unit_costs
from log_cells import RICH

import coop_pin as cp
from coop_pin.identification import Priors

PRIORS = Priors(clock=3e-3, link=0.0)
QUIET = {"events": [], "duration": 6.0}
LAWS = {
    "printed, rigid": ("adept-paper", QUIET),
    "anchored, springs": ("adept-compliant", QUIET),
}
ERRORS = {
    "tip": {"tip": {"xyz": [1e-3, 0.0, 0.0]}},
    "base": {"base": {"xyz": [1e-3, 0.0, 0.0]}},
    "joint": {"joint_offset": [0.0, 2e-3, *[0.0] * 5]},
}


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_newtons_of_the_first_cause_are_those_of_a_run_with_it_alone(law):
    """10 % or 0.01 N, from runs without noise; on springs of its cell the printed law diverges."""
    name, changes = LAWS[law]
    scenario = cp.Scenario.load(name, changes)
    plain, joints = cp.run(scenario, warn=False), len(scenario.cell.arms["left"].posture)
    for part, error in ERRORS.items():
        error = {key: value[:joints] if key == "joint_offset" else value for key, value in error.items()}
        made = cp.run(scenario.override({"cell.arms.left.calibration_error": error}), warn=False)
        force = (made.data.internal_wrench - plain.data.internal_wrench).values
        force = np.nan_to_num(force[:, :, [k for k in scenario.cell.task_rows.indices if k < 3]])
        expected = np.linalg.norm(force, axis=2).max(axis=1).mean()
        answer = cp.blame(made, priors=PRIORS)
        assert answer.simulated
        of_part = [one for one in answer.causes if one.members[0].part != "friction"]
        assert any(member.part == part for member in of_part[0].members) or expected < 0.05
        assert abs(answer.views[0] - expected) < max(0.1 * expected, 0.01), (part, answer.summary())


@pytest.mark.parametrize(
    "changes",
    [("adept-anchored", QUIET), pytest.param(("two-pandas-box", RICH), marks=pytest.mark.slow)],
)
def test_a_run_without_noise_is_explained_and_its_folder_is_a_log(changes, tmp_path):
    result = cp.run(*changes, warn=False)
    result.save(tmp_path / "result.nc")
    answer = cp.blame(tmp_path)
    assert {one.severity for one in answer.findings} <= {"note"}
    assert answer.payload.chi < 1.1
    assert answer.kinematics.chi < 1.1
    assert answer.views[0] < 0.01
    assert answer.share.newtons < 0.05
    motion = answer.excitation
    assert motion.after < motion.before
    points = {"motion": {"kind": "waypoints", "points": list(motion.points)}, "duration": 4.0}
    assert cp.run(result.scenario, points, warn=False).limit_violations() == ()


@pytest.mark.parametrize("share", [0.47, pytest.param(0.51, marks=pytest.mark.slow)])
def test_shares_of_the_law_that_are_not_those_of_the_cell_are_told(share):
    """Closed form: the internal force by the cell's shares is the difference times the whole force."""
    scenario = cp.Scenario.load("two-pandas-box", {"duration": 4.0, "sensors": {"wrist": {}}})
    result = cp.run(scenario, {"cell.load_shares": {"left": share, "right": 1.0 - share}}, warn=False)
    answer = cp.blame(cp.logs.Record.of_run(result), scenario, priors=PRIORS)
    expected = abs(share - 0.5) * scenario.cell.payload.mass * np.linalg.norm(scenario.cell.gravity)
    assert answer.causes[0] is answer.share
    assert abs(answer.share.newtons - expected) < 0.05 * expected


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "classes"),
    [("turning", ["share", "friction"]), ("adept", ["tip", "base", "joint", "wrist", "clock"])],
)
def test_the_culprit_is_first_in_18_of_20_blind_draws_of_a_class(kind, classes, request):
    """A class that was drawn is kept, so that an interrupted test goes on."""
    cache, (costs, load) = request.config.cache, unit_costs(kind)
    for part in classes:
        key = f"blame/{kind}-{part}"
        if cache.get(key, None) is None:
            sound = itertools.islice(answers(kind, part, range(7000, 7024), costs, load), 20)
            draws = [
                (is_first(culprit, answer), len(answer.causes[0].arms) == 2) for culprit, answer in sound
            ]
            cache.set(key, [[bool(first), bool(both)] for first, both in draws])
        first, both = np.array(cache.get(key, None)).T
        assert len(first) == 20, part
        assert first.sum() >= 18, (part, first.sum())
        if part in ("tip", "base"):  # only the difference is seen
            assert both[first].all(), part
