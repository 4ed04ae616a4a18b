"""Newtons of causes: by runs where no formula covers the law, the law's shares, and ranks of blind draws."""

import dataclasses

import blame_logs
import numpy as np
import pytest
from blame_ranking import ranks, unit_costs
from log_cells import RICH

import coop_pin as cp
from coop_pin.description.log_table import LogTable
from coop_pin.identification import Priors
from coop_pin.identification.filtering import filtered
from coop_pin.logs.topics import table_of
from coop_pin.model.cell_arm import CellArm
from coop_pin.viz.log_replay import logged_run

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
    drawn, start = logged_run(answer).data, filtered(answer.record, {}, 1.0)["left"].time[0]
    there = result.data.interp(time=drawn.time.values + start)
    for name, most in (("payload_position", 1e-3), ("internal_wrench", 0.05), ("torque", 0.2)):
        assert np.nanmax(np.abs(drawn[name].values - there[name].values)[50:]) < most, name
    points = {"motion": {"kind": "waypoints", "points": list(motion.points)}, "duration": 4.0}
    assert cp.run(result.scenario, points, warn=False).limit_violations() == ()


@pytest.mark.gate
def test_the_weight_of_a_hand_behind_a_wrist_is_taken_off():
    """A sensor that carries 1 kg, which the log states, is answered like one that carries nothing."""
    scenario = cp.Scenario.load("two-pandas-box", {"duration": 3.0, "sensors": {"wrist": {}}})
    record = cp.logs.Record.of_run(cp.run(scenario, warn=False))
    left, arm = record.arms["left"], CellArm(scenario.cell, "left")
    at = [np.interp(left.wrench_time, left.time, column) for column in left.position.T]
    R = np.array([arm.tip_pose(arm.configuration(q))[:3, :3] for q in np.transpose(at)])
    weight = np.hstack((-9.81 * R[:, 2], np.cross((0.0, 0.0, 0.05), -9.81 * R[:, 2])))
    heavy = dataclasses.replace(left, wrench=left.wrench + weight)
    loaded = dataclasses.replace(record, arms=record.arms | {"left": heavy})
    arms = {name: {"joints": f"/{name}/joint_states"} for name in ("left", "right")}
    arms["left"] |= {"hand_mass": 1.0, "hand_centre": (0.0, 0.0, 0.05)}
    table = LogTable(arms=arms)
    answers = cp.blame(record, scenario), cp.blame(loaded, scenario.replace(log=table))
    forces = [logged_run(answer).data.internal_wrench.values for answer in answers]
    assert np.nanmax(np.abs(forces[0] - forces[1])) < 0.01  # of 4.9 N; angles are interpolated


@pytest.mark.slow
def test_a_replay_of_a_log_has_the_pads_of_its_cell():
    quiet = {"duration": 2.0, "events": (), "sensors": {"wrist": {}}}
    answer = cp.blame(cp.run("two-pandas-palms", quiet, warn=False))
    assert logged_run(answer).data.sizes["patch"] == 2


@pytest.mark.parametrize("share", [0.47, pytest.param(0.51, marks=pytest.mark.slow)])
def test_shares_of_the_law_that_are_not_those_of_the_cell_are_told(share):
    """Closed form: the internal force by the cell's shares is the difference times the whole force."""
    scenario = cp.Scenario.load("two-pandas-box", {"duration": 4.0, "sensors": {"wrist": {}}})
    result = cp.run(scenario, {"cell.load_shares": {"left": share, "right": 1.0 - share}}, warn=False)
    answer = cp.blame(cp.logs.Record.of_run(result), scenario, priors=PRIORS)
    expected = abs(share - 0.5) * scenario.cell.payload.mass * np.linalg.norm(scenario.cell.gravity)
    assert answer.causes[0] is answer.share
    assert abs(answer.share.newtons - expected) < 0.05 * expected


@pytest.mark.gate
def test_known_shares_of_the_law_are_no_cause_and_found_ones_are_those_of_the_corrected_cell():
    scenario = cp.Scenario.load("two-pandas-box", {"duration": 4.0, "sensors": {"wrist": {}}})
    scenario = scenario.replace(log=table_of(scenario))
    shares = {"left": 0.47, "right": 0.53}
    record = cp.logs.Record.of_run(cp.run(scenario, {"cell.load_shares": shares}, warn=False))
    answer = cp.blame(record, scenario, priors=PRIORS)
    assert np.abs(np.array(answer.share.sizes) - (0.47, 0.53)).max() < 0.0015
    for cell in (answer.with_errors(), scenario.override({"log.shares": shares})):
        other = cp.blame(record, cell, priors=PRIORS)
        assert other.share not in other.causes
        assert np.abs(np.array(other.share.sizes) - answer.share.sizes).max() < 1e-3


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
            draws = ranks(kind, part, 7000, costs, load)
            cache.set(key, [[bool(first), bool(both)] for first, both in draws])
        first, both = np.array(cache.get(key, None)).T
        assert len(first) == 20, part
        assert first.sum() >= 18, (part, first.sum())
        if part in ("tip", "base"):  # only the difference is seen
            assert both[first].all(), part


@pytest.mark.gate
def test_another_law_or_squeeze_is_told_by_what_its_causes_leave():
    """A wanted squeeze of 8 N less is 8 N of internal force that nothing explains, and no joint's."""
    scenario = cp.Scenario.load("adept-anchored", QUIET | {"sensors": {"wrist": {}}})
    result = cp.run(scenario, warn=False)
    squeeze = {"left": [-2.0, *[0.0] * 5], "right": [2.0, *[0.0] * 5]}
    answer = cp.blame(result, scenario.override({"squeeze": squeeze}), priors=PRIORS)
    assert abs(answer.unexplained - 8.0) < 0.8
    assert [one.place for one in answer.findings.of("warning")] == ["controller"]
    assert not any(one.members[0].part == "joint" and one.newtons > 0.02 for one in answer.causes)


@pytest.mark.slow
def test_the_printed_law_in_place_of_the_anchored_one_is_told():
    off = QUIET | {"cell.arms.left.calibration_error.tip.xyz": [1e-3, 0.0, 0.0]}
    scenario, printed = cp.Scenario.load("adept-anchored", off), cp.Scenario.load("adept-paper")
    record = cp.logs.Record.of_run(cp.run(scenario, warn=False))
    answer = cp.blame(record, scenario.replace(controller=printed.controller))
    assert "controller" in [one.place for one in answer.findings.of("warning")]
    assert answer.unexplained > 5.0 * answer.read
    assert cp.blame(record, scenario).unexplained < 0.1 * answer.read


@pytest.mark.slow
def test_five_logs_have_their_cause_first_and_their_force_in_the_corrected_cell(tmp_path):
    """By runs: 0.1 N or the interval; of shares the internal force by the law's own ones has nothing."""
    blame_logs.main(tmp_path, 620)
    quiet = {f"arm_sensors.{name}.wrist.noise": {} for name in ("left", "right")}
    believed = blame_logs.believed()

    def force(scenario):
        data = cp.run(scenario, warn=False).data
        return (data.internal_wrench - data.desired_internal_wrench).values[50:, :, :3]

    none = force(blame_logs.real(believed, ("clock", "right", 0, 0.0))[1].override(quiet))
    for number, culprit in enumerate(blame_logs.culprits(620), 1):
        answer = cp.blame(tmp_path / f"log_{number}.csv", tmp_path / "cell.toml")
        part, arm, _, value = culprit
        first = answer.causes[0]
        if part == "share":
            assert first is answer.share
            assert np.abs(np.array(first.sizes) - (0.5 + value, 0.5 - value)).max() < 0.002
            continue
        axis = blame_logs.named(culprit)["axis"]
        assert (arm, part, axis) in [(one.arm, one.part, one.axis) for one in first.members], first
        sizes = {(one.arm, one.axis): size for one, size in zip(first.members, first.sizes, strict=True)}
        assert abs(sizes[arm, axis] - value) < 0.04 * abs(value)
        made, corrected = (
            float(np.linalg.norm(force(cell.override(quiet)) - none, axis=2).max(axis=1).mean())
            for cell in (blame_logs.real(believed, culprit)[1], answer.with_errors())
        )
        assert abs(made - corrected) < max(0.1, (first.high - first.low) / 2.0), first


@pytest.mark.slow
def test_a_law_that_is_run_leaves_nothing_of_a_log_with_noise_alone():
    """Friction enters what wrists read once, by their readings."""
    noise = {"sensors.wrist": {"noise": {"force": 0.2, "moment": 0.01}}, "events": (), "duration": 4.0}
    scenario = cp.Scenario.load("adept-paper-fit", noise)
    assert cp.blame(cp.logs.Record.of_run(cp.run(scenario, warn=False)), scenario).unexplained < 0.3
