"""Fault drill of benchmarks/drill.py: short here, long in the slow tier."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="dask is not installed (extra 'sweep')")

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def drill(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    import drill

    return drill


def test_a_short_drill_loses_nothing(drill, tmp_path):
    """Ctrl-C is part of the round with two at once."""
    kinds = ("kill", "second", "flip-bits", "file-size", "kill-worker")
    assert drill.run_drill(tmp_path, len(kinds), runs=60, seed=1, kinds=kinds) == dict.fromkeys(kinds, 1)


@pytest.mark.slow
def test_a_hundred_faults_lose_nothing(drill, tmp_path):
    done = drill.run_drill(tmp_path, 110, runs=200, seed=2)
    assert done.total() >= 100


def test_the_second_command_on_a_finished_sweep_computes_nothing(tmp_path):
    (tmp_path / "sweep.toml").write_text(
        'base = "adept-paper"\nchanges = { duration = 0.1, events = [] }\n'
        'axes = { "clock.rate_hz" = [80, 100] }\n'
    )
    words = [sys.executable, "-m", "coop_pin", "sweep", "sweep.toml", "--out", "kept", "--workers", "0"]
    said = [
        subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120).stdout
        for _ in range(2)
    ]
    assert said[0] == said[1]
    assert "2 ok, 0 failed, 0 missing" in said[0]
