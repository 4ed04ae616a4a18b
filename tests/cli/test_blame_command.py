"""Command ``blame`` on the committed log, whose cell does not know what is off."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import coop_pin as cp
from coop_pin.cli import main

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "real_pair"


@pytest.mark.gate
def test_the_committed_log_has_its_answer_page_and_correction(tmp_path, capsys):
    words = ["blame", str(FOLDER / "log.csv"), "--cell", str(FOLDER / "cell.toml"), "--out", str(tmp_path)]
    assert main(words) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "left base x or right base x" in out
    assert "left wrist y" in out
    assert "right clock" in out
    assert abs(float(re.search(r"left wrist y, (\S+) N", out)[1]) - 1.5) < 0.05
    assert abs(float(re.search(r"right base x (\S+) mm", out)[1]) - 2.0) < 0.1
    howto = (FOLDER.parents[1] / "docs" / "howto" / "real-arms.md").read_text()
    for line in re.search(r"```text\n(.*?)```", howto, re.DOTALL)[1].splitlines():
        assert " ".join(line.split()) in out, line
    page = (tmp_path / "blame.html").read_text()
    assert page.count("data:image/svg+xml") == 2
    table = tomllib.loads((tmp_path / "with_errors.toml").read_text())
    x = [table["cell"]["arms"][arm]["calibration_error"]["base"]["xyz"][0] for arm in ("left", "right")]
    assert abs(x[0] + x[1] - 2e-3) < 1e-4
    zero = table["arm_sensors"]["left"]["wrist"]["offset"]["force"]
    assert np.abs(np.array(zero) - (0.0, 1.5, 0.0)).max() < 0.25
    assert cp.Scenario.load(tmp_path / "with_errors.toml").log is not None


def test_a_log_without_a_cell_or_with_the_wrong_unit_fails(capsys):
    assert main(["blame", str(FOLDER / "log.csv")]) == 2
    assert "--cell" in capsys.readouterr().err
