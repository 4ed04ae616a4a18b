"""Tuning: what it returns is the best of what it tried, it is a function of its arguments, and nothing is run twice."""

import shutil

import numpy as np
import pytest
from faulty import law
from numpy.testing import assert_allclose, assert_array_equal

import coop_pin as cp
import coop_pin.sweeps.engine as engine
from coop_pin.cli import main
from coop_pin.errors import EntryNotFoundError, FieldError, NothingFeasibleError
from coop_pin.sweeps.tune import Bound, tune

GAIN, SIGN = "controller.gains.pose_gain", "controller.gains.sign_gain"
SHORT = cp.Scenario.load("adept-paper", {"duration": 0.5, "events": []})
PEAK, RMS = "torque_peak_Nm", "internal_shear_rms_N"
RANGES = {GAIN: (0.5, 6.0)}
OPTIONS = {"minimize": PEAK, "generations": 1, "population": 5, "workers": 0, "quiet": True}


@pytest.fixture
def counted(monkeypatch):
    """Numbers of runs that were really computed."""
    runs = []
    original = engine.run_job
    monkeypatch.setattr(engine, "run_job", lambda job: runs.append(job.key) or original(job))
    return runs


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A search, and its folder."""
    folder = tmp_path_factory.mktemp("tuned")
    return tune(SHORT, RANGES, out=folder, **OPTIONS), folder


def test_the_result_is_the_best_of_its_history_and_within_its_ranges(found):
    found, _ = found
    peaks = found.history.values(PEAK).values
    assert len(found.history.plan) == 10
    assert found.best.metrics[PEAK] == peaks.min() == found.history.best(PEAK)[0].metrics[PEAK]
    tried = found.history.data[GAIN].values
    assert ((tried >= 0.5) & (tried <= 6.0)).all()
    direct = cp.run(SHORT.override({GAIN: found.best.parameters[GAIN]})).metrics()[PEAK]
    assert_allclose(found.best.metrics[PEAK], direct, rtol=0, atol=0)


def test_the_same_call_computes_nothing_and_a_longer_one_only_what_is_new(tmp_path, found, counted):
    first, folder = found
    shutil.copytree(folder, tmp_path / "copy")
    again = tune(SHORT, RANGES, out=tmp_path / "copy", **OPTIONS)
    assert not counted
    assert again.history.data.equals(first.history.data)
    longer = tune(SHORT, RANGES, out=tmp_path / "copy", **OPTIONS | {"generations": 2})
    assert len(counted) == 5
    assert_array_equal(longer.history.data[GAIN].values[:10], first.history.data[GAIN].values)
    assert longer.best.metrics[PEAK] <= first.best.metrics[PEAK]


def test_bounds_are_kept_though_runs_outside_have_smaller_metrics(tmp_path, found):
    free, folder = found
    shutil.copytree(folder, tmp_path / "copy")
    bound = float(np.sort(free.history.values(PEAK).values)[4])
    kept = tune(SHORT, RANGES, out=tmp_path / "copy", subject_to=[f"{PEAK}>{bound!r}"], **OPTIONS)
    assert kept.best.metrics[PEAK] >= bound > free.best.metrics[PEAK]


def test_nothing_within_the_bounds_is_an_error_and_the_runs_are_kept(tmp_path, found):
    shutil.copytree(found[1], tmp_path, dirs_exist_ok=True)
    with pytest.raises(NothingFeasibleError, match="none of 10 runs") as caught:
        tune(SHORT, RANGES, out=tmp_path, subject_to=[f"{PEAK}<1e-3"], **OPTIONS)
    assert (caught.value.tried, caught.value.failed) == (10, 0)
    assert len(list((tmp_path / "runs").rglob("*.json"))) == 10


def test_failed_runs_are_the_worst(tmp_path):
    wild = SHORT.override(law("raise"))
    with pytest.raises(NothingFeasibleError, match=r"5 runs \(5 failed\)"):
        tune(wild, {"cell.payload.mass": (1.0, 2.0)}, out=tmp_path, **OPTIONS | {"generations": 0})


def test_mistakes_are_refused(tmp_path):
    with pytest.raises(FieldError, match="lower and a higher"):
        tune(SHORT, {GAIN: (2.0, 1.0)}, out=tmp_path, **OPTIONS)
    with pytest.raises(FieldError, match="METRIC<NUMBER"):
        tune(SHORT, RANGES, out=tmp_path, subject_to=["fast"], **OPTIONS)
    with pytest.raises(EntryNotFoundError, match="nonsense"):
        tune(SHORT, RANGES, out=tmp_path, **OPTIONS | {"minimize": "nonsense"})


def test_bounds_are_read_as_written():
    assert Bound.parse("settling_time_s<2.5") == Bound("settling_time_s", 1, 2.5)
    assert Bound.parse(" a >= -1e-3 ") == Bound("a", -1, -1e-3)
    for text in ("a", "a<", "a<b", "<1", "a<1<2", "a=1"):
        with pytest.raises(FieldError):
            Bound.parse(text)
    assert Bound("a", 1, 10.0).excess(15.0) == 0.5
    assert Bound("a", -1, 0.0).excess(1.0) == 0.0
    assert Bound("a", 1, 1.0).excess(np.nan) == np.inf


def test_the_command_prints_what_it_found(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    SHORT.save("short.toml")
    words = ["--minimize", PEAK, "--subject-to", f"{PEAK}<1e6", "--vary", GAIN, "0.5", "6", SIGN, "0", "1"]
    size = ["--generations", "0", "--population", "3", "--workers", "0", "--quiet", "--out", "found"]
    assert main(["tune", "short.toml", *words, *size]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in (GAIN, SIGN, PEAK))
    assert (tmp_path / "found" / "table.csv").is_file()
    assert main(["tune", "short.toml", *words[:2], "--vary", GAIN, "3", "1", *size]) == 2
