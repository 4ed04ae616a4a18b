"""Command line: commands, fields, exit codes, and the folder of a run."""

import functools
import json
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel, field_serializer

import coop_pin as cp
from coop_pin.base.errors import SweepInterruptedError, is_ctrl_c
from coop_pin.cli import main
from coop_pin.cli.overrides import changes, literal
from coop_pin.cli.parsing import split_fields
from coop_pin.cli.run import run
from coop_pin.cli.run_folder import RunFolder, Timing
from coop_pin.sweeps.session import open_session

NUMBERS = ["--no-replay", "--no-figures"]
SHORT = ["--duration", "0.5", "--events", "[]", "--task.position", "1", "--task.orientation", "1"]
SHORT += ["--task.force", "100", "--task.moment", "10"]
TIMING = Timing(1.0, 1.0, 1.0)
PHASE_METRICS = [
    "position_rms_m",
    "orientation_rms_rad",
    "internal_axial_mean_N",
    "internal_axial_rms_error_N",
    "internal_shear_rms_N",
    "internal_moment_rms_error_Nm",
]
METRICS = [
    "task_kept",
    "position_error_max_m",
    "orientation_error_max_rad",
    "internal_force_error_max_N",
    "internal_moment_error_max_Nm",
    "settling_time_s",
    "resettling_time_s",
    "event_peak_position_error_m",
    *(f"{phase}_{name}" for phase in ("moving", "rest", "after_event") for name in PHASE_METRICS),
    "closure_error_max_m",
    "closure_error_max_rad",
    "energy_balance_max_J",
    "torque_peak_Nm",
    "joint_drift_rad",
]
PICTURES = [
    "replay.html",
    *(f"{name}.png" for name in ("figure2", "figure3", "errors")),
]
NUMBER_FILES = ["scenario.toml", "result.nc", "metrics.json", "timing.json"]


def files(folder):
    return sorted(path.name for path in folder.iterdir())


def child(*words, cwd=None, code=None):
    """Run a process as a user does."""
    start = ["-c", code] if code else ["-m", "coop_pin"]
    return subprocess.run(
        [sys.executable, *start, *words], cwd=cwd, capture_output=True, text=True, timeout=120, check=False
    )


FIVE = ["--duration", "5", "--events", "[]"]
"""Five seconds, at the end of which the task is kept."""


@pytest.fixture(scope="module")
def paper_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper") / "out"
    assert main(["run", "adept-paper", "--out", str(folder), *FIVE]) == 0
    return folder


# ---------------------------------------------------------------- run


def test_run_leaves_the_whole_folder(paper_folder):
    assert files(paper_folder) == sorted([*NUMBER_FILES, *PICTURES])
    assert all((paper_folder / name).stat().st_size > 0 for name in files(paper_folder))


def test_metrics_are_flat_and_those_of_the_result(paper_folder):
    metrics = json.loads((paper_folder / "metrics.json").read_text(), parse_constant=pytest.fail)
    assert list(metrics) == ["simulation_sound", "task", "reasons", *METRICS]
    assert (metrics.pop("reasons"), metrics.pop("task")) == ([], "kept")
    expected = cp.run("adept-paper", {"duration": 5.0, "events": []}).metrics()
    assert metrics == {name: None if value != value else value for name, value in expected.items()}


def test_timing_is_kept_apart(paper_folder):
    timing = json.loads((paper_folder / "timing.json").read_text())
    assert list(timing) == ["wall_s", "cpu_s", "real_time_factor"]
    assert timing["real_time_factor"] == pytest.approx(5.0 / timing["wall_s"])


def test_the_resolved_scenario_runs_again_to_the_same_bits(paper_folder, tmp_path):
    scenario = cp.Scenario.load("adept-paper", {"duration": 5.0, "events": []})
    assert cp.Scenario.load(paper_folder / "scenario.toml") == scenario
    assert (
        main(["run", str(paper_folder / "scenario.toml"), "--out", str(tmp_path), "--quiet", *NUMBERS]) == 0
    )
    for name in ("scenario.toml", "metrics.json"):
        assert (tmp_path / name).read_bytes() == (paper_folder / name).read_bytes()
    again, first = (cp.RunResult.load(folder / "result.nc") for folder in (tmp_path, paper_folder))
    assert again.data.identical(first.data)


def test_a_table_is_printed_and_no_progress_bar_outside_a_terminal(tmp_path, capsys):
    assert main(["run", "adept-paper", "--out", str(tmp_path), *NUMBERS, *SHORT]) == 0
    out, err = capsys.readouterr()
    assert all(name in out for name in METRICS)
    assert str(tmp_path) in out
    assert err == ""


def test_what_is_no_number_is_told_in_words(tmp_path, capsys):
    """Half a second settles nothing, never rests and has no event."""
    assert main(["run", "adept-paper", "--out", str(tmp_path), *NUMBERS, *SHORT]) == 0
    out = re.sub(r",\n +", ", ", capsys.readouterr().out)
    lines = dict(line.split(maxsplit=1) for line in out.splitlines() if line.startswith("  "))
    assert lines["settling_time_s"].startswith("never")
    assert not {"resettling_time_s", "rest_position_rms_m"} & {*lines}
    absent = lines["does"].removeprefix("not apply: ")
    assert {"resettling_time_s", "rest_position_rms_m"} <= {*absent.split(", ")}
    assert "it never rests" in out


def test_a_warning_is_told_without_the_source_line_that_gave_it():
    """In a process of its own: pytest catches warnings before they are written."""
    code = "import sys, warnings\nfrom coop_pin.cli import main, parsing\n"
    code += "from coop_pin.base.errors import UrdfWarning\n"
    code += "parsing.parse = lambda words: lambda: warnings.warn('look', UrdfWarning); sys.exit(main([]))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (ended.stdout, ended.stderr) == ("", "coop-pin: warning: look\n")


@pytest.mark.filterwarnings("ignore::coop_pin.base.errors.ScenarioWarning")
def test_the_table_tells_limits_that_were_exceeded(tmp_path, capsys):
    assert (
        main(
            [
                "run",
                "adept-paper",
                "--out",
                str(tmp_path),
                *NUMBERS,
                *SHORT,
                "--cell.arms.left.torque-limits",
                "3",
            ]
        )
        == 4
    )
    assert "torque of left" in capsys.readouterr().out


def test_quiet_prints_nothing(tmp_path, capsys):
    assert main(["run", "adept-paper", "--out", str(tmp_path), "--quiet", *NUMBERS, *SHORT]) == 0
    assert capsys.readouterr() == ("", "")


def test_numbers_that_json_does_not_know_become_null(tmp_path):
    assert main(["run", "adept-paper", "--out", str(tmp_path), "--quiet", *NUMBERS, *SHORT]) == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text(), parse_constant=pytest.fail)
    assert metrics["settling_time_s"] is None  # never settles in half a second
    assert metrics["rest_position_rms_m"] is None  # it never rests


def test_the_default_folder_carries_the_scenarios_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "adept-paper", "--quiet", "--name", "mine", *NUMBERS, *SHORT]) == 0
    assert files(tmp_path / "out" / "mine") == sorted(NUMBER_FILES)


def test_pictures_of_an_earlier_run_do_not_stay_beside_the_numbers_of_this_one(tmp_path):
    for name in PICTURES:
        (tmp_path / name).write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    assert main(["run", "adept-paper", "--out", str(tmp_path), "--quiet", *NUMBERS, *SHORT]) == 0
    assert files(tmp_path) == sorted([*NUMBER_FILES, "notes.txt"])


# ---------------------------------------------------------------- fields


@pytest.mark.parametrize(
    ("words", "path", "value"),
    [
        (["--controller.gains.sign-gain", "0.5"], "controller.gains.sign_gain", 0.5),
        (["--controller.gains.sign-gain=.5"], "controller.gains.sign_gain", 0.5),
        (
            ["--controller.gains.damping-gain", "1", "2", "3"],
            "controller.gains.damping_gain",
            (1.0, 2.0, 3.0),
        ),
        (["--clock.rate-hz", "400"], "clock.rate_hz", 400.0),
        (["--cell.arms.left.posture", "1.3", "-1.7", "1.9"], "cell.arms.left.posture", (1.3, -1.7, 1.9)),
        (["--plant.payload", "free"], "plant.payload", "free"),
        (["--controller.switching", '{kind = "tanh", width = 0.2}'], "controller.switching.width", 0.2),
        (
            ["--controller.switching.width", "0.2", "--controller.switching.kind", "tanh"],
            "controller.switching.width",
            0.2,
        ),
        (
            ["--cell.load-shares.left", "0.3", "--cell.load-shares.right", "0.7"],
            "cell.load_shares.right",
            0.7,
        ),
        (
            ["--events.0.kind", "payload-change", "--events.0.time", "0.1", "--events.0.mass", "6"],
            "events.0.mass",
            6.0,
        ),
        (["--beyond-bound"], "beyond_bound", True),
    ],
)
def test_any_field_can_be_typed(words, path, value, tmp_path):
    assert main(["run", "adept-paper", *SHORT, *words, "--out", str(tmp_path), "--quiet", *NUMBERS]) == 0
    node = cp.Scenario.load(tmp_path / "scenario.toml")
    for key in path.split("."):
        node = (
            node[int(key)]
            if isinstance(node, tuple)
            else node[key]
            if isinstance(node, dict)
            else getattr(node, key)
        )
    assert node == value


def test_own_words_are_told_apart_from_fields_in_any_order():
    words = [
        "run",
        "a.toml",
        "--out",
        "d",
        "--a.b",
        "1",
        "-2",
        "--no-figures",
        "--c=3",
        "--quiet",
        "--flag",
        "-h",
    ]
    own = ["run", "a.toml", "--out", "d", "--no-figures", "--quiet", "-h"]
    assert split_fields(words, run) == (own, {"a.b": ["1", "-2"], "c": ["3"], "flag": []})


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("400", 400),
        ("1e-3", 1e-3),
        (".5", 0.5),
        ("true", True),
        ("free", "free"),
        ('"400"', "400"),
        ("[[1, 2], [3, 4]]", [[1, 2], [3, 4]]),
        ("{a = 1}", {"a": 1}),
        ("2026-01-01", "2026-01-01"),
        ("1\nother = 2", "1\nother = 2"),
        ("robots/a.urdf", "robots/a.urdf"),
    ],
)
def test_words_are_read_as_toml_or_as_text(word, value):
    assert literal(word) == value
    assert type(literal(word)) is type(value)


def test_fields_lists_every_field_with_its_meaning_as_it_can_be_typed(capsys):
    assert main(["fields", "adept-paper"]) == 0
    scenario, fields = cp.Scenario.load("adept-paper"), {}
    for line in capsys.readouterr().out.splitlines():
        option, value, meaning = re.fullmatch(r"--(\S+) +(.+?)  +(\S.*)", line).groups()
        assert meaning
        if value == "(omitted)":
            continue
        fields[option] = [value] if value[0] in "[{" or option == "summary" else value.split()
    assert scenario.override(changes(fields, scenario.cell.arms)) == scenario
    assert {"controller.gains.sign-gain", "cell.arms.left.posture", "events.1.wrench", "beyond-bound"} <= set(
        fields
    )
    # Where a field is missing in the list, changing it in the scenario would not show.
    nothing = cp.Scenario.load("adept-paper").override(
        {"events": [], "cell.payload.mass": 1.0, "plant.stabilisation.frequency": 1.0}
    )
    kept = {path: words for path, words in fields.items() if path.split(".")[0] in ("cell", "plant")}
    assert nothing.override(changes(kept, scenario.cell.arms)) == scenario.override({"events": []})


def test_the_fields_of_a_scenario_of_the_catalogue_are_kept_and_a_file_is_read_each_time(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert main(["fields", "adept-paper"]) == 0
    text, file = capsys.readouterr().out, tmp_path / "own.toml"
    file.write_text(cp.Scenario.load("adept-paper").to_toml())
    monkeypatch.setattr(cp.Scenario, "load", lambda _: 1 / 0)
    assert main(["fields", "adept-paper"]) == 0
    assert capsys.readouterr().out == text
    assert main(["fields", str(file)]) == 2
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_fields_tells_the_kinds_there_are_and_what_a_pose_is_the_pose_of(capsys):
    assert main(["fields", "adept-paper"]) == 0
    said = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert said["--controller.kind"].endswith(
        "one of sliding-mode, sliding-mode-redundant, payload-space, mean-pose, symmetric,"
        " prescribed-performance, leader-follower, admittance, computed-torque, adaptive, object-impedance,"
        " torque-qp, user."
    )
    assert said["--events.1.kind"].endswith(
        "one of payload-change, wrench-pulse, gravity-turn, partner, put-down, user, lose-arm, release,"
        " hand-over, grasp."
    )
    assert "root link in the world: x, y, z, m." in said["--cell.arms.left.base.xyz"]


# ---------------------------------------------------------------- mistakes


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "adept-papr"], "'adept-paper'"),
        (["run", "adept-paper", "--controler.gains.sign-gain", "1"], "'controller'"),
        (["run", "adept-paper", "--duraton", "1"], "'duration'"),
        (["run", "adept-paper", "--controller.gains.sign-gain", "nan"], "controller.gains.sign_gain: is nan"),
        (["run", "adept-paper", "--controller.gains.sign-gain"], "controller.gains.sign_gain: has no value"),
        (["run", "adept-paper", "--duration", "5"], "events.0.time: ends at t = 10 s"),
        (["run", "adept-paper", "--start.xyz", "3", "0", "0"], "misses its grasp by"),
        (["run", "adept-paper", "--cell.arms.left.tip", "tipp"], "'tip'"),
        (["run", "adept-paper", "--cell.arms.left.urdf", "nowhere.urdf"], "nowhere.urdf"),
        (["run", "adept-paper", "--controller.gains.force-gain", "0.5"], "force_path.kind 'none'"),
        (["fields", "adept-papr"], "'adept-paper'"),
        (["view", "nowhere"], "no result file"),
        (["check-urdf", "nowhere.urdf"], "nowhere.urdf"),
    ],
)
def test_bad_input_is_told_without_a_traceback(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert said in err
    assert err.startswith("coop-pin: ")
    assert out == ""


def test_a_users_file_with_mistakes_has_them_all_told(tmp_path, capsys):
    scenario = cp.Scenario.load("adept-paper").to_toml()
    (tmp_path / "mine.toml").write_text(
        scenario.replace("mass = 11.2", "masss = 11.2").replace("rate_hz = 80.0", "rate_hz = nan")
    )
    assert main(["run", str(tmp_path / "mine.toml")]) == 2
    err = capsys.readouterr().err
    assert "cell.payload.masss: there is no such field" in err
    assert "clock.rate_hz: is nan" in err
    assert "cell.payload.mass: must be given" in err


@pytest.mark.parametrize("words", [[], ["walk"], ["run"], ["view"]])
def test_words_that_make_no_command_end_with_code_2(words, capsys):
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2
    assert "coop-pin" in "".join(capsys.readouterr())


def test_a_folder_that_cannot_be_made_is_told_before_the_run(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["run", "adept-paper", "--out", str(tmp_path / "file" / "out")]) == 1
    assert "Not a directory" in capsys.readouterr().err


def test_a_diverging_run_fails_with_its_time_and_leaves_its_result(tmp_path, capsys):
    (tmp_path / "replay.html").write_text("old")
    words = ["--controller.force-path.kind", "late", "--controller.gains.force-gain", "1.1", "--beyond-bound"]
    assert main(["run", "adept-paper", "--out", str(tmp_path), *words]) in (3, 4)
    err = capsys.readouterr().err
    result = cp.RunResult.load(tmp_path / "result.nc")
    assert f"diverged at t = {result.end:g} s" in err
    assert str(tmp_path / "result.nc") in err
    assert 0.0 < result.end < 20.0
    assert files(tmp_path) == sorted(NUMBER_FILES)
    metrics = json.loads((tmp_path / "metrics.json").read_text(), parse_constant=pytest.fail)
    assert list(metrics) == ["simulation_sound", "task", "reasons", "ended_by", *METRICS]
    assert (metrics["simulation_sound"], metrics["task"]) == (result.simulation_sound, "lost")
    assert metrics["reasons"] == [str(breach) for breach in (*result.breaches(), *result.task.deviations)]
    assert metrics["ended_by"] == "DivergedError"
    assert metrics["closure_error_max_m"] == result.closure_error_max()[0]


INTERRUPTING = """
import os, signal
from coop_pin import ArmCommand, ArmController

class Law(ArmController):
    def __init__(self, scenario, arm):
        pass
    def init(self, measurement, reference):
        return None
    def step(self, measurement, reference, state):
        if measurement.time > 0.1:
            os.kill(os.getpid(), signal.SIGINT)
        return ArmCommand(0.0 * measurement.v, state)
"""


def test_ctrl_c_leaves_the_result_and_ends_with_130(tmp_path):
    (tmp_path / "interrupting.py").write_text(INTERRUPTING)
    words = ["--controller.kind", "user", "--controller.target", "interrupting:Law"]
    done = child("run", "adept-paper", "--out", "kept", *words, cwd=tmp_path)
    assert done.returncode == 130
    assert "interrupted at t = 0.1 s" in done.stderr
    assert "Traceback" not in done.stderr
    assert cp.RunResult.load(tmp_path / "kept" / "result.nc").end == pytest.approx(0.1)
    metrics = json.loads((tmp_path / "kept" / "metrics.json").read_text())
    assert metrics["rest_position_rms_m"] is None  # it never rested
    assert metrics["task"] == "off"


@pytest.fixture
def parsed(monkeypatch):
    """A function that replaces what makes a command of the words of a command line."""
    return functools.partial(monkeypatch.setattr, "coop_pin.cli.parsing.parse")


@pytest.mark.parametrize("kind", [ImportError, RuntimeError])
def test_ctrl_c_while_modules_load_is_told_as_ctrl_c(kind, parsed, capsys):
    """Compiled code makes an ImportError of it, and Python's ``__set_name__`` a RuntimeError."""

    def loading(_words):
        inner = kind("initialization failed")
        inner.__cause__ = KeyboardInterrupt()
        raise ImportError("one of its modules cannot be loaded") from inner

    parsed(loading)
    assert main(["list"]) == 130
    assert capsys.readouterr().err == "coop-pin: interrupted\n"


class Serialized(BaseModel):
    number: int = 1

    @field_serializer("number")
    def _interrupted(self, _number):
        raise KeyboardInterrupt


def test_ctrl_c_while_json_is_written_is_told_as_ctrl_c_and_ends_a_sweep(parsed, capsys, tmp_path):
    """Pydantic makes a ValueError of it, without cause."""
    parsed(lambda _words: Serialized().model_dump_json)
    assert main(["list"]) == 130
    assert capsys.readouterr().err == "coop-pin: interrupted\n"
    with pytest.raises(SweepInterruptedError), open_session(tmp_path, cp.Execution(quiet=True), 1):
        Serialized().model_dump_json()
    assert not is_ctrl_c(ValueError("KeyboardInterrupt"))


def test_ctrl_c_that_python_drops_in_a_destructor_comes_again(parsed, capsys):
    class Interrupting:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    def command():
        Interrupting()
        time.sleep(30.0)  # until it comes

    hook, start = sys.unraisablehook, time.monotonic()
    parsed(lambda _words: command)
    assert main(["list"]) == 130
    assert time.monotonic() - start < 20.0
    assert capsys.readouterr().err == "coop-pin: interrupted\n"
    assert sys.unraisablehook is hook


def test_ctrl_c_that_python_drops_at_the_end_of_a_command_does_not_outlive_it(parsed):
    class Interrupting:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    def command():
        Interrupting()

    parsed(lambda _words: command)
    assert main(["list"]) == 0
    time.sleep(0.2)


def test_other_errors_that_python_drops_are_told(parsed, monkeypatch):
    class Failing:
        def __del__(self):
            raise ValueError("lost")

    def command():
        Failing()

    told = []
    monkeypatch.setattr(sys, "unraisablehook", lambda dropped: told.append(dropped.exc_type))
    parsed(lambda _words: command)
    assert main(["list"]) == 0
    assert told == [ValueError]


def test_an_import_that_fails_by_itself_is_raised(parsed):
    names = {}  # no file of the user's
    exec("def loading(_words):\n    raise ImportError('no such module')", names)
    parsed(names["loading"])
    with pytest.raises(ImportError, match="no such module"):
        main(["list"])


COUNTING = """
from pathlib import Path
import interrupting

class Law(interrupting.Law):
    def __init__(self, scenario, arm):
        with Path("built.txt").open("a") as file:
            file.write(arm + " ")
    def step(self, measurement, reference, state):
        return interrupting.ArmCommand(0.0 * measurement.v, state)
"""


def test_a_controller_is_built_once(tmp_path, monkeypatch):
    (tmp_path / "interrupting.py").write_text(INTERRUPTING)
    (tmp_path / "counting_builds.py").write_text(COUNTING)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    words = ["--controller.kind", "user", "--controller.target", "counting_builds:Law", "--duration", "0.1"]
    assert main(["run", "adept-paper", "--quiet", "--events", "[]", *NUMBERS, *words]) in (0, 4)
    assert (tmp_path / "built.txt").read_text() == "left right "


# ---------------------------------------------------------------- the other commands


def test_list_names_every_scenario(capsys):
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines if line[0] != " "] == cp.scenario_names()
    assert "2 arms  20 s" in next(line for line in lines if line.startswith("adept-paper "))


def test_view_makes_a_missing_replay_again(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    cp.run("adept-paper", {"duration": 0.5, "events": []}).save(tmp_path / "result.nc")
    for _ in range(2):
        assert main(["view", str(tmp_path)]) == 0
        assert capsys.readouterr().out.strip() == str((tmp_path / "replay.html").resolve())
        assert (tmp_path / "replay.html").stat().st_size > 1000


@pytest.mark.parametrize(("words", "opened"), [([], True), (["--no-open"], False)])
def test_view_opens_a_browser_where_there_is_a_screen(tmp_path, monkeypatch, words, opened):
    asked = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", asked.append)
    (tmp_path / "replay.html").write_text("a replay")
    assert main(["view", str(tmp_path), *words]) == 0
    assert asked == ([(tmp_path / "replay.html").resolve().as_uri()] if opened else [])


def test_view_of_a_result_file_writes_a_replay_beside_it(tmp_path, capsys):
    cp.run("adept-paper", {"duration": 0.5, "events": []}).save(tmp_path / "mine.nc")
    assert main(["view", str(tmp_path / "mine.nc"), "--no-open"]) == 0
    assert capsys.readouterr().out.strip() == str((tmp_path / "mine.html").resolve())


@pytest.mark.parametrize(
    "words",
    [pytest.param(words, marks=pytest.mark.gate) for words in (["--run", "--realtime-rate", "5"], [])],
)
def test_view_of_a_scenario_is_live_until_ctrl_c(words):
    process = subprocess.Popen(
        [sys.executable, "-m", "coop_pin", "view", "adept-paper", "--no-open", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    url = process.stdout.readline().decode().strip()
    with urllib.request.urlopen(url, timeout=30) as page:
        assert b"coopPinStage" in page.read()
    process.send_signal(signal.SIGINT)
    said, hint = process.communicate(timeout=30)
    assert said == b""
    assert hint.splitlines() == [
        b"coop-pin: open this address in a browser on this machine; Ctrl-C ends the view"
    ]
    assert process.returncode == 0
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(url, timeout=5)


def test_view_says_so_where_its_port_is_taken(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["view", "adept-paper", "--no-open", "--port", str(port)]) == 2
    assert f"port {port} of 127.0.0.1 cannot be used" in capsys.readouterr().err


def test_check_urdf_ends_with_the_verdict(tmp_path, capsys):
    assert main(["check-urdf", "adept_3dof"]) == 0
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    bad = f'<robot name="a"><link name="b"><inertial><mass value="-1"/>{inertia}</inertial></link></robot>'
    (tmp_path / "bad.urdf").write_text(bad)
    assert main(["check-urdf", str(tmp_path / "bad.urdf")]) == 0
    assert main(["check-urdf", str(tmp_path / "bad.urdf"), "--strict"]) == 1
    (tmp_path / "worse.urdf").write_text(bad[:-9])
    assert main(["check-urdf", str(tmp_path / "worse.urdf")]) == 1
    assert "link 'b'" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["--help"], ["run", "--help"], ["run", "adept-paper", "-h"]])
def test_help_tells_how_to_change_fields(words, capsys):
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 0
    assert "coop-pin fields" in " ".join(capsys.readouterr().out.replace("│", " ").split())


def test_python_m_is_the_command_and_both_know_their_version():
    script = Path(sys.executable).with_name("coop-pin")
    for command in ([sys.executable, "-m", "coop_pin"], [str(script)]):
        done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True)
        assert done.stdout == f"coop-pin {cp.__version__}\n"


def test_help_loads_no_dynamics_and_no_pictures():
    code = (
        "import sys\nfrom coop_pin.cli import main\n"
        "try: main(['run', '--help'])\nexcept SystemExit: pass\n"
        "heavy = {'pinocchio', 'scipy', 'xarray', 'matplotlib', 'meshcat', 'pydantic'} & set(sys.modules)\n"
        "sys.exit(', '.join(heavy) or 0)"
    )
    done = child(code=code)
    assert done.returncode == 0, done.stderr


@pytest.mark.gate
def test_a_check_loads_no_library_of_results():
    code = (
        "import sys\nfrom coop_pin.cli import main\nmain(['check', 'adept-paper', '--poses', '5'])\n"
        "unused = {'xarray', 'pandas', 'matplotlib', 'urllib.request'}\n"
        "sys.exit(', '.join(unused & set(sys.modules)) or 0)"
    )
    done = child(code=code)
    assert done.returncode == 0, done.stderr


@pytest.mark.gate
def test_a_run_with_all_its_files_loads_no_library_that_it_does_not_use(tmp_path):
    """Each takes 0.1 to 0.5 s: dask through xarray, fonts for PDF, the server of meshcat, mesh readers."""
    code = (
        "import sys\nfrom coop_pin.cli import main\n"
        f"main(['run', 'adept-paper', '--duration', '0.05', '--events', '[]', '--out', {str(tmp_path)!r}])\n"
        "unused = {'dask', 'fontTools.subset', 'meshcat', 'tornado', 'trimesh', 'coop_pin.compiled.plant'}\n"
        "sys.exit(', '.join(unused & set(sys.modules)) or 0)"
    )
    done = child(code=code)
    assert done.returncode == 0, done.stderr
    assert {"figure2.png", "replay.html", "result.nc"} <= {path.name for path in tmp_path.iterdir()}


# ---------------------------------------------------------------- files that survive


@pytest.fixture(scope="module")
def result():
    return cp.run("adept-paper", {"duration": 0.5, "events": []})


def test_a_result_survives_its_file(result, tmp_path):
    result.save(tmp_path / "result.nc")
    loaded = cp.RunResult.load(tmp_path / "result.nc")
    assert loaded.scenario == result.scenario
    assert loaded.data.identical(result.data)
    assert json.dumps(loaded.metrics()) == json.dumps(result.metrics())


def test_files_are_as_readable_as_any_others(result, tmp_path):
    RunFolder(tmp_path).write(result, TIMING, replay=False, figures=())
    (tmp_path / "plain").write_text("")
    assert {path.stat().st_mode for path in tmp_path.iterdir()} == {(tmp_path / "plain").stat().st_mode}


FULL_DISK = """
import resource, sys
import coop_pin as cp
result = cp.RunResult.load("result.nc")
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    result.save("result.nc")
except OSError as error:
    sys.exit(0)
sys.exit("a file of 100 kB went into 20 kB")
"""


@pytest.mark.gate
def test_a_full_disk_leaves_the_old_result_and_nothing_else(result, tmp_path):
    result.save(tmp_path / "result.nc")
    before = (tmp_path / "result.nc").read_bytes()
    assert len(before) > 20_000
    done = child(code=FULL_DISK, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "result.nc").read_bytes() == before
    assert files(tmp_path) == ["result.nc"]


def test_a_failing_write_leaves_the_old_files_of_the_folder(result, tmp_path, monkeypatch):
    folder = RunFolder(tmp_path)
    folder.write(result, TIMING, replay=False, figures=())
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def full(_descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        folder.write(result, Timing(2.0, 2.0, 2.0), replay=False, figures=())
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("keep", [0, 1, 100, 5000, 0.5, 0.99])
def test_a_truncated_result_is_refused(result, tmp_path, keep):
    path = tmp_path / "result.nc"
    result.save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: keep if isinstance(keep, int) else int(keep * len(whole))])
    with pytest.raises(cp.errors.FileReadError, match=r"result\.nc"):
        cp.RunResult.load(path)


def test_foreign_files_are_no_results(tmp_path):
    import xarray as xr

    (tmp_path / "text.nc").write_text("not a result")
    xr.Dataset({"a": ("x", np.arange(3))}).to_netcdf(tmp_path / "foreign.nc", engine="h5netcdf")
    xr.Dataset(attrs={"coop_pin_scenario": "a = "}).to_netcdf(tmp_path / "broken.nc", engine="h5netcdf")
    xr.Dataset(attrs={"coop_pin_scenario": "name = 'a'"}).to_netcdf(tmp_path / "old.nc", engine="h5netcdf")
    for name in ("text.nc", "foreign.nc", "broken.nc", "old.nc", "missing.nc"):
        with pytest.raises(cp.errors.FileReadError, match=name):
            cp.RunResult.load(tmp_path / name)


def test_show_prints_the_cell_as_a_tree(capsys):
    assert main(["show", "adept-paper"]) == 0
    printed = capsys.readouterr().out
    assert "2 arms, 6 joints" in printed
    assert "12 rows, rank 9 (3 redundant); 3 degrees of freedom" in printed


@pytest.mark.gate
def test_check_ends_with_the_verdict(tmp_path, capsys):
    assert main(["check", "adept-paper", "--poses", "5"]) == 0
    assert "sigma_min" in capsys.readouterr().out
    away = cp.Scenario.load(
        "adept-paper",
        {"motion": {"kind": "line", "start": {}, "goal": {"xyz": (0.5, 2.0, 0.0)}, "duration": 5.0}},
    )
    away.save(tmp_path / "away.toml")
    assert main(["check", str(tmp_path / "away.toml"), "--poses", "5"]) == 1
    assert "left" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [
        ["list"],
        ["check", "adept-paper", "--poses", "5"],
        pytest.param(["suggest", "two-pandas-box"], marks=pytest.mark.slow),
    ],
)
def test_texts_have_lines_of_at_most_99_columns_and_all_their_words(words, capsys):
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 99
    assert sum(len(line) > 60 for line in lines) > 3
