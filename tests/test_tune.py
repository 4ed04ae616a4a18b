"""Tuning: the best run of the history is returned, the search is reproducible, and nothing is run twice."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest
import xarray as xr
from faulty import law
from numpy.testing import assert_allclose, assert_array_equal
from test_sweep_cluster import scheduler_elsewhere

import coop_pin as cp
from coop_pin.cli import main
from coop_pin.errors import (
    FieldError,
    NameNotFoundError,
    NothingFeasibleError,
    OutOfRangeError,
    StoreLockedError,
    SweepInterruptedError,
    UnknownFieldError,
    WorkersLostError,
)
from coop_pin.sweeps import SweepResult, backend
from coop_pin.sweeps.search import Budget, first_generation
from coop_pin.sweeps.store import FolderLock
from coop_pin.sweeps.tuner import Bound, Objective

GAIN, SIGN = "controller.gains.pose_gain", "controller.gains.sign_gain"
SHORT = cp.Scenario.load("adept-paper", {"duration": 0.5, "events": []})
PEAK, RMS = "torque_peak_Nm", "internal_shear_rms_N"
RANGES = {GAIN: (0.5, 6.0)}
OPTIONS = {"minimize": PEAK, "generations": 1, "population": 5, "workers": 0, "quiet": True}
METHODS = ("evolution", "optuna")


@pytest.fixture(params=METHODS)
def method(request):
    """Every way of searching."""
    if request.param == "optuna":
        pytest.importorskip("optuna", reason="optuna is not installed (extra 'tune')")
    return request.param


@pytest.fixture
def counted(monkeypatch):
    """Numbers of runs that were really computed."""
    runs = []
    original = backend.run_job
    monkeypatch.setattr(backend, "run_job", lambda job: runs.append(job.key) or original(job))
    return runs


@pytest.fixture(scope="module")
def searches(tmp_path_factory):
    """One search for each method, and its folder, made when asked for."""
    known = {}

    def search(method):
        if method not in known:
            folder = tmp_path_factory.mktemp(method)
            known[method] = cp.tune(SHORT, RANGES, out=folder, method=method, **OPTIONS), folder
        return known[method]

    return search


def table(folder):
    return (folder / "table.csv").read_bytes()


# ---------------------------------------------------------------- what is found


def test_the_result_is_the_best_of_its_history_and_within_its_ranges(searches, method):
    found, _ = searches(method)
    peaks = found.history.values(PEAK).values
    assert len(found.history.plan) == 10
    assert found.best.metrics[PEAK] == peaks.min() == found.history.best(PEAK)[0].metrics[PEAK]
    tried = found.history.data[GAIN].values
    assert ((tried >= 0.5) & (tried <= 6.0)).all()
    assert len(np.unique(tried)) == 10
    direct = cp.run(SHORT.override({GAIN: found.best.parameters[GAIN]})).metrics()[PEAK]
    assert_allclose(found.best.metrics[PEAK], direct, rtol=0, atol=0)


def test_every_search_begins_with_the_same_hypercube(searches, method):
    """One point in each fifth of the range."""
    first = searches(method)[0].history.data[GAIN].values[:5]
    assert_allclose(first, first_generation(RANGES, Budget.of(1, 5, 1, 0))[:, 0], rtol=0, atol=1e-12)
    assert_array_equal(np.sort(((first - 0.5) / 5.5 * 5).astype(int)), np.arange(5))


def test_later_generations_come_closer_to_a_known_minimum(method):
    """On a bowl, without runs: the mean cost of the last generation is far below that of the first."""
    from coop_pin.sweeps.tuner import _SEARCHES

    seen = []

    def bowl(points):
        seen.append(((points - [0.3, -1.0]) ** 2).sum(axis=1))
        return seen[-1]

    budget = Budget.of(8, 6, 2, seed=1)
    _SEARCHES[method](bowl, {"a": (-1.0, 1.0), "b": (-2.0, 2.0)}, budget)
    assert [len(costs) for costs in seen] == [budget.size] * 9
    assert budget.runs == sum(map(len, seen))
    assert seen[-1].mean() < 0.25 * seen[0].mean()
    assert min(costs.min() for costs in seen) < 0.5 * seen[0].min()


def test_bounds_are_kept_though_runs_outside_have_smaller_metrics(tmp_path, searches):
    free, folder = searches("evolution")
    shutil.copytree(folder, tmp_path / "copy")
    bound = float(np.sort(free.history.values(PEAK).values)[4])
    kept = cp.tune(SHORT, RANGES, out=tmp_path / "copy", subject_to=[f"{PEAK}>{bound!r}"], **OPTIONS)
    assert kept.best.metrics[PEAK] >= bound > free.best.metrics[PEAK]


def test_nothing_within_the_bounds_is_an_error_and_the_runs_are_kept(tmp_path, searches):
    shutil.copytree(searches("evolution")[1], tmp_path, dirs_exist_ok=True)
    with pytest.raises(NothingFeasibleError, match="none of 10 runs") as caught:
        cp.tune(SHORT, RANGES, out=tmp_path, subject_to=[f"{PEAK}<1e-3"], **OPTIONS)
    assert (caught.value.tried, caught.value.failed, caught.value.folder) == (10, 0, str(tmp_path))
    assert len(list((tmp_path / "runs").rglob("*.json"))) == 10


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
        self.metric_names, self.plan = list(values), range(len(next(iter(values.values()))))
        self._values = {name: xr.DataArray(value) for name, value in values.items()}

    def values(self, name):
        return self._values[name]


def test_costs_rank_feasible_before_infeasible_before_failed_runs():
    runs = Table(small=[5.0, 1.0, 0.5, np.nan, 0.1], bounded=[1.9, 2.0, 3.0, np.nan, 5.0])
    objective = Objective("small", (Bound("bounded", 1, 2.0),))
    costs = objective.costs(runs)
    assert_array_equal(np.argsort(costs), [1, 0, 2, 4, 3])
    assert_array_equal(costs[:2], [5.0, 1.0])
    assert [objective.is_feasible(cost) for cost in costs] == [True, True, False, False, False]


# ---------------------------------------------------------------- a function of its arguments


def test_the_same_call_computes_nothing_and_a_longer_one_only_what_is_new(
    tmp_path, searches, counted, method
):
    first, folder = searches(method)
    counted.clear()
    shutil.copytree(folder, tmp_path / "copy")
    again = cp.tune(SHORT, RANGES, out=tmp_path / "copy", method=method, **OPTIONS)
    assert not counted
    assert again.history.data.equals(first.history.data)
    longer = cp.tune(SHORT, RANGES, out=tmp_path / "copy", method=method, **OPTIONS | {"generations": 2})
    assert len(counted) == 5
    assert_array_equal(longer.history.data[GAIN].values[:10], first.history.data[GAIN].values)
    assert longer.best.metrics[PEAK] <= first.best.metrics[PEAK]


def test_another_seed_is_another_search(tmp_path, searches, method):
    other = cp.tune(SHORT, RANGES, out=tmp_path, method=method, seed=1, **OPTIONS)
    assert not np.isin(other.history.data[GAIN].values, searches(method)[0].history.data[GAIN].values).any()


@pytest.mark.parametrize("after", [0, 3, 7])
def test_an_interrupted_search_goes_on_to_the_history_of_an_undisturbed_one(
    tmp_path, searches, monkeypatch, method, after
):
    computed, original = [], backend.run_job

    def interrupted(job):
        if len(computed) == after:
            raise KeyboardInterrupt
        computed.append(job.key)
        return original(job)

    with monkeypatch.context() as patched:
        patched.setattr(backend, "run_job", interrupted)
        with pytest.raises(SweepInterruptedError, match=f"{after} of 10 runs"):
            cp.tune(SHORT, RANGES, out=tmp_path, method=method, **OPTIONS)
    tried = 5 * (after // 5 + 1)
    assert SweepResult.load(tmp_path).counts() == {"ok": after, "failed": 0, "missing": tried - after}
    resumed = cp.tune(SHORT, RANGES, out=tmp_path, method=method, **OPTIONS)
    undisturbed, folder = searches(method)
    assert resumed.history.data.identical(undisturbed.history.data)
    assert repr(resumed.best) == repr(undisturbed.best)
    assert table(tmp_path) == table(folder)


@pytest.fixture
def clusters(monkeypatch):
    """The clusters that are opened."""
    cluster = pytest.importorskip("coop_pin.sweeps.cluster", reason="dask is not installed (extra 'sweep')")
    opened = []
    for name in ("local_cluster", "remote_cluster"):
        original = getattr(cluster, name)
        monkeypatch.setattr(
            cluster, name, lambda option, original=original: opened.append(option) or original(option)
        )
    return opened


@pytest.mark.parametrize("workers", [1, 2])
def test_one_set_of_workers_serves_the_search_and_its_history_is_that_of_one_process(
    tmp_path, searches, clusters, workers
):
    found = cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS | {"workers": workers})
    undisturbed, folder = searches("evolution")
    assert clusters == [workers]
    assert found.history.data.identical(undisturbed.history.data)
    assert table(tmp_path) == table(folder)


def test_a_scheduler_elsewhere_serves_the_search_and_its_death_is_a_typed_error_and_loses_nothing(
    tmp_path, searches, clusters, monkeypatch
):
    """It dies between the generations of the second search."""
    undisturbed, folder = searches("evolution")
    original = Objective.costs
    with contextlib.ExitStack() as stack:
        address = stack.enter_context(scheduler_elsewhere(tmp_path))
        found = cp.tune(SHORT, RANGES, out=tmp_path / "out", scheduler=address, **OPTIONS)
        assert clusters == [address]
        assert repr(found.best) == repr(undisturbed.best)
        assert table(tmp_path / "out") == table(folder)

        def last_costs(self, result):
            stack.close()
            return original(self, result)

        monkeypatch.setattr(Objective, "costs", last_costs)
        with pytest.raises(WorkersLostError, match="finished runs are kept"):
            cp.tune(SHORT, RANGES, out=tmp_path / "cut", scheduler=address, **OPTIONS)
    assert SweepResult.load(tmp_path / "cut").counts() == {"ok": 5, "failed": 0, "missing": 5}


def test_a_search_that_finds_all_its_runs_starts_no_workers(tmp_path, searches, clusters):
    shutil.copytree(searches("evolution")[1], tmp_path, dirs_exist_ok=True)
    cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS | {"workers": 2})
    assert clusters == []


# ---------------------------------------------------------------- what goes wrong


def test_a_search_holds_its_folder_from_the_first_generation_to_the_last(tmp_path, monkeypatch):
    original, refused = backend.run_job, []

    def intruded(job):
        with pytest.raises(StoreLockedError):
            FolderLock(tmp_path).__enter__()
        refused.append(job.key)
        return original(job)

    monkeypatch.setattr(backend, "run_job", intruded)
    cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS)
    assert len(refused) == 10


def test_workers_that_die_between_generations_are_replaced_and_the_history_stays(
    tmp_path, searches, monkeypatch, clusters
):
    original, killed = Objective.costs, []

    def costs(self, result):
        for child in psutil.Process().children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):  # one that ended by itself meanwhile
                if "multiprocessing.spawn" in " ".join(child.cmdline()):
                    child.kill()
                    killed.append(child.pid)
        return original(self, result)

    monkeypatch.setattr(Objective, "costs", costs)
    found = cp.tune(SHORT, RANGES, out=tmp_path, **OPTIONS | {"workers": 1})
    assert killed
    assert clusters == [1]
    assert repr(found.best) == repr(searches("evolution")[0].best)
    assert table(tmp_path) == table(searches("evolution")[1])


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
    with pytest.raises(FieldError, match="one of evolution, optuna"):
        cp.tune(SHORT, RANGES, out=out, method="guess", **OPTIONS)
    with pytest.raises(UnknownFieldError, match="pose_gain"):
        cp.tune(SHORT, {"controller.gains.pose_gian": (1.0, 2.0)}, out=out, **OPTIONS)
    assert not out.exists()


def test_a_metric_that_runs_do_not_have_is_refused_with_those_they_have(tmp_path, method):
    with pytest.raises(NameNotFoundError, match="torque_peak_Nm"):
        cp.tune(SHORT, RANGES, out=tmp_path, method=method, **OPTIONS | {"minimize": "torque_peak"})


def test_code_that_workers_cannot_import_is_refused_in_the_package_s_own_words(tmp_path):
    """Not as a mistake in the arguments of scipy, which wraps every ValueError."""
    mine = SHORT.override({"controller": {"kind": "user", "target": "__main__:Law"}})
    with pytest.raises(FieldError, match="workers cannot import"):
        cp.tune(mine, {"cell.payload.mass": (1.0, 2.0)}, out=tmp_path, **OPTIONS | {"workers": 1})


WITHOUT_OPTUNA = """
import sys
sys.modules["optuna"] = None  # importing it raises from here on
import coop_pin as cp
options = {"minimize": "torque_peak_Nm", "generations": 0, "population": 5}
options |= {"out": "here", "workers": 0, "quiet": True}
short = cp.Scenario.load("adept-paper", {"duration": 0.1, "events": []})
assert len(cp.tune(short, {"controller.gains.pose_gain": (1.0, 2.0)}, **options).history.plan) == 5
try:
    cp.tune(short, {"controller.gains.pose_gain": (1.0, 2.0)}, method="optuna", **options)
except cp.CoopPinError as error:
    print(type(error).__name__, error)
"""


def test_without_optuna_evolution_works_and_optuna_says_what_to_install(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_OPTUNA],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert done.stdout.startswith("MissingExtraError optuna is not installed")
    assert "pip install 'coop-pin[tune]'" in done.stdout


def test_optuna_says_nothing_and_is_left_as_it_was(tmp_path, capfd):
    optuna = pytest.importorskip("optuna", reason="optuna is not installed (extra 'tune')")
    level = optuna.logging.get_verbosity()
    cp.tune(SHORT, RANGES, out=tmp_path, method="optuna", **OPTIONS | {"generations": 0})
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
    with FolderLock(folder / "kept"):
        assert main(["tune", "short.toml", *WORDS, *SIZE, "--out", "kept"]) == 1
    assert "is in use by process" in capsys.readouterr().err


@pytest.mark.parametrize("workers", [0, 2])
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
        "--out",
        "kept",
    ]
    process = subprocess.Popen(
        [sys.executable, "-c", "import signal, sys\n"
         "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
         "from coop_pin.cli import main; sys.exit(main())", *words],
        stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    kept = folder / "kept" / "runs"
    end = time.monotonic() + 120.0
    while len(list(kept.rglob("*.json"))) < 8:  # in the second generation
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
