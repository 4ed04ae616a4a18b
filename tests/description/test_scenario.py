"""Scenarios: typed errors with numbers, all mistakes at once; files, pickles and overrides; divergence."""

import pickle
import tomllib
from pathlib import Path

import numpy as np
import pytest
from cells import ANCHORED, SCENARIOS, planar_scenario, spatial_scenario

import coop_pin as cp
from coop_pin.base import errors
from coop_pin.base.schema.changes import differences
from coop_pin.description import scenario as scenario_module
from coop_pin.description.network import Network
from coop_pin.description.scenario_file import toml_text

INSIST = {"beyond_bound": True}


def paper_data():
    return tomllib.loads(
        (Path(scenario_module.__file__).parent / "scenarios" / "adept-paper.toml").read_text()
    )


def with_fields(changes):
    """The paper's file with entries replaced, as a user would have written it."""
    data = paper_data()
    for path, value in changes.items():
        *parents, last = path.split(".")
        node = data
        for key in parents:
            node = node[int(key)] if isinstance(node, list) else node.setdefault(key, {})
        node[int(last) if isinstance(node, list) else last] = value
    return data


def read(changes):
    return cp.Scenario(**with_fields(changes))


LATE = {"controller.force_path": {"kind": "late"}}
LOW_PASS = {"controller.force_path": {"kind": "low-pass", "pole": 0.5}}  # bound 3
ARM_GAINS = {"pose_gain": 2.0, "sign_gain": 0.2, "damping_gain": [60.0, 60.0, 10.0], "transient_rate": 5.0}

MISTAKES = {
    "unknown field": (
        {"cell.payload.masss": 1.0},
        errors.UnknownFieldError,
        "cell.payload.masss",
        "did you mean 'mass'",
    ),
    "unknown field in a union": (
        {"controller.gains.sign_gian": 1.0},
        errors.UnknownFieldError,
        "controller.gains.sign_gian",
        "'sign_gain'",
    ),
    "pose of three rows": (
        {"cell.arms.left.base": np.eye(3).tolist()},
        errors.FieldError,
        "cell.arms.left.base",
        "shape (3, 3)",
    ),
    "pose in words": (
        {"cell.arms.left.base": "0 0 0"},
        errors.FieldError,
        "cell.arms.left.base",
        "a position of 3 numbers",
    ),
    "number for a vector": (
        {"cell.gravity": 9.81},
        errors.FieldError,
        "cell.gravity",
        "is 9.81; it must be a list",
    ),
    "text for a duration": (
        {"duration": "long"},
        errors.FieldError,
        "duration",
        "is 'long'; it must be a number",
    ),
    "gains of another law": (
        {"controller": {"kind": "payload-space"}},
        errors.FieldError,
        "controller.gains",
        "a table of pose_gain, sign_gain, transient_rate, sliding_gain",
    ),
    "NaN gain": (
        {"controller.gains.sign_gain": np.nan},
        errors.FieldError,
        "controller.gains.sign_gain",
        "nan",
    ),
    "NaN in a row": (
        {"controller.gains.damping_gain": [1, np.nan, 1]},
        errors.FieldError,
        "controller.gains.damping_gain.1",
        "nan",
    ),
    "infinite posture": (
        {"cell.arms.left.posture": [0, np.inf, 0]},
        errors.FieldError,
        "cell.arms.left.posture.1",
        "inf",
    ),
    "vector too short": (
        {"cell.payload.inertia": [1.0, 2.0]},
        errors.FieldError,
        "cell.payload.inertia",
        "must have 6",
    ),
    "vector too long": ({"cell.gravity": [0, 0, 0, 0]}, errors.FieldError, "cell.gravity", "4 entries"),
    "ragged matrix": (
        {"controller.gains.damping_gain": [[1.0, 0.0], [1.0]]},
        errors.FieldError,
        "controller.gains.damping_gain",
        "[2, 1]",
    ),
    "empty row": (
        {"controller.gains.damping_gain": []},
        errors.FieldError,
        "controller.gains.damping_gain",
        "no entries",
    ),
    "drive not square": (
        {"cell.arms.left.drive": [[1.0, 0.0]]},
        errors.FieldError,
        "cell.arms.left.drive",
        "[2]",
    ),
    "text for a number": (
        {"controller.gains.pose_gain": "two"},
        errors.FieldError,
        "controller.gains.pose_gain",
        "'two'",
    ),
    "indefinite gain": (
        {"controller.gains.pose_gain": [[1, 2], [2, 1]]},
        errors.FieldError,
        "controller.gains.pose_gain",
        "eigenvalue -1",
    ),
    "missing field": (
        {"clock": {"rate_hz": 80.0}, "start": {}, "motion": {"kind": "hold"}},
        errors.FieldError,
        "motion.pose",
        "given",
    ),
    "unknown kind": ({"motion.kind": "spline"}, errors.FieldError, "motion.kind", "'exponentials'"),
    "kind missing": (
        {"controller.switching": {"width": 1.0}},
        errors.FieldError,
        "controller.switching.kind",
        "given",
    ),
    "shares": (
        {"cell.load_shares": {"left": 0.5, "right": 0.6}},
        errors.FieldError,
        "cell.load_shares",
        "1.1",
    ),
    "share of a stranger": (
        {"cell.load_shares": {"left": 0.5, "rihgt": 0.5}},
        errors.FieldError,
        "cell.load_shares",
        "'right'",
    ),
    "grasp missing": (
        {"cell.grasps": {"left": {}}},
        errors.FieldError,
        "cell.grasps",
        "no entry for 'right'",
    ),
    "squeeze does not cancel": (
        {"squeeze.left": [-9.0, 0, 0, 0, 0, 0]},
        errors.FieldError,
        "squeeze",
        "[1.0, 0.0",
    ),
    "event after the end": ({"events.0.time": 30.0}, errors.FieldError, "events.0.time", "20 s"),
    "push beyond the end": ({"events.1.time": 19.9}, errors.FieldError, "events.1.time", "20.1"),
    "alpha not diagonal": (
        {"controller.gains.sign_gain": [[1, 0.1], [0, 1]]},
        errors.FieldError,
        "controller.gains.sign_gain",
        "0.1",
    ),
    "alpha negative": (
        {"controller.gains.sign_gain": -0.2},
        errors.FieldError,
        "controller.gains.sign_gain",
        "-0.2",
    ),
    "unequal gamma": (
        {"controller.arm_gains.left": ARM_GAINS | {"pose_gain": 3.0}},
        errors.FieldError,
        "controller.arm_gains.*.pose_gain",
        "'left': 3.0, 'right': 2.0",
    ),
    "unequal K_f": (
        LATE | {"controller.arm_gains.left": ARM_GAINS | {"force_gain": 0.5}},
        errors.FieldError,
        "controller.arm_gains.*.force_gain",
        "'left': 0.5, 'right': 0.0",
    ),
    "K_f without a force": (
        {"controller.gains.force_gain": 0.5},
        errors.FieldError,
        "controller.gains.force_gain",
        "0.5",
    ),
    "K_f at its bound, late": (
        LATE | {"controller.gains.force_gain": 1.0},
        errors.FieldError,
        "controller.gains.force_gain",
        "1",
    ),
    "K_f over its bound, late": (
        LATE | {"controller.gains.force_gain": 1.1},
        errors.FieldError,
        "controller.gains.force_gain",
        "1.1",
    ),
    "K_f at its bound, low-pass": (
        LOW_PASS | {"controller.gains.force_gain": 3.0},
        errors.FieldError,
        "controller.gains.force_gain",
        "3",
    ),
    "gains of a stranger": (
        {"controller.arm_gains.lefft": ARM_GAINS},
        errors.FieldError,
        "controller.arm_gains.lefft",
        "'left'",
    ),
}


@pytest.mark.parametrize(("changes", "kind", "path", "said"), MISTAKES.values(), ids=MISTAKES)
def test_every_mistake_has_its_type_its_path_and_its_numbers(changes, kind, path, said):
    with pytest.raises(errors.ScenarioError) as caught:
        read(changes)
    assert type(caught.value) is kind
    assert caught.value.path == path
    assert said in caught.value.detail
    assert str(caught.value).startswith(f"{path}: ")
    assert caught.value.problems == (caught.value,)


@pytest.mark.parametrize(
    "changes",
    [
        LATE | {"controller.gains.force_gain": 0.999},
        LOW_PASS | {"controller.gains.force_gain": 2.999},
        INSIST | LATE | {"controller.gains.force_gain": 1.1},
        INSIST | {"controller.arm_gains.left": ARM_GAINS | {"pose_gain": 3.0}},
    ],
)
def test_below_the_bound_or_insisting_is_accepted(changes):
    assert read(changes).beyond_bound == ("beyond_bound" in changes)


def test_insisting_does_not_excuse_what_is_wrong_anyway():
    with pytest.raises(errors.FieldError):
        read(INSIST | {"cell.load_shares": {"left": 0.5, "right": 0.6}})


def test_all_mistakes_are_reported_at_once_whatever_their_level():
    changes = {
        "clock.rate_hz": -1.0,
        "controller.gains.sign_gain": np.nan,
        "cell.payload.masss": 1.0,
        "cell.load_shares": {"left": 0.5, "right": 0.6},
        "cell.arms.left.friction.viscous": -1.0,
        "motion.kind": "spline",
        "events.0.time": 30.0,
        "squeeze.left": [-9.0, 0, 0, 0, 0, 0],
        "stert": {},
    }
    with pytest.raises(errors.ScenarioError) as caught:
        read(changes)
    found = {problem.path: type(problem) for problem in caught.value.problems}
    assert found == {
        "clock.rate_hz": errors.FieldError,
        "controller.gains.sign_gain": errors.FieldError,
        "cell.payload.masss": errors.UnknownFieldError,
        "cell.load_shares": errors.FieldError,
        "cell.arms.left.friction.viscous": errors.FieldError,
        "motion.kind": errors.FieldError,
        "events.0.time": errors.FieldError,
        "squeeze": errors.FieldError,
        "stert": errors.UnknownFieldError,
    }
    for path in found:
        assert path in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "kind", "numbers"),
    [
        ({"cell.arms.left.tip": "tipp"}, errors.NameNotFoundError, {"name": "tipp"}),
        ({"cell.arms.left.urdf": "nowhere.urdf"}, errors.UrdfError, {}),
        ({"cell.arms.left.posture": (1.0, 2.0)}, errors.FieldError, {"path": "cell.arms.left"}),
        (
            {"controller.gains.damping_gain": (60.0, 60.0)},
            errors.FieldError,
            {"path": "controller.gains.damping_gain"},
        ),
        (
            {"cell.arms.left.drive": ((1.0, 0.0), (0.0, 1.0)), "cell.arms.left.friction.viscous": 1.0},
            errors.FieldError,
            {},
        ),
        ({"start.xyz": (3.0, 0.0, 0.0)}, errors.UnreachablePoseError, {"arm": "left"}),
        (
            {"controller": {"kind": "user", "target": "nowhere:Law"}},
            errors.NameNotFoundError,
            {"kind": "module", "name": "nowhere"},
        ),
        (
            {"controller": {"kind": "user", "target": "cells:Law"}},
            errors.NameNotFoundError,
            {"kind": "class", "name": "Law"},
        ),
        (
            {"controller": {"kind": "user", "target": "math.sin"}},
            errors.FieldError,
            {"path": "controller.target"},
        ),
    ],
)
def test_what_only_the_robots_know_is_refused_before_the_first_tick(changes, kind, numbers):
    with pytest.raises(errors.CoopPinError) as caught:
        cp.run("adept-paper", changes)
    assert type(caught.value) is kind
    assert {name: getattr(caught.value, name) for name in numbers} == numbers
    assert caught.value.result is None


def test_an_unreachable_start_says_how_far_it_is():
    with pytest.raises(errors.UnreachablePoseError) as caught:
        cp.run("adept-paper", {"start.xyz": (3.0, 0.0, 0.0)})
    assert 1.0 < caught.value.distance < 4.0


def test_a_singular_arm_is_named_with_condition_and_time():
    # The left arm starts stretched to its full 0.8 m, towards its upper right.
    start = {"xyz": (0.8 * np.sqrt(0.5) + 0.12, 0.8 * np.sqrt(0.5), 0.0)}
    changes = {
        "motion": {"kind": "hold", "pose": start},
        "start": start,
        "cell.arms.left.posture": (np.pi / 4, 1e-6, -np.pi / 4),
    }
    with pytest.raises(errors.SingularJacobianError) as caught:
        cp.run("adept-paper", changes)
    error = caught.value
    assert (error.arm, error.time) == ("left", 0.0)
    assert error.condition > error.limit > 1e3
    assert error.result is None  # nothing was recorded yet


# ---------------------------------------------------------------- divergence


def test_force_feedback_over_its_bound_diverges_with_the_time_and_keeps_the_result():
    changes = LATE | INSIST | {"controller.gains.force_gain": 1.1, "duration": 5.0, "events": []}
    with pytest.raises(errors.DivergedError) as caught:
        cp.run("adept-paper", changes)
    error = caught.value
    assert error.value > error.limit
    assert 0.0 < error.time < 5.0
    assert error.result.end == pytest.approx(error.time, abs=1e-9)
    assert error.result.data.sizes["time"] == round(error.time * 80) + 1


def test_a_run_that_overflows_is_refused_with_its_time_and_not_warned_of():
    # Both arms are pulled beyond their reach within a second.
    away = {
        "kind": "exponentials",
        "constant": [0.5, 1.2, 0.0],
        "amplitudes": [[0.1, -1.054, 0.0]],
        "time_constants": [1.0],
    }
    with pytest.raises(errors.DivergedError) as caught:
        cp.run("adept-paper", {"motion": away | {"rpy": [0.0, 0.0, 1.2]}, "events": [], "duration": 8.0})
    assert np.isfinite(caught.value.result.data["velocity"]).all()


def test_force_feedback_under_its_bound_does_not_diverge():
    changes = LATE | {"controller.gains.force_gain": 0.9, "duration": 5.0, "events": []}
    assert cp.run("adept-paper", changes).end == 5.0


def test_an_interrupt_hands_over_what_there_is():
    def stop_after(tick, _ticks):
        if tick == 40:
            raise KeyboardInterrupt

    with pytest.raises(errors.RunInterruptedError) as caught:
        cp.run("adept-paper", progress=stop_after)
    assert caught.value.time == caught.value.result.end == pytest.approx(0.5)
    whole = cp.run("adept-paper", {"duration": 0.5, "events": []})
    np.testing.assert_array_equal(caught.value.result.data["velocity"], whole.data["velocity"])


def test_an_interrupt_is_not_swallowed_by_except_exception():
    assert not issubclass(errors.RunInterruptedError, Exception)
    assert issubclass(errors.RunInterruptedError, KeyboardInterrupt)


# ---------------------------------------------------------------- overrides


def test_an_override_changes_that_field_and_no_other():
    scenario = planar_scenario()
    changed = scenario.override({"controller.gains.sign_gain": 0.5})
    assert changed.controller.gains.sign_gain == 0.5
    assert changed.override({"controller.gains.sign_gain": scenario.controller.gains.sign_gain}) == scenario


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("name", "mine"),
        ("cell.arms.left.posture", (1.0, 2.0, 3.0)),
        ("cell.arms.right.friction.viscous", (1.0, 2.0, 3.0)),
        ("cell.payload.mass", 3.0),
        ("controller.gains.damping_gain", ((9.0, 0.0, 0.0), (0.0, 8.0, 0.0), (0.0, 0.0, 7.0))),
        ("events.1.time", 5.0),
        ("events.1.wrench", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        ("motion.amplitudes.0", (1.0, 2.0, 3.0)),
        ("plant.payload", "free"),
        ("plant.stabilisation.frequency", 20.0),
        ("clock.steps_per_tick", 3),
    ],
)
def test_any_field_can_be_overridden(path, value):
    node = planar_scenario().override({path: value})
    for key in path.split("."):
        node = (
            node[int(key)]
            if isinstance(node, tuple)
            else node[key]
            if isinstance(node, dict)
            else getattr(node, key)
        )
    assert node == value


def test_a_changed_kind_starts_from_its_own_defaults_in_any_order_of_changes():
    scenario = planar_scenario()
    one = scenario.override({"controller.switching.width": 0.2, "controller.switching.kind": "tanh"})
    assert one.controller.switching == cp.laws.Tanh(width=0.2)
    assert one.override({"controller.switching.kind": "sign"}) == scenario
    hold = scenario.override({"motion.kind": "hold", "motion.pose.xyz": (0.6, 0.1, 0.0)})
    assert hold.motion.pose.xyz == (0.6, 0.1, 0.0)


def test_events_can_be_added_and_emptied():
    scenario = planar_scenario()
    added = scenario.override(
        {"events.2.kind": "payload-change", "events.2.time": 15.0, "events.2.mass": 3.0}
    )
    assert added.events == (*scenario.events, cp.events.PayloadChange(time=15.0, mass=3.0))
    assert scenario.override({"events": []}).events == ()


def test_an_omitted_table_can_be_filled():
    scenario = planar_scenario().replace(cell=planar_scenario().cell.replace(load_shares=None))
    changed = scenario.override({"cell.load_shares.left": 0.3, "cell.load_shares.right": 0.7})
    assert changed.cell.load_shares == {"left": 0.3, "right": 0.7}
    assert changed.override({"cell.load_shares": {}}).cell.load_shares is None


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("duraton", "'duration'"),
        ("controler.gains.sign_gain", "'controller'"),
        ("controller.gains.sign", "'sign_gain'"),
        ("cell.arms.lefft.posture", "'left'"),
        ("cell.arms.lefft.base.xyz", "'left'"),
        ("events.3.time", "2 entries"),
        ("duration.seconds", "'seconds'"),
    ],
)
def test_a_wrong_path_is_unknown_with_a_suggestion(path, said):
    with pytest.raises(errors.UnknownFieldError) as caught:
        planar_scenario().override({path: 1.0})
    assert said in str(caught.value)
    assert caught.value.path == path


# ---------------------------------------------------------------- round trips


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_file_has_comments_if_it_shall_and_each_once(name):
    scenario = SCENARIOS[name]()
    plain, commented = scenario.to_toml(), scenario.to_toml(commented=True)
    assert "  # " not in plain
    comments = [comment for line in commented.splitlines() if (comment := line.partition("  # ")[2])]
    assert len(set(comments)) == len(comments) > 10


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_survives_its_file(name, tmp_path):
    scenario = SCENARIOS[name]()
    assert cp.Scenario.from_toml(scenario.to_toml()) == scenario
    scenario.save(tmp_path / "scenario.toml")
    assert cp.Scenario.load(tmp_path / "scenario.toml") == scenario


def test_any_text_survives_the_file():
    scenario = planar_scenario().replace(
        summary='quotes " and \\ and\nlines\n[\n    1.0,\n]\n', name="m\u00fcller"
    )
    assert cp.Scenario.from_toml(scenario.to_toml()) == scenario


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_survives_pickling_and_is_frozen(name):
    scenario = SCENARIOS[name]()
    assert pickle.loads(pickle.dumps(scenario)) == scenario
    with pytest.raises(ValueError, match="frozen"):
        scenario.duration = 1.0


def test_a_users_file_may_name_a_urdf_beside_it(tmp_path):
    from coop_pin.description.urdf import bundled_urdf_folder

    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "mine.urdf").write_bytes((bundled_urdf_folder() / "adept_3dof.urdf").read_bytes())
    scenario = planar_scenario().override(
        {"cell.arms.left.urdf": "robots/mine.urdf", "duration": 0.1, "events": []}
    )
    (tmp_path / "mine.toml").write_text(scenario.to_toml())
    result = cp.run(tmp_path / "mine.toml")
    assert result.scenario.cell.arms["left"].urdf == str(tmp_path / "robots" / "mine.urdf")


@pytest.mark.parametrize("content", [b"a = ", b"\xff\xfe", b"[cell\n"])
def test_what_is_not_toml_is_refused_with_its_path(tmp_path, content):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(errors.FileReadError, match=r"bad\.toml"):
        cp.Scenario.load(path)


def test_an_unknown_scenario_is_refused_with_a_suggestion():
    with pytest.raises(errors.NameNotFoundError, match="'adept-paper'"):
        cp.Scenario.load("adept-papr")


def test_spatial_scenario_is_read_as_written():
    scenario = spatial_scenario()
    np.testing.assert_array_equal(scenario.cell.shares, [0.3, 0.7])
    np.testing.assert_array_equal(scenario.squeeze_wrenches.sum(axis=0), np.zeros(6))


def test_a_mistake_in_no_single_field_starts_with_no_colon():
    with pytest.raises(errors.FieldError, match=r"^entries per joint disagree"):
        cp.Arm.from_urdf("ur5", "tool0", posture=(0.0,) * 6, torque_limits=(1.0, 2.0))


def test_locked_joints_are_a_table():
    with pytest.raises(errors.FieldError, match=r"locked: is \['elbow'\]; it must be a table"):
        cp.Arm.from_urdf("ur5", "tool0", locked=["elbow"])


def test_a_wrong_mass_or_size_of_a_box_is_one_mistake():
    with pytest.raises(errors.FieldError, match="mass: is -2; it must be positive") as caught:
        cp.Payload.box(mass=-2.0, size=(0.3, 0.2, 0.1))
    assert len(caught.value.problems) == 1
    with pytest.raises(errors.FieldError, match="size: has 2 entries"):
        cp.Payload.box(mass=2.0, size=(0.3, 0.2))


def test_a_bar_has_the_moments_of_a_thin_rod_and_of_its_section():
    """m times the mean square of x; about x the squares of both edges of its section."""
    square = np.mean(((np.arange(1000) + 0.5) / 1000 - 0.5) ** 2)
    inertia = cp.Payload.bar(3.0, 2.0, thickness=0.1).inertia
    expected = 3.0 * square * np.array((0.1**2 + 0.1**2, 2.0**2, 2.0**2))
    np.testing.assert_allclose(inertia, (*expected, 0.0, 0.0, 0.0), rtol=1e-5)


def test_a_wrong_path_names_the_scenario_files_where_it_leads(tmp_path):
    (tmp_path / "mine.toml").touch()
    for wrong in (tmp_path / "mien.toml", tmp_path):
        with pytest.raises(errors.NameNotFoundError, match=r"mine\.toml'"):
            cp.Scenario.load(wrong)


def test_a_misspelt_urdf_is_looked_for_beside_the_scenarios_file(tmp_path, monkeypatch):
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell" / "stork.urdf").touch()
    text = cp.Scenario.load("adept-paper").to_toml().replace('urdf = "adept_3dof"', 'urdf = "strok.urdf"')
    (tmp_path / "cell" / "mine.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    scenario = cp.Scenario.load("cell/mine.toml")
    with pytest.raises(errors.UrdfError, match=r"cell.strok\.urdf; did you mean 'stork\.urdf'"):
        _ = scenario.cell.arms["left"].file


@pytest.mark.parametrize(
    ("name", "changes", "caption"),
    [
        ("adept-paper", {}, None),
        (
            "adept-paper",
            {"name": "printed law", "events": [], "cell.arms.left.calibration_error.tip.xyz": [1e-3, 0, 0]},
            "changed: no events; left model: tip off by 1 mm",
        ),
        (
            "adept-anchored",
            {"clock.rate_hz": 160.0, "sensors.wrist": {"noise": {"force": 1.0}}},
            "changed: clock rate hz 80 → 160; sensors wrist (noise (force 1))",
        ),
        (
            "two-pandas-box",
            {"cell.arms.left.calibration_error.joint_offset": 1e-3, "cell.payload.mass": 2.5},
            "changed: left model: joints off by 1 mrad; payload mass 3 → 2.5",
        ),
        (
            "adept-paper",
            {"squeeze": {"kind": "tip-force", "force": 5.0}, "controller.force_path": {"kind": "late"}},
            "changed: force path none → late; squeeze constant → tip-force",
        ),
        ("adept-paper", {"summary": "my own words", "events": []}, "my own words"),
    ],
)
def test_the_caption_says_what_was_changed_in_a_scenario_of_the_catalogue(name, changes, caption):
    scenario = cp.Scenario.load(name, changes)
    assert scenario.caption == (scenario.summary if caption is None else caption)
    assert cp.Scenario.from_toml(scenario.to_toml()).caption == scenario.caption


def test_the_caption_of_many_changes_counts_those_that_it_leaves_out():
    gains = dict.fromkeys(("pose_gain", "sign_gain", "transient_rate"), 0.3)
    changes = {f"controller.gains.{name}": value for name, value in gains.items()}
    plan = {"duration": 11.0, "seed": 3, "clock.rate_hz": 160.0, "cell.payload.mass": 9.0, "events": []}
    text = planar_scenario().override(changes | plan).caption
    assert text.startswith("changed: no events; duration 20 → 11; payload mass 11.2 → 9; ")
    assert text.endswith("; 2 more")


def test_networks_whose_graph_changes_differ_in_it():
    """The field ``changes`` of a network is no method that tells differences."""
    graph = {"time": 1.0, "graph": "ring"}
    texts = differences(Network(changes=(graph,)), Network(), ("network",))
    assert list(texts) == ["network changes ((time 1, graph ring))"]


def test_the_caption_keeps_what_was_replaced_in_a_run():
    scenario = planar_scenario()
    replaced = scenario.replace(summary=f"{scenario.summary}; squeeze replaced at t = 3 s", events=())
    assert replaced.caption == "squeeze replaced at t = 3 s; changed: no events"


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_force_gain_is_checked_with_the_delay_of_wrists(name):
    """6 is below the bound (1 + p) / (1 - p) = 9 of a low-pass path, and above that of three ticks more."""
    late = {"sensors.wrist": {"delay": 3}}
    scenario, path = SCENARIOS[name]().replace(events=(), controller=ANCHORED[name]), "controller.force_path"
    slow = scenario.override({path: {"kind": "low-pass", "pole": 0.8}})
    with pytest.raises(errors.FieldError, match="force_gain"):
        slow.override({"controller.gains.force_gain": 9.1})
    prompt = slow.override({"controller.gains.force_gain": 6.0})
    with pytest.raises(errors.FieldError, match="force_gain"):
        prompt.override(late)
    assert prompt.override(late | {"beyond_bound": True}).beyond_bound


def test_a_folder_that_does_not_exist_stays_as_it_is_stated_in_a_file_elsewhere(tmp_path):
    """One that exists becomes the way from the folder of the file."""
    (tmp_path / "robots" / "meshes").mkdir(parents=True)
    there = str(tmp_path / "robots" / "meshes")
    scenario = SCENARIOS["spatial"]().override({"cell.arms.left.package_dirs": ["no/such", there]})
    table = tomllib.loads(toml_text(scenario, commented=False, folder=tmp_path / "robots"))
    assert table["cell"]["arms"]["left"]["package_dirs"] == ["no/such", "meshes"]
