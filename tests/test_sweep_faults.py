"""Fault drill of benchmarks/drill.py: short here, long in the slow tier."""

from pathlib import Path

import pytest

from coop_pin.cli import main
from coop_pin.sweeps import backend

pytest.importorskip("distributed", reason="dask is not installed (extra 'sweep')")

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def drill(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    import drill

    return drill


def test_a_short_drill_loses_nothing(drill, tmp_path):
    """Ctrl-C is part of the round with two at once; test_sweep_cluster.py has workers that die."""
    kinds = ("kill", "second", "flip-bits", "file-size")
    assert drill.run_drill(tmp_path, len(kinds), runs=32, seed=1, kinds=kinds) == dict.fromkeys(kinds, 1)


@pytest.mark.slow
def test_a_hundred_faults_lose_nothing(drill, tmp_path):
    done = drill.run_drill(tmp_path, 110, runs=200, seed=2)
    assert done.total() >= 100


def test_the_second_command_on_a_finished_sweep_computes_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sweep.toml").write_text(
        'base = "adept-paper"\nchanges = { duration = 0.1, events = [] }\n'
        'axes = { "clock.rate_hz" = [80, 100] }\n'
    )
    words = ["sweep", "sweep.toml", "--out", "kept", "--workers", "0"]
    assert main(words) == 0
    first = capsys.readouterr().out
    monkeypatch.setattr(backend, "run_job", lambda job: pytest.fail(f"{job.key} is computed again"))
    assert main(words) == 0
    assert capsys.readouterr().out == first
    assert "2 ok, 0 failed, 0 missing" in first
