"""Findings of ``cp.check``: severities, remedies that work, and the part of them that a run lists."""

import json
import tracemalloc

import numpy as np
import pytest
from forecast_cells import carried, serial_arm
from test_plausibility import DEGREES, SOUND, cell_of
from tiers import by_default

import coop_pin as cp
from coop_pin.cli import main
from coop_pin.model import ArmModel
from coop_pin.results.finding import LEFT_TO_CHECK
from coop_pin.running.cell_findings import lost_arm_findings
from coop_pin.running.check import quick_findings
from coop_pin.running.plausibility import implausible_numbers
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

POSES = 21
SLOW = {"planar": 20.0, "spatial": 150.0}
"""Control rates at which the sampled loop is unstable, Hz."""


def doubtful(kind, trouble):
    """A sound cell with one fault, and the kind and severity of its finding."""
    scenario = cell_of(kind)
    friction = {name: {"viscous": 5e3} for name in scenario.cell.arms}
    changes, expected, severity = {
        "rate": ({"clock.rate_hz": SLOW[kind]}, "sampled damping", "error"),
        "steps": (
            {f"cell.arms.{name}.friction": value for name, value in friction.items()},
            "plant steps",
            "error",
        ),
        "mm": ({"cell.payload.size": [400.0, 300.0, 300.0]}, "unit", "warning"),
        "degrees": ({"cell.arms.right.base.rpy": [0.0, 0.0, 180.0]}, "unit", "warning"),
        "squeeze": ({"squeeze": {}}, "squeeze", "warning"),
        "record": ({"duration": {"planar": 36000.0, "spatial": 3600.0}[kind]}, "record size", "warning"),
    }[trouble]
    return scenario.override(changes), expected, severity


def spatial_cases():
    pandas = cell_of("spatial")
    yield pandas.override({"controller.posture.stiffness": 3.0}), "loop stability", "error"
    yield pandas.override({"cell.payload.mass": 60.0}), "static torque", "error"
    yield pandas.override({"cell.arms.left.posture": DEGREES}), "posture", "warning"
    palms = cp.Scenario.load("two-pandas-palms")
    yield palms.replace(squeeze=palms.squeeze.scaled(0.3)), "friction", "error"
    damping = {"controller.gains.admittance_damping": [50.0] * 3 + [1.0] * 3}
    yield cp.Scenario.load("two-ur5-admittance", damping), "admittance stability", "error"
    springs = cp.Scenario.load("adept-compliant").replace(events=())
    gain = 3.0 * np.array(springs.controller.gains.sliding_gain)
    yield springs.override({"controller.gains.sliding_gain": gain.tolist()}), "grasp stability", "error"


def quick(scenario):
    findings = quick_findings(Simulation(scenario, build_controller(scenario)))
    return [*implausible_numbers(scenario), *findings]


def assert_a_remedy_works(scenario, kind, severity):
    findings = cp.check(scenario, poses=POSES)
    finding = next(finding for finding in findings if finding.kind == kind)
    assert finding.severity == severity
    assert finding.remedy
    cured = cp.check(scenario.override(finding.remedy), poses=POSES)
    assert kind not in {finding.kind for finding in cured.of("error", "warning")}
    assert {finding.kind for finding in cured.of("error")} <= {
        finding.kind for finding in findings.of("error")
    }
    known = {(finding.kind, finding.severity) for finding in findings}
    doubts = {(entry.kind, entry.severity) for entry in quick(scenario) if entry.severity != "note"}
    assert doubts <= known
    assert (kind, severity) in doubts


TROUBLES = ("rate", "steps", "mm", "degrees", "squeeze", "record")


@pytest.mark.parametrize(
    ("trouble", "kind"),
    [
        *(("rate", "planar"), ("steps", "planar"), ("mm", "planar")),
        pytest.param("steps", "spatial", marks=pytest.mark.slow),
        *(pytest.param(each, "planar", marks=pytest.mark.slow) for each in TROUBLES[3:]),
        *(pytest.param(each, "spatial", marks=pytest.mark.slow) for each in TROUBLES if each != "steps"),
    ],
)
def test_a_remedy_cures_its_finding_and_brings_no_other_error(kind, trouble):
    """Field and value of each are executed; a run lists the same findings."""
    assert_a_remedy_works(*doubtful(kind, trouble))


def test_remedies_of_a_unit_a_squeeze_and_a_record_work_together():
    wrong = {"cell.arms.right.base.rpy": [0.0, 0.0, 180.0], "squeeze": {}, "duration": 36000.0}
    scenario = cell_of("planar").override(wrong)
    findings = [finding for finding in quick(scenario) if finding.severity == "warning"]
    assert {finding.kind for finding in findings} == {"unit", "squeeze", "record size"}
    for finding in findings:
        scenario = scenario.override(finding.remedy)
    assert {finding.severity for finding in quick(scenario)} == {"note"}


def test_what_is_known_before_a_long_run_takes_no_memory_of_its_record():
    scenario, *_ = doubtful("planar", "record")
    simulation = Simulation(scenario, build_controller(scenario))
    tracemalloc.start()
    quick_findings(simulation)
    cp.stability.eigenvalues(scenario)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 0.05 * simulation.recorder.memory


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.slow] * (case in (0, 1, 2, 3, 5))) for case in range(6)]
)
def test_a_remedy_of_spare_joints_loads_friction_and_servos_works(case):
    assert_a_remedy_works(*[*spatial_cases()][case])


@pytest.mark.slow
def test_a_wrist_beyond_its_limit_along_the_motion_is_cured_by_the_other_branch(tmp_path):
    """Two arms of three hinges turn a box by 1.2 rad; so do they with their elbows on the other side."""
    file, q, arms = serial_arm(tmp_path, np.random.default_rng(0), 3), np.array((-0.9, 1.3, -0.4)), {}
    for name, side in (("left", -1.0), ("right", 1.0)):
        base = cp.Pose(rpy=(0.0, 0.0, np.pi * (side > 0.0))).matrix
        tip = ArmModel(cp.Arm(urdf=file, tip="tip", posture=tuple(q))).tip_pose(q)[:3, 3]
        base[:3, 3] = np.array((0.05 * side, 0.0, 0.0)) - base[:3, :3] @ tip
        arms[name] = cp.Arm(urdf=file, tip="tip", base=cp.Pose.from_matrix(base), posture=tuple(-q))
    goal, box = cp.Pose(rpy=(0.0, 0.0, 0.3)), cp.Payload.box(2.0, (0.1, 0.1, 0.1))
    plane = {"rows": "planar", "gravity": (0.0, 0.0, 0.0)}
    squeeze = cp.squeezes.TipForceSqueeze(force=5.0)
    times = (0.5, 4.0, 0.5)
    draft = carried("wrist", arms, box, "as-posed", cp.Pose(), goal, times=times, cell=plane, squeeze=squeeze)
    scenario = cp.suggest(draft, poses=5).scenario
    elbows = {f"cell.arms.{name}.posture": (-q).tolist() for name in arms}
    beyond = scenario.override({"motion.goal.rpy": (0.0, 0.0, 1.2), **elbows})
    findings = cp.check(beyond, poses=POSES)
    remedies = [finding.remedy for finding in findings.of("error") if finding.kind == "reach"]
    assert remedies
    for remedy in remedies:
        assert cp.check(beyond.override(remedy), poses=POSES).ok


@pytest.mark.parametrize("kind", by_default(SOUND, "planar"))
def test_a_sound_cell_has_margins_only(kind):
    findings = cp.check(cell_of(kind), poses=POSES)
    assert findings.ok
    assert {finding.severity for finding in findings} == {"note"}
    assert {"reach", "static torque", "plant steps", "closed loop"} <= {finding.kind for finding in findings}
    assert findings.left == ()


def test_findings_come_by_severity_and_as_json(tmp_path, capsys):
    scenario = cell_of("spatial").override({"cell.payload.mass": 60.0, "squeeze": {}})
    scenario.save(tmp_path / "heavy.toml")
    assert main(["check", str(tmp_path / "heavy.toml"), "--poses", "5", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    ranks = [("error", "warning", "note").index(entry["severity"]) for entry in document["findings"]]
    assert ranks == sorted(ranks)
    assert not document["ok"]
    torque = next(entry for entry in document["findings"] if entry["kind"] == "static torque")
    assert torque["place"] == "right/panda_joint6"
    assert torque["value"] > torque["limit"] == 12.0
    assert torque["remedy"]["cell.payload.mass"] < 60.0


def test_a_law_that_only_differences_know_is_named_before_it_loses_the_payload():
    """An admittance in which one arm leads: 81 mm off within six seconds."""
    scenario = cp.Scenario.load("two-ur5-admittance", {"controller.follows": "leader"})
    simulation = Simulation(scenario, build_controller(scenario))
    start = simulation.state()
    findings = quick_findings(simulation)
    (loop,) = findings.of("error")
    assert loop.kind == "closed loop"
    assert loop.value > 1.0
    assert "closed loop" not in findings.left
    assert set(findings.left) == {*LEFT_TO_CHECK} - {"closed loop"}
    np.testing.assert_array_equal(simulation.plant.q, start.plant.q)
    with pytest.warns(cp.errors.ScenarioWarning, match="grows"):
        cp.run(scenario.replace(duration=0.05))


def test_an_arm_that_the_plan_loses_is_an_error_where_the_others_cannot_carry():
    pandas = cell_of("spatial")
    limp, braked = (
        pandas.replace(events=(cp.events.LoseArm(arm="left", time=1.0, form=form),))
        for form in ("limp", "braked")
    )
    drives = pandas.actuators.replace(torque_lost_at=1.0)
    by_drives = pandas.replace(arm_actuators={"left": drives})
    reach = cp.feasibility.reachability(pandas, poses=POSES)
    listed = [finding for finding in cp.check(limp, poses=POSES) if finding.kind == "lost arm"]
    assert sorted(map(str, listed)) == sorted(map(str, lost_arm_findings(limp, reach)))
    for scenario, severity in ((pandas, "note"), (limp, "error"), (by_drives, "error"), (braked, "note")):
        lost = [*lost_arm_findings(scenario, reach)]
        assert {finding.severity for finding in lost if finding.place == "left"} == {severity}
        assert {finding.severity for finding in lost if finding.place == "right"} == {"note"}


@pytest.mark.slow
def test_what_is_suggested_passes_its_check():
    suggestion = cp.suggest(cell_of("spatial"), poses=11)
    assert len(suggestion.findings().of("error", "warning")) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", cp.scenario_names())
def test_the_catalogue_has_no_errors(name):
    findings = cp.check(name)
    assert findings.ok
    assert {finding.kind for finding in findings.of("warning")} <= {"grasp frame"}


@pytest.mark.slow
def test_a_drive_that_the_motion_overloads_later_is_named_by_a_run():
    """At the start every drive of this Baxter holds; two seconds later a wrist is at its limit."""
    scenario = cp.Scenario.load("baxter-box", {"cell.payload.mass": 4.73, "events": [], "duration": 6.0})
    (torque, *_) = [finding for finding in quick(scenario) if finding.severity == "error"]
    assert (torque.kind, torque.place) == ("static torque", "right/right_w0")
    assert torque.value > torque.limit
    checked = cp.check(scenario, poses=POSES).of("error")
    (remedy,) = {tuple(finding.remedy.items()) for finding in checked if finding.kind == torque.kind}
    assert cp.check(scenario.override(dict(remedy)), poses=POSES).ok


@pytest.mark.gate
@pytest.mark.parametrize("kind", by_default(SOUND, "planar", others=pytest.mark.slow))
def test_a_start_out_of_reach_is_a_finding_not_an_exception(kind):
    """A payload five metres away: what can be known is listed, and what cannot is named."""
    scenario = cell_of(kind)
    x, y, z = scenario.start.xyz
    start = scenario.start.replace(xyz=(x, y + 5.0, z))
    far = scenario.replace(start=start, motion=cp.motions.HoldMotion(pose=start), events=())
    findings = cp.check(far, poses=5)
    assert {finding.kind for finding in findings.of("error")} == {"reach"}
    assert {finding.place for finding in findings.of("error")} == {*far.cell.arms}
    assert findings.left == LEFT_TO_CHECK
