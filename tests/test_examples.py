"""Every example runs as a user runs it, in a folder of its own, and shows what it promises."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))


def run(name, folder):
    done = subprocess.run([sys.executable, str(FOLDER / name)], cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


def test_every_example_is_tested_here():
    assert {path.name for path in EXAMPLES} == {"run_paper.py", "sweep_force_gain.py", "own_controller.py"}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_says_what_it_shows(path):
    assert ast.get_docstring(ast.parse(path.read_text()))


def test_run_paper_prints_the_metrics_and_saves_the_run(tmp_path):
    out = run("run_paper.py", tmp_path)
    assert "settling_time_s" in out
    assert sorted(path.name for path in (tmp_path / "out" / "run_paper").iterdir()) == ["replay.html", "result.nc"]


def test_sweep_shows_the_static_factor_and_the_bound(tmp_path):
    lines = run("sweep_force_gain.py", tmp_path).splitlines()[1:]
    *stable, last = (line.split() for line in lines)
    for gain, _, promised, found in stable:
        assert float(promised) == pytest.approx(1.0 / (1.0 + float(gain)), abs=1e-3)
        assert float(found) == pytest.approx(float(promised), rel=0.05)
    assert last[0] == "1.10"
    assert "diverged" in last


def test_own_controller_tracks_and_squeezes(tmp_path):
    law, spring = run("own_controller.py", tmp_path).splitlines()
    assert law.startswith("paper's law")
    position, force = (float(spring.split(before)[1].split()[0]) for before in ("position", "force"))
    assert 0.0 < position < 0.5
    assert 0.0 < force < 0.5
