"""What makes no sense is refused by name: commands, networks, grasps, exports, places of bases."""

import numpy as np
import pytest
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.base.arrays import as_array, as_count
from coop_pin.base.errors import (
    ArgumentError,
    DivergedError,
    FieldError,
    FileWriteError,
    InvalidStateError,
    NotEnoughMemoryError,
    OutOfRangeError,
    ShapeError,
    WrongTypeError,
)
from coop_pin.cli import main
from coop_pin.simulation.build_controller import build_controller


@pytest.fixture(params=SCENARIOS)
def run(request):
    scenario = SCENARIOS[request.param]().replace(events=(), duration=0.1)
    return cp.Simulation(scenario, build_controller(scenario))


def test_no_array_takes_texts_complex_or_masked_entries():
    masked = np.ma.masked_array([1.0, 2.0], mask=[False, True])
    truths = [True, False]
    for value in (["1", "2"], [1j, 2.0], np.array([1j, 2.0]), masked, np.array([{}, {}]), truths):
        with pytest.raises(ArgumentError):
            as_array("values", value, 2)
    for value in ("1", 1j, {}, True):
        with pytest.raises(ArgumentError) as caught:
            as_array("value", value)
        assert not isinstance(caught.value, ShapeError)
    unmasked = np.ma.masked_array([1.0, 2.0], mask=False)
    for value in ([1, 2.0], np.float32([1.0, 2.0]), np.array([1, 2], object), unmasked):
        assert as_array("values", value, 2).tolist() == [1.0, 2.0]
    with pytest.raises(WrongTypeError):
        as_count("count", True)


def test_before_a_tick_there_is_no_result(run):
    for function in (run.result, run.snapshot):
        with pytest.raises(InvalidStateError):
            function()
    run.tick()
    assert run.result().end == run.snapshot().time == 0.0


def test_commands_that_make_no_sense_are_refused_and_move_nothing(run):
    run.observe()
    drives, before = [len(slot.drive) for slot in run.slots], run.plant.q.copy()
    none = [np.zeros(size) for size in drives]
    names = [slot.name for slot in run.slots]
    for kind, wrong in (
        (ArgumentError, cp.CellCommand(torques=none, velocities=none)),
        (ArgumentError, cp.CellCommand(torques=none, positions=none)),
        (ArgumentError, cp.CellCommand(velocities=none)),
        (ArgumentError, cp.CellCommand()),
        (ArgumentError, cp.CellCommand(torques=[np.ma.masked_array(each, mask=True) for each in none])),
        (ArgumentError, cp.CellCommand(torques=[each + 1j for each in none])),
        (ArgumentError, cp.CellCommand(torques=[["1"] * size for size in drives])),
        (WrongTypeError, cp.CellCommand(torques=dict(zip(names, none, strict=True)))),
        (WrongTypeError, cp.CellCommand(torques=iter(none))),
        (WrongTypeError, cp.CellCommand(torques=3)),
        (ShapeError, cp.CellCommand(torques=none, velocities=none[:1])),
    ):
        with pytest.raises(kind):
            run.step(wrong)
        assert (run.ticks_done, run.plant.q.tolist()) == (0, before.tolist())
    run.step(cp.CellCommand(torques=none, velocities=[None] * len(none)))
    assert run.ticks_done == 1


@pytest.mark.parametrize(
    ("path", "changes"),
    [
        ("network.graph", {"graph": [["left", "left"], ["left", "right"]]}),
        ("network.graph", {"graph": [["left", "right"]] * 100_000}),
        ("network.links", {"links": [{"sender": "left", "receiver": "right", "delay": k} for k in (1, 2)]}),
        ("network.changes", {"changes": [{"time": 0.1, "graph": graph} for graph in ("ring", "star")]}),
        ("network.changes.0.graph", {"changes": [{"time": 0.1, "graph": [["left", "left"]]}]}),
    ],
)
def test_networks_that_contradict_themselves_are_refused(path, changes):
    with pytest.raises(FieldError) as caught:
        cp.Scenario.load("adept-anchored").replace(events=()).override({"network": changes})
    assert caught.value.path == path


GRASPS = [
    cp.events.HandOver(time=0.2, arm="third", duration=0.2, retreat=0.02, retreat_time=0.4),
    cp.events.Regrasp(time=2.0, arm="third", approach_time=0.5, wait=0.5, duration=0.2),
]


def test_an_approach_begins_after_the_retreat():
    """The retreat ends at 0.8 s: an approach of 0.5 s and a wait of 0.5 s put the grasp at 1.8 s or later."""
    scenario = cp.Scenario.load("three-ur5-handover").replace(events=())
    for time in (1.8, 2.0):
        scenario.replace(events=(GRASPS[0], GRASPS[1].replace(time=time)))
    with pytest.raises(FieldError) as caught:
        scenario.replace(events=(GRASPS[0], GRASPS[1].replace(time=1.79)))
    assert caught.value.path == "events.1.time"


def test_an_arm_that_has_failed_takes_no_hold():
    scenario = cp.Scenario.load("three-ur5-handover").replace(events=())
    lost = cp.events.LoseArm(time=1.5, arm="third")
    with pytest.raises(FieldError) as caught:
        scenario.replace(events=(GRASPS[0], lost, GRASPS[1]))
    assert caught.value.path == "events.2.arm"
    scenario.replace(events=(GRASPS[0], GRASPS[1], lost.replace(time=2.5)))


def test_exports_say_what_they_cannot_do(tmp_path):
    scenario = cp.Scenario.load("adept-anchored").replace(events=(), duration=0.5)
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(FileWriteError):
            cp.export.export_c(scenario, "left", folder)
    with pytest.raises(ArgumentError):
        cp.export.export_c(scenario, "left", "a\0b")
    for ticks in (42, 10**9):
        with pytest.raises(OutOfRangeError):
            cp.export.export_c(scenario, "left", tmp_path, ticks=ticks)
    cp.export.export_c(scenario, "left", tmp_path, ticks=41)  # 0.5 s at 80 Hz, both ends included


def test_bases_and_plans_that_make_no_sense_are_refused():
    with pytest.raises(OutOfRangeError):
        cp.new_cell(["ur5", "ur5"], distance=1e-9)
    scenario = cp.Scenario.load("adept-anchored")
    start = scenario.motion.at(0.0).X_WP_d
    with pytest.raises(WrongTypeError):
        cp.carry.plan_carry(scenario.cell, start, start, squeeze="x")
    with pytest.raises(NotEnoughMemoryError):
        cp.carry.plan_carry(scenario.cell, start, start, places=10**9)


def test_laws_of_arms_are_a_mapping_of_their_names():
    laws = build_controller(cp.Scenario.load("adept-anchored")).controllers
    assert cp.laws.DecentralisedController(laws).controllers == laws
    for wrong in ([*laws.values()], None, dict.fromkeys(laws, 1), dict.fromkeys(laws, type(laws["left"]))):
        with pytest.raises(WrongTypeError):
            cp.laws.DecentralisedController(wrong)


def test_a_new_cell_says_what_it_is_at():
    stages = []
    cp.new_cell(["adept_3dof"] * 2, payload="bar", size=(0.24, 0.03, 0.03), progress=stages.append)
    assert len(stages) == 2
    assert all("2 arms" in stage for stage in stages)


def test_a_spring_too_stiff_for_the_steps_diverges_at_a_time():
    scenario = cp.Scenario.load("adept-compliant").replace(events=(), duration=0.2)
    hold = {"kind": "hold", "pose": {}}
    for stiffness in (1e9, 1e12):
        partner = {"kind": "partner", "time": 0.1, "duration": 0.1, "stiffness": [stiffness] * 6}
        with pytest.raises(DivergedError) as caught:
            cp.run(scenario.override({"events": [partner | {"motion": hold}]}), warn=False)
        assert 0.1 <= caught.value.time <= 0.2
        assert caught.value.result.end <= caught.value.time


@pytest.mark.parametrize("command", ["check", "suggest", "export", "run"])
def test_a_motion_of_the_user_that_fails_is_one_line_in_every_command(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    module = f"failing_{command}"
    (tmp_path / f"{module}.py").write_text("def motion(t):\n    return 1 / (t - t)\n")
    scenario = cp.Scenario.load("adept-anchored").replace(events=(), duration=0.5)
    motion = f'[motion]\nkind = "function"\ntarget = "{module}:motion"\n'
    scenario.save(tmp_path / "cell.toml")
    before, after = (tmp_path / "cell.toml").read_text().split("[motion]\n")
    rest = after[after.find("\n[") :] if "\n[" in after else ""
    (tmp_path / "cell.toml").write_text(before + motion + rest)
    more = ["--to", "c", "--arm", "left"] if command == "export" else []
    assert main([command, "cell.toml", *more]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert f"motion failed at {module}.py:2: ZeroDivisionError" in lines[-1]
    assert not any("Traceback" in line for line in lines)


def test_fields_of_another_class_in_a_state_are_refused_by_name(run):
    run.tick()
    state = run.state()
    for field in set(state._fields) - {"controller_state", "law_memory", "network", "inputs", "applied"}:
        with pytest.raises((ArgumentError, WrongTypeError), match=r"state\b"):
            run.restore(state._replace(**{field: object()}))
    for changes in ({"ticks_done": -5}, {"sensing": None}):
        with pytest.raises((ArgumentError, WrongTypeError), match=r"state\b"):
            run.restore(state._replace(**changes))
    run.restore(state)


@pytest.mark.parametrize("folders", [5, "abc", [3], None, cp.Pose()])
def test_package_folders_that_are_none_are_refused(folders):
    with pytest.raises(WrongTypeError, match="package_dirs"):
        cp.urdf.find_urdf("panda", package_dirs=folders)
