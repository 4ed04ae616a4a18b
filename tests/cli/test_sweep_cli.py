"""Commands ``coop-pin sweep`` and ``coop-pin sweep-show``: exit codes and output."""

import csv
from pathlib import Path

import pandas as pd
import pytest

from coop_pin.cli import main
from coop_pin.sweeps.store import SweepStore

PLAN = """
base = "adept-paper"
changes = { duration = 0.1, events = [] }
[axes]
"controller.gains.sign_gain" = [0.1, -1.0, 0.2]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gains.toml").write_text(PLAN)
    return tmp_path


def test_a_sweep_writes_its_folder_and_can_be_shown(folder, capsys):
    assert main(["sweep", "gains.toml", "--workers", "0"]) == 0
    said = capsys.readouterr().out
    assert "2 ok, 1 failed, 0 missing" in said
    assert "torque_peak_Nm" in said
    assert main(["sweep", "gains.toml", "--workers", "0"]) == 0
    assert capsys.readouterr().out == said
    assert (folder / "out" / "gains" / "table.csv").read_text().count("\n") == 4
    assert main(["sweep-show", "out/gains", "--best", "torque_peak_Nm", "--failures"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(said[: said.index("written to")])
    assert "smallest torque_peak_Nm:" in shown
    assert "run 1: controller.gains.sign_gain = -1.0" in shown


def test_a_sweep_takes_over_the_runs_of_another_folder(folder, runs_here, capsys):
    words = ["sweep", "gains.toml", "--workers", "0", "--quiet"]
    assert main([*words, "--out", "theirs"]) == 0
    runs_here.jobs.clear()
    assert main([*words, "--out", "mine", "--merge", "theirs"]) == 0
    assert runs_here.jobs == []
    theirs, mine = (pd.read_csv(folder / name / "table.csv") for name in ("theirs", "mine"))
    assert theirs["merged"].tolist() == [0.0] * 3
    assert mine["merged"].tolist() == [1.0] * 3
    assert mine.drop(columns="merged").equals(theirs.drop(columns="merged"))
    assert main([*words, "--out", "mine", "--merge", "nowhere"]) == 2
    assert "nowhere" in capsys.readouterr().err


@pytest.mark.usefixtures("folder")
def test_sweep_show_shows_a_part_of_a_sweep(capsys):
    assert main(["sweep", "gains.toml", "--workers", "0", "--quiet"]) == 0
    shown = []
    for value in ("0.2", "-1"):
        words = ["--at", f"controller.gains.sign_gain={value}", "--table", "part.csv"]
        assert main(["sweep-show", "out/gains", *words]) == 0
        shown.append(capsys.readouterr().out)
        with Path("part.csv").open() as file:
            (line,) = csv.DictReader(file)
        assert float(line["controller.gains.sign_gain"]) == float(value)
        assert line["status"] == ("ok" if value == "0.2" else "failed")
        assert bool(line["torque_peak_Nm"]) == (value == "0.2")
    assert "1 ok, 0 failed, 0 missing" in shown[0]
    assert "0 ok, 1 failed, 0 missing" in shown[1]
    for words, said in (("controller.gains.sign_gain=7", "0.1, -1.0, 0.2"), ("clock=1", "sign_gain")):
        assert main(["sweep-show", "out/gains", "--at", words]) == 2
        assert said in capsys.readouterr().err


def test_an_estimate_runs_nothing_and_writes_nothing(folder, capsys):
    assert main(["sweep", "gains.toml", "--estimate", "--workers", "3"]) == 0
    said = capsys.readouterr().out
    assert "3 runs" in said
    assert "on 3 workers" in said
    assert sorted(path.name for path in folder.iterdir()) == ["gains.toml"]


@pytest.mark.usefixtures("folder")
def test_quiet_is_quiet(capsys):
    assert main(["sweep", "gains.toml", "--out", "here", "--workers", "0", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["sweep", "none.toml"], 2, "no sweep file 'none.toml'"),
        (["sweep", "bad.toml"], 2, "did you mean 'sign_gain'"),
        (["sweep", "gains.toml", "--workers", "-1"], 2, "workers: is -1"),
        (["sweep-show", "."], 2, "holds no sweep"),
    ],
    ids=lambda value: " ".join(value[1:]) if isinstance(value, list) else "",
)
def test_mistakes_are_one_line_and_an_exit_code(folder, capsys, words, code, message):
    (folder / "bad.toml").write_text(
        'base = "adept-paper"\naxes = { "controller.gains.sing_gain" = [0.1] }\n'
    )
    assert main(words) == code
    said = capsys.readouterr().err
    assert message in said
    assert said.startswith("coop-pin: ")
    assert not (folder / "out").exists()


def test_a_folder_in_use_is_refused(folder, capsys):
    with SweepStore(folder / "kept").locked():
        assert main(["sweep", "gains.toml", "--out", "kept", "--workers", "0"]) == 1
    assert "is in use by process" in capsys.readouterr().err
