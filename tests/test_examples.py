"""Every example runs as a user runs it, in a folder of its own, and shows what it promises."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_shows_what_it_promises(path, tmp_path):
    done = subprocess.run([sys.executable, str(path)], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert done.stdout
    PROMISES.get(path.stem, lambda _out, _folder: None)(done.stdout, tmp_path)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_says_what_it_shows(path):
    assert ast.get_docstring(ast.parse(path.read_text()))


def metrics_and_files(out, folder):
    assert "settling_time_s" in out
    assert sorted(path.name for path in (folder / "out" / "run_paper").iterdir()) == ["replay.html", "result.nc"]


def static_factor_and_bound(out, _folder):
    *stable, last = (line.split() for line in out.splitlines()[1:])
    for gain, _, promised, found in stable:
        assert float(promised) == pytest.approx(1.0 / (1.0 + float(gain)), abs=1e-3)
        assert float(found) == pytest.approx(float(promised), rel=0.05)
    assert last[0] == "1.10"
    assert "diverged" in last


def tracking_and_squeeze(out, _folder):
    law, spring = out.splitlines()
    assert law.startswith("paper's law")
    position, force = (float(spring.split(before)[1].split()[0]) for before in ("position", "force"))
    assert 0.0 < position < 0.5
    assert 0.0 < force < 0.5


PROMISES = {"run_paper": metrics_and_files, "sweep_force_gain": static_factor_and_bound, "own_controller": tracking_and_squeeze}


def test_the_examples_with_promises_exist():
    assert set(PROMISES) <= {path.stem for path in EXAMPLES}


def test_stability_map_finds_the_bound_of_a_late_force_path(tmp_path):
    pytest.importorskip("distributed", reason="dask is not installed (extra 'sweep')")
    boundary = run("stability_map.py", tmp_path).split("last_stable")[1].splitlines()[2:]
    assert [line.split() for line in boundary] == [["80", "1.0", "1.25"], ["160", "1.0", "1.25"]]
    assert (tmp_path / "out" / "stability" / "table.csv").is_file()
