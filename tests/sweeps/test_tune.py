"""Tuning: the best run of the history is returned, the search is reproducible, and nothing is run twice."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
import xarray as xr
from faulty import law
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip("optuna", reason="optuna is not installed (extra 'tune')")

import optuna

import coop_pin as cp
from coop_pin.base.errors import (
    FieldError,
    MissingExtraError,
    NameNotFoundError,
    NothingFeasibleError,
    OutOfRangeError,
    StoreLockedError,
    SweepInterruptedError,
    UnknownFieldError,
)
from coop_pin.cli import main
from coop_pin.sweeps import Sample, session
from coop_pin.sweeps.optimisation import Bound, Objective
from coop_pin.sweeps.optimisation import search as find
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.store import SweepStore

GAIN, SIGN = "controller.gains.pose_gain", "controller.gains.sign_gain"
SHORT = cp.Scenario.load("adept-paper", {"duration": 0.5, "events": []})
PEAK, RMS = "torque_peak_Nm", "moving_internal_shear_rms_N"
RANGES = {GAIN: (0.5, 6.0)}
OPTIONS = {
    "minimize": PEAK,
    "generations": 1,
    "population": 5,
    "execution": cp.Execution(workers=0, quiet=True),
}


@pytest.fixture(scope="module")
def search(tmp_path_factory):
    """A search and its folder."""
    folder = tmp_path_factory.mktemp("search")
    return cp.tune(SHORT, RANGES, out=folder, **OPTIONS), folder


def table(folder):
    return (folder / "table.csv").read_bytes()


# ---------------------------------------------------------------- what is found


def test_the_result_is_the_best_of_its_history_and_within_its_ranges(search):
    found, _ = search
    peaks = found.history.values(PEAK).values
    assert len(found.history.plan) == 10
    assert found.best.metrics[PEAK] == peaks.min() == found.history.best(PEAK)[0].metrics[PEAK]
    tried = found.history.data[GAIN].values
    assert ((tried >= 0.5) & (tried <= 6.0)).all()
    assert len(np.unique(tried)) == 10
    direct = cp.run(SHORT.override({GAIN: found.best.parameters[GAIN]}), warn=False).metrics()[PEAK]
    assert_allclose(found.best.metrics[PEAK], direct, rtol=0, atol=0)


def test_a_search_begins_with_a_hypercube(search):
    """One point in each fifth of the range."""
    first = search[0].history.data[GAIN].values[:5]
    assert_array_equal(np.sort(((first - 0.5) / 5.5 * 5).astype(int)), np.arange(5))


def bowl(points):
    return ((points - [0.3, -1.0]) ** 2).sum(axis=1)


@pytest.mark.parametrize("bound", [None, 0.6])
def test_later_generations_come_closer_to_a_known_minimum(bound):
    """On a bowl, without runs, also where the minimum itself is out of bounds: a > bound is allowed."""
    seen = []

    def evaluate(points):
        points = np.array(points)
        costs = bowl(points)
        excess = np.zeros(len(points)) if bound is None else np.maximum(bound - points[:, 0], 0.0)
        seen.append(np.where(excess > 0.0, np.inf, costs))
        return costs, excess

    ranges = {"a": (-1.0, 1.0), "b": (-2.0, 2.0)}
    find(evaluate, Sample(fields=ranges, count=12, method="latin-hypercube", seed=1), generations=8)
    least = 0.0 if bound is None else (bound - 0.3) ** 2
    assert [len(costs) for costs in seen] == [12] * 9
    assert np.median(seen[-1]) - least < 0.25 * np.median(seen[0][np.isfinite(seen[0])])
    assert min(costs.min() for costs in seen) - least < 0.1


def test_bounds_are_kept_though_runs_outside_have_smaller_metrics(tmp_path, search):
    free, folder = search
    shutil.copytree(folder, tmp_path / "copy")
    bound = float(np.sort(free.history.values(PEAK).values)[4])
    kept = cp.tune(SHORT, RANGES, out=tmp_path / "copy", subject_to=[f"{PEAK}>{bound!r}"], **OPTIONS)
    assert kept.best.metrics[PEAK] >= bound > free.best.metrics[PEAK]


def test_nothing_within_the_bounds_is_an_error_and_the_runs_are_kept(tmp_path, search):
    shutil.copytree(search[1], tmp_path, dirs_exist_ok=True)
    with pytest.raises(NothingFeasibleError, match="none of 10 runs") as caught:
        cp.tune(SHORT, RANGES, out=tmp_path, subject_to=[f"{PEAK}<1e-3"], **OPTIONS)
    assert (caught.value.tried, caught.value.failed, caught.value.folder) == (10, 0, str(tmp_path))
    assert len(list(SweepStore(tmp_path).records())) == 10


def test_where_all_runs_fail_the_error_says_what_the_first_of_them_said(tmp_path):
    wild = SHORT.override(law("raise"))
    with pytest.raises(
        NothingFeasibleError,
        match=r"5 runs \(5 failed\).* the first that failed said: UserCodeError: at t = ",
    ):
        cp.tune(wild, {"cell.payload.mass": (1.0, 2.0)}, out=tmp_path, **OPTIONS | {"generations": 0})


class Table:
    """The part of a SweepResult that an objective reads."""

    def __init__(self, **values):
        self.metric_names = list(values)
        self.plan = SimpleNamespace(shape=np.shape(next(iter(values.values()))))
        self._values = {name: xr.DataArray(value) for name, value in values.items()}

    def values(self, name):
        return self._values[name]


def test_an_objective_tells_feasible_from_infeasible_from_failed_runs():
    runs = Table(small=[5.0, 1.0, 0.5, np.nan, 0.1], bounded=[1.9, 2.0, 3.0, np.nan, 5.0])
    metric, excess = Objective("small", (Bound("bounded", 1, 2.0),)).read(runs)
    assert_array_equal(metric, [5.0, 1.0, 0.5, np.nan, 0.1])
    assert_array_equal(excess, [0.0, 0.0, 0.5, np.inf, 1.5])


def test_an_objective_is_the_mean_over_cases_and_feasible_in_all_of_them():
    runs = Table(small=[[5.0, 1.0, 0.5], [1.0, 1.0, np.nan]], bounded=[[1.0, 3.0, 1.0], [2.0, 1.0, 1.0]])
    metric, excess = Objective("small", (Bound("bounded", 1, 2.0),)).read(runs)
    assert_array_equal(metric, [3.0, 1.0, np.nan])
    assert_array_equal(excess, [0.0, 0.5, np.inf])


def test_a_search_over_cases_finds_what_is_best_on_average(tmp_path):
    cases = {"light": {}, "heavy": {"cell.payload.mass": 4.0}}
    found = cp.tune(SHORT, RANGES, out=tmp_path, cases=cases, **OPTIONS | {"generations": 0})
    peaks = found.history.values(PEAK)
    assert peaks.sizes["case"] == 2
    assert found.value == peaks.values.mean(axis=0).min()
    gain = {GAIN: found.tuned[GAIN]}
    direct = [
        cp.run(SHORT.override(gain | changes), warn=False).metrics()[PEAK] for changes in cases.values()
    ]
    assert found.best.metrics[PEAK] == direct[0] != direct[1]
    assert found.value == np.mean(direct)
    assert found.summary().count(f"{found.value:.6g}") == 1


def test_metrics_of_the_user_s_own_can_be_minimised_and_bounded(tmp_path):
    own = {"minimize": "stiffness", "subject_to": "ticks>1", "metrics": ("faulty:stiffness", "faulty:answer")}
    found = cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS | own | {"generations": 0})
    tried = found.history.data[GAIN].values
    assert found.best.parameters[GAIN] == tried[np.argmin(abs(tried - 3.0))]
    assert "stiffness = " in found.summary()


# ---------------------------------------------------------------- a function of its arguments


def test_the_same_call_computes_nothing_and_a_longer_one_only_what_is_new(tmp_path, search, runs_here):
    first, folder = search
    runs_here.jobs.clear()
    shutil.copytree(folder, tmp_path / "copy")
    again = cp.tune(SHORT, RANGES, out=tmp_path / "copy", **OPTIONS)
    assert not runs_here.jobs
    assert again.history.data.equals(first.history.data)
    longer = cp.tune(SHORT, RANGES, out=tmp_path / "copy", **OPTIONS | {"generations": 2})
    assert len(runs_here.jobs) == 5
    assert_array_equal(longer.history.data[GAIN].values[:10], first.history.data[GAIN].values)
    assert longer.best.metrics[PEAK] <= first.best.metrics[PEAK]


def test_another_seed_is_another_search(tmp_path, search):
    other = cp.tune(SHORT, RANGES, out=tmp_path, seed=1, **OPTIONS)
    assert not np.isin(other.history.data[GAIN].values, search[0].history.data[GAIN].values).any()


@pytest.mark.parametrize("after", [0, 3, 7])
def test_an_interrupted_search_goes_on_to_the_history_of_an_undisturbed_one(
    tmp_path, search, runs_here, after
):
    def interrupted(_job):
        if len(runs_here.jobs) == after:
            raise KeyboardInterrupt

    runs_here.before = interrupted
    with pytest.raises(SweepInterruptedError, match=f"{after} of 10 runs"):
        cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS)
    runs_here.before = lambda _job: None
    tried = 5 * (after // 5 + 1)
    assert SweepResult.load(tmp_path).counts() == {"ok": after, "failed": 0, "missing": tried - after}
    resumed = cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS)
    undisturbed, folder = search
    assert resumed.history.data.identical(undisturbed.history.data)
    assert repr(resumed.best) == repr(undisturbed.best)
    assert table(tmp_path) == table(folder)


@pytest.fixture
def pools(monkeypatch):
    """The pools of local workers that are opened."""
    opened, original = [], session.LocalBackend
    monkeypatch.setattr(session, "LocalBackend", lambda workers: opened.append(workers) or original(workers))
    return opened


@pytest.mark.slow
def test_one_set_of_workers_serves_the_search_and_its_history_is_that_of_one_process(tmp_path, search, pools):
    """Also if they die between generations."""
    undisturbed, folder = search
    original, killed = Objective.read, []

    def read(self, result):
        for child in psutil.Process().children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):  # one that ended by itself meanwhile
                if "--multiprocessing-fork" in " ".join(child.cmdline()):
                    child.kill()
                    killed.append(child.pid)
        return original(self, result)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Objective, "read", read)
        found = cp.tune(
            SHORT, RANGES, out=tmp_path, **OPTIONS | {"execution": cp.Execution(workers=2, quiet=True)}
        )
    assert killed
    assert pools == [2]
    assert found.history.data.identical(undisturbed.history.data)
    assert repr(found.best) == repr(undisturbed.best)
    assert table(tmp_path) == table(folder)


def test_a_search_that_finds_all_its_runs_starts_no_workers(tmp_path, search, pools):
    shutil.copytree(search[1], tmp_path, dirs_exist_ok=True)
    cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS | {"execution": cp.Execution(workers=2, quiet=True)})
    assert pools == []


# ---------------------------------------------------------------- what goes wrong


def test_a_search_holds_its_folder_from_the_first_generation_to_the_last(tmp_path, runs_here):
    def intruded(_job):
        with pytest.raises(StoreLockedError):
            SweepStore(tmp_path).locked().__enter__()

    runs_here.before = intruded
    cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS)
    assert len(runs_here.jobs) == 10


def test_one_bound_may_stand_alone(tmp_path):
    alone = cp.tune(SHORT, RANGES, out=tmp_path / "a", subject_to="torque_peak_Nm<1e6", **OPTIONS)
    listed = cp.tune(SHORT, RANGES, out=tmp_path / "b", subject_to=["torque_peak_Nm<1e6"], **OPTIONS)
    assert repr(alone.best) == repr(listed.best)


def test_mistakes_are_refused_and_nothing_is_written(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(FieldError, match="range"):
        cp.tune(SHORT, {GAIN: (2.0, 1.0)}, out=out, **OPTIONS)
    with pytest.raises(FieldError, match="range"):
        cp.tune(SHORT, {GAIN: (0.0, np.inf)}, out=out, **OPTIONS)
    for ends in ((1.0, 2.0, 3.0), ("low", "high"), 3.0):
        with pytest.raises(FieldError, match="range"):
            cp.tune(SHORT, {GAIN: ends}, out=out, **OPTIONS)
    with pytest.raises(FieldError, match="METRIC<NUMBER"):
        cp.tune(SHORT, RANGES, out=out, subject_to=["fast"], **OPTIONS)
    with pytest.raises(FieldError, match="names no field"):
        cp.tune(SHORT, {}, out=out, **OPTIONS)
    with pytest.raises(OutOfRangeError, match="population"):
        cp.tune(SHORT, RANGES, out=out, **OPTIONS | {"population": 0})
    with pytest.raises(UnknownFieldError, match="pose_gain"):
        cp.tune(SHORT, {"controller.gains.pose_gian": (1.0, 2.0)}, out=out, **OPTIONS)
    assert not out.exists()


def test_a_metric_that_runs_do_not_have_is_refused_with_those_they_have(tmp_path):
    with pytest.raises(NameNotFoundError, match="torque_peak_Nm"):
        cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS | {"minimize": "torque_peak"})


def test_code_that_workers_cannot_import_is_refused_in_the_package_s_own_words(tmp_path):
    mine = SHORT.override({"controller": {"kind": "user", "target": "__main__:Law"}})
    with pytest.raises(FieldError, match="workers cannot import"):
        cp.tune(
            mine,
            {"cell.payload.mass": (1.0, 2.0)},
            out=tmp_path,
            **OPTIONS | {"execution": cp.Execution(workers=1, quiet=True)},
        )


def test_without_optuna_tune_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)  # importing it raises
    with pytest.raises(MissingExtraError, match=r"pip install 'coop-pin\[tune\]'"):
        cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS)


def test_optuna_says_nothing_and_is_left_as_it_was(tmp_path, capfd):
    level = optuna.logging.get_verbosity()
    cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS | {"generations": 0})
    assert capfd.readouterr() == ("", "")
    assert optuna.logging.get_verbosity() == level


def test_bounds_are_read_as_written():
    assert Bound.parse("settling_time_s<2.5") == Bound("settling_time_s", 1, 2.5)
    assert Bound.parse(" a >= -1e-3 ") == Bound("a", -1, -1e-3)
    for text in ("a", "a<", "a<b", "<1", "a<1<2", "a=1", "a<inf", "a>nan"):
        with pytest.raises(FieldError):
            Bound.parse(text)
    assert Bound("a", 1, 10.0).excess(15.0) == 0.5
    assert Bound("a", -1, 0.0).excess(1.0) == 0.0
    assert Bound("a", 1, 1.0).excess(np.nan) == np.inf


# ---------------------------------------------------------------- the command

WORDS = [
    "--minimize",
    PEAK,
    "--subject-to",
    f"{PEAK}<1e6",
    "--vary",
    GAIN,
    "0.5",
    "6",
    "--vary",
    "controller.gains.sign-gain",
    "0",
    "1",
]
SIZE = ["--generations", "0", "--population", "3", "--workers", "0"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    SHORT.save("short.toml")
    return tmp_path


def test_the_command_prints_what_it_found_and_how_to_run_it(folder, capsys):
    assert main(["tune", "short.toml", *WORDS, *SIZE, "--out", "found"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in (GAIN, SIGN, PEAK, "best of 6 runs (0 failed)"))
    best = SweepResult.load(folder / "found").best(PEAK)[0]
    (again,) = [line for line in out.splitlines() if line.startswith("run it: ")]
    gain, sign = (f"--{field} {best.parameters[field]!r}" for field in (GAIN, SIGN))
    assert again == f"run it: coop-pin run short.toml {gain} {sign}"
    assert (folder / "found" / "table.csv").is_file()
    assert main(["tune", "short.toml", *WORDS, *SIZE, "--out", "found", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--vary", GAIN, "3", "1"], "range"),
        ([], "names no field"),
        (["--vary", GAIN, "1", "2", "--vary", "controller.gains.pose-gain", "1", "3"], "has two ranges"),
        (["--vary", "controller.gains.pose_gian", "1", "2"], "did you mean 'pose_gain'"),
    ],
    ids=["empty", "none", "twice", "misspelt"],
)
def test_mistakes_are_one_line_and_an_exit_code(capsys, words, message):
    assert main(["tune", "short.toml", "--minimize", PEAK, *words, *SIZE]) == 2
    said = capsys.readouterr().err
    assert said.startswith("coop-pin: ")
    assert message in said


def test_a_search_that_finds_nothing_fails_and_says_where_its_runs_are(folder, capsys):
    assert main(["tune", "short.toml", *WORDS, "--subject-to", f"{PEAK}<1e-3", *SIZE, "--out", "kept"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("coop-pin: none of 6 runs (0 failed), kept in kept, satisfies ")
    assert SweepResult.load(folder / "kept").counts()["ok"] == 6


@pytest.mark.usefixtures("folder")
def test_a_folder_in_use_is_refused(folder, capsys):
    with SweepStore(folder / "kept").locked():
        assert main(["tune", "short.toml", *WORDS, *SIZE, "--out", "kept"]) == 1
    assert "is in use by process" in capsys.readouterr().err


@pytest.mark.gate
@pytest.mark.parametrize("workers", [pytest.param(0, marks=pytest.mark.slow), 2])
def test_ctrl_c_ends_the_command_with_130_and_says_how_to_go_on(folder, workers):
    words = [
        "tune",
        "short.toml",
        *WORDS,
        "--generations",
        "40",
        "--population",
        "3",
        "--workers",
        str(workers),
        "--engine",
        "pinocchio",
        "--out",
        "kept",
    ]
    process = subprocess.Popen(
        [sys.executable, "-c", "import signal, sys\n"
         "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
         "from coop_pin.cli import main; sys.exit(main())", *words],
        stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    end = time.monotonic() + 120.0
    while len(list(SweepStore(folder / "kept").records())) < 8:  # in the second generation
        assert time.monotonic() < end
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    children = psutil.Process(process.pid).children(recursive=True)
    assert (len(children) > 2) == (workers == 2)
    os.kill(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert psutil.wait_procs(children, timeout=30)[1] == []
    assert process.returncode == 130
    assert "Traceback" not in said
    assert "of 246 runs are kept in kept; go on with: coop-pin tune short.toml" in said
    assert SweepResult.load(folder / "kept").counts()["ok"] >= 8
