"""Fault drill of benchmarks/drill.py: short here, long in the slow tier."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def drill(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    import drill

    return drill


@pytest.mark.gate
def test_a_short_drill_loses_nothing(drill, tmp_path):
    assert drill.run_drill(tmp_path, 1, runs=16, seed=1, kinds=("kill",)) == {"kill": 1}


@pytest.mark.slow
def test_a_drill_of_two_sweeps_at_once_and_of_workers_loses_nothing(drill, tmp_path):
    """Ctrl-C is part of the round with two at once, which no lock keeps apart."""
    kinds = ("lock-removed", "kill-worker")
    assert drill.run_drill(tmp_path, len(kinds), runs=24, seed=1, kinds=kinds) == dict.fromkeys(kinds, 1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_hundred_and_ten_faults_lose_nothing(drill, tmp_path, seed):
    """About ten minutes for each seed on two idle processors; a disk of its own needs the right to mount."""
    done = drill.run_drill(tmp_path, 110, runs=60, seed=seed)
    assert done.total() == 110
    assert min(done.values()) >= 7
