"""Tables of joint angles as motions: poses by each arm's kinematics, disagreement, files, engines, sweeps."""

import functools

import numpy as np
import pytest
from cells import planar_scenario, spatial_scenario

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, ArmsDisagreeError, FileReadError, ScenarioError
from coop_pin.base.spatial import pose_error
from coop_pin.description.scenario import Scenario
from coop_pin.grasps import CellChain
from coop_pin.running.plausibility import implausible_numbers

CELLS = {"planar": planar_scenario, "spatial": spatial_scenario}
TIMES = np.linspace(0.0, 0.2, 11)


@pytest.fixture(params=CELLS)
def scenario(request):
    """A cell whose payload moves by 3 cm and turns a little, in its task rows."""
    scenario = CELLS[request.param]().replace(duration=0.2, events=())
    start = scenario.start
    goal = start.replace(
        xyz=tuple(np.add(start.xyz, (0.03, 0.01, 0.0))), rpy=tuple(np.add(start.rpy, (0, 0, 0.05)))
    )
    return scenario.replace(motion=cp.motions.LineMotion(start=start, goal=goal, duration=0.2))


def angles(scenario):
    """Joint angles of every arm along the motion, by Pinocchio's inverse kinematics, (n, k) each."""
    return {name: rows.copy() for name, rows in _angles(scenario.to_toml()).items()}


@functools.cache
def _angles(text):
    scenario = Scenario.from_toml(text)
    chain = CellChain(scenario.cell)
    q = [chain.configuration(scenario.motion.at(time).X_WP_d) for time in TIMES]
    return {slot.name: np.array([row[slot.q_slice] for row in q]) for slot in chain.model.arms}


def table(folder, scenario, positions, names=None):
    joints = scenario.cell.arm_joints()
    columns = (
        ["time", *(f"{arm}/{joint}" for arm in positions for joint in joints[arm])]
        if names is None
        else names
    )
    path = folder / "joints.csv"
    rows = np.column_stack((TIMES, *positions.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")
    return cp.motions.JointMotion(path=str(path))


def test_rows_become_the_poses_that_the_joint_angles_hold(scenario, tmp_path):
    positions = angles(scenario)
    first, *_ = positions
    for arms in (positions, {first: positions[first]}, dict(reversed(positions.items()))):
        motion = table(tmp_path, scenario, arms).on(scenario.cell)
        for time in TIMES:
            error = pose_error(motion.at(time).X_WP_d, scenario.motion.at(time).X_WP_d)
            assert np.abs(error).max() < 1e-8
        assert motion.span == (0.0, 0.2)
        cp.motions.check_consistency(motion, TIMES[1:-1] + 1e-3)
        for time in (0.0, 0.2):
            assert not motion.at(time).V_WP_d.any()


def test_arms_that_disagree_are_refused_with_the_number_and_the_time(scenario, tmp_path):
    positions = angles(scenario)
    first, second = list(positions)[:2]
    positions[second][7, -1] += 0.01  # its last joint turns the payload
    motion = table(tmp_path, scenario, positions)
    with pytest.raises(ArmsDisagreeError) as caught:
        motion.on(scenario.cell)
    assert caught.value.arms == (first, second)
    assert caught.value.time == pytest.approx(TIMES[7])
    assert caught.value.angle == pytest.approx(0.01, rel=1e-5)
    assert caught.value.line == 9
    assert 0.0 < caught.value.distance < 0.01
    accepted = motion.replace(allowed=0.02).on(scenario.cell)
    R = accepted.at(TIMES[7]).X_WP_d, scenario.motion.at(TIMES[7]).X_WP_d
    share = 1.0 / len(positions)
    assert np.linalg.norm(pose_error(*R)[3:]) == pytest.approx(0.01 * share, rel=1e-4)  # of the mean


def test_columns_are_named_by_arm_and_joint(scenario, tmp_path):
    positions = angles(scenario)
    joints = scenario.cell.arm_joints()
    names = ["time", *(f"{arm}/{joint}" for arm in positions for joint in joints[arm])]
    for wrong in (names[1].replace("/", "-"), "left/jiont"):
        with pytest.raises(FileReadError) as caught:
            table(tmp_path, scenario, positions, [*names[:-1], wrong]).on(scenario.cell)
        assert caught.value.line == 1
        assert names[-1] in str(caught.value)
    with pytest.raises(ArgumentError, match=r"on\(cell\)"):
        table(tmp_path, scenario, positions).at(0.0)
    with pytest.raises(ScenarioError, match="joint angles"):
        cp.events.Partner(time=0.0, motion={"kind": "joints", "path": "a.csv"}, stiffness=[1.0] * 6)


def test_a_scenario_with_a_table_of_joints_is_as_any_other(scenario, tmp_path):
    """Saved and loaded beside its file; run by both engines; the result saved and loaded; swept."""
    table(tmp_path, scenario, angles(scenario))
    text = scenario.replace(motion=cp.motions.JointMotion(path="joints.csv")).to_toml()
    (tmp_path / "scenario.toml").write_text(text)
    loaded = Scenario.load(tmp_path / "scenario.toml")
    assert loaded.motion.path == str(tmp_path / "joints.csv")
    assert Scenario.from_toml(loaded.to_toml()) == loaded
    known, single, compiled = (
        cp.run(scenario, warn=False),
        cp.run(loaded, warn=False),
        cp.run(loaded, warn=False, engine="compiled"),
    )
    for result in (single, compiled):
        np.testing.assert_allclose(result.data.pose_error, known.data.pose_error, rtol=0, atol=1e-5)
    np.testing.assert_allclose(compiled.data.pose_error, single.data.pose_error, rtol=0, atol=1e-9)
    single.save(tmp_path / "run.nc")
    assert cp.RunResult.load(tmp_path / "run.nc").scenario == loaded
    here = cp.Execution(workers=0, quiet=True)
    swept = cp.sweep(loaded, {"cell.payload.mass": [1.0, 2.0]}, out=tmp_path / "sweep", execution=here)
    assert (swept.table["status"] == "ok").all()


def test_stamps_of_a_recording_are_a_finding(scenario, tmp_path):
    positions = angles(scenario)
    motion = table(tmp_path, scenario, positions)
    rows = np.loadtxt(motion.path, delimiter=",", skiprows=1)
    header = (tmp_path / "joints.csv").read_text().splitlines()[0]
    np.savetxt(
        motion.path,
        rows + 1.7e9 * (np.arange(rows.shape[1]) == 0),
        delimiter=",",
        header=header,
        comments="",
        fmt="%.17g",
    )
    findings = implausible_numbers(scenario.replace(motion=motion))
    (finding,) = [each for each in findings if each.kind == "motion"]
    assert "1970" in finding.sentence
