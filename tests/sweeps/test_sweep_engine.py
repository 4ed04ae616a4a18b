"""Sweeps in one process: runs are stored once, resumed, and repeated only after damage or a changed plan."""

import csv
import gc
import json
import logging
import signal
import subprocess
import sys

import numpy as np
import pytest
from faulty import law
from numpy.testing import assert_array_equal

import coop_pin as cp
from coop_pin.base.errors import (
    FieldError,
    FileReadError,
    ScenarioError,
    StoreLockedError,
    SweepInterruptedError,
)
from coop_pin.sweeps.engine import sweep
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.run_key import keyed_points
from coop_pin.sweeps.session import open_session
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers.execution import Execution
from coop_pin.sweeps.workers.job import Job, checked_content, checksummed, run_job

GAIN, DAMPING = "controller.gains.sign_gain", "controller.gains.damping_gain"
SHORT = {"duration": 0.1, "events": []}


@pytest.fixture
def computed(runs_here):
    """Jobs that were computed, not read."""
    return runs_here.jobs


def small(out, axes=None, **fields):
    return sweep(
        "adept-paper",
        axes or {GAIN: [0.0, 0.1, 0.2]},
        out=out,
        execution=cp.Execution(workers=0, quiet=True),
        changes=SHORT,
        **fields,
    )


def records(folder):
    return {record.key: record.to_line() for record in SweepStore(folder).records()}


# ---------------------------------------------------------------- what is computed


def test_tables_are_written_while_the_folder_is_locked(monkeypatch, tmp_path):
    """Otherwise the next session, which cleans up, may take a half-written table away."""
    write, refused = SweepResult.write_tables, []

    def checked(result):
        with pytest.raises(StoreLockedError), SweepStore(tmp_path).locked():
            pass
        refused.append(True)
        write(result)

    monkeypatch.setattr(SweepResult, "write_tables", checked)
    small(tmp_path)
    assert refused == [True]


def test_metrics_are_those_of_single_runs(tmp_path):
    result = small(tmp_path)
    for gain, found in zip((0.0, 0.1, 0.2), result.values("torque_peak_Nm").values, strict=True):
        assert found == cp.run("adept-paper", SHORT | {GAIN: gain}, warn=False).metrics()["torque_peak_Nm"]
    assert result.counts() == {"ok": 3, "failed": 0, "missing": 0}
    assert_array_equal(result.data[GAIN], [0.0, 0.1, 0.2])


def test_a_second_call_computes_nothing_and_says_the_same(tmp_path, computed):
    first = small(tmp_path)
    kept, table = records(tmp_path), (tmp_path / "table.csv").read_bytes()
    second = small(tmp_path)
    assert len(computed) == 3
    assert records(tmp_path) == kept
    assert (tmp_path / "table.csv").read_bytes() == table
    assert second.data.identical(first.data)


def test_a_changed_plan_computes_what_is_new(tmp_path, computed):
    small(tmp_path)
    result = small(tmp_path, {GAIN: [0.2, 0.3, 0.0]})
    assert len(computed) == 4
    assert result.counts()["ok"] == 3
    assert len(records(tmp_path)) == 4


def test_equal_points_are_computed_once(tmp_path, computed):
    result = small(tmp_path, {GAIN: [0.1, 0.1, 0.1]})
    assert len(computed) == 1
    assert result.counts()["ok"] == 3


WAYS = [(0, "pinocchio"), (2, "pinocchio"), (0, "compiled"), (2, "compiled")]
QUICK_WAYS = [
    WAYS[0],
    WAYS[3],
    *(pytest.param(*way, marks=pytest.mark.slow) for way in (WAYS[1], WAYS[2])),
]
"""Ways of which two run in the default tier: each number of workers, each engine."""


@pytest.mark.parametrize(("workers", "chosen"), QUICK_WAYS)
def test_an_equal_point_that_is_kept_has_its_full_result(tmp_path, workers, chosen):
    plan = SweepPlan(
        base="adept-paper", changes=SHORT, axes={GAIN: [0.1, 0.1, 0.2]}, engine=chosen, keep=(1,)
    )
    result = sweep(plan, out=tmp_path, execution=Execution(workers=workers, quiet=True))
    keys = result.table["key"]
    assert [result.store.read_result(key) is not None for key in keys] == [True, True, False]


def test_a_session_that_ends_draws_no_points_any_more(tmp_path):
    plan = SweepPlan(base="adept-paper", changes=SHORT, axes={GAIN: [0.1, 0.2]}, engine="pinocchio")
    with open_session(tmp_path, Execution(workers=0, quiet=True), len(plan)) as session:
        session.store.write_plan(plan)
        session.compute(plan)
        jobs = session._jobs(plan.replace(axes={GAIN: [0.3, 0.4, 0.5]}), False, set(), [])
        assert next(jobs).changes[GAIN] == 0.3
    assert list(jobs) == []


@pytest.mark.parametrize(("workers", "chosen"), QUICK_WAYS)
def test_equal_points_are_counted_like_others(tmp_path, workers, chosen):
    plan = SweepPlan(base="adept-paper", changes=SHORT, axes={DAMPING: [1e5, 40.0, 40.0, 1e5]}, engine=chosen)
    with open_session(tmp_path, Execution(workers=workers, quiet=True), len(plan)) as session:
        session.store.write_plan(plan)
        session.compute(plan)
        assert (session.bar.finished, session.bar.failed) == (4, 2)
        assert session.result(plan).counts() == {"ok": 2, "failed": 2, "missing": 0}


def test_a_damaged_record_is_set_aside_and_computed_again(tmp_path, computed):
    before = small(tmp_path).data
    (segment,) = (tmp_path / "runs").iterdir()
    content = segment.read_bytes()
    segment.write_bytes(content.replace(b"torque_peak_Nm", b"torque_peak_nm", 1))
    assert SweepResult.load(tmp_path).counts()["missing"] == 1
    assert small(tmp_path).data.identical(before)
    assert len(computed) == 4
    (aside,) = (tmp_path / "quarantine").iterdir()
    assert aside.read_bytes() in segment.read_bytes()


def test_interrupted_runs_are_kept_and_counted(tmp_path, runs_here, computed):
    def interrupted(_job):
        if len(computed) == 2:
            raise KeyboardInterrupt

    runs_here.before = interrupted
    with pytest.raises(SweepInterruptedError, match="2 of 3 runs") as stopped:
        small(tmp_path)
    runs_here.before = lambda _job: None
    assert (stopped.value.finished, stopped.value.total) == (2, 3)
    assert SweepResult.load(tmp_path).counts() == {"ok": 2, "failed": 0, "missing": 1}
    small(tmp_path)
    assert len(computed) == 3


def test_users_metrics_stand_beside_ours(tmp_path):
    result = small(tmp_path, metrics=("faulty:answer",))
    assert_array_equal(result.values("answer"), [42.0, 42.0, 42.0])
    assert_array_equal(result.values("ticks"), [9.0, 9.0, 9.0])


@pytest.mark.parametrize(("varied", "name"), [("answer", "answer"), ("law", "number"), ("law", "wall_s")])
def test_a_metric_with_the_name_of_a_varied_field_or_a_column_is_refused_by_name(
    tmp_path, computed, varied, name
):
    """After the first run, and nothing of it is stored."""
    given = {"cases": {varied: {"a": {}, "b": {GAIN: 0.2}}}, "metrics": (f"faulty:{name}",)}
    with pytest.raises(FieldError, match=f"metrics: .*'{name}'"):
        small(tmp_path, {"clock.rate_hz": [100.0]}, **given)
    assert len(computed) == 1
    assert records(tmp_path) == {}


# ---------------------------------------------------------------- what fails


def test_failures_are_recorded_with_reason_and_parameters_and_the_rest_goes_on(tmp_path):
    wild = {DAMPING: [3e3, 3e3, 5e2]}
    nowhere = {"controller": {"kind": "user", "target": "nowhere:Law"}}
    cases = {"law": {"wild": wild, "broken": law("raise"), "paper": {}, "nowhere": nowhere}}
    result = small(tmp_path, {"clock.rate_hz": [80.0]}, cases=cases)
    assert {f.parameters["law"]: f.kind for f in result.failures} == {
        "wild": "DivergedError",
        "broken": "UserCodeError",
        "nowhere": "NameNotFoundError",
    }
    assert [f.number for f in result.failures] == [0, 1, 3]
    assert result.counts() == {"ok": 1, "failed": 3, "missing": 0}
    assert np.isfinite(result.data["failed_at_s"].values[0])
    assert_array_equal(
        result.data["simulation_sound"], np.array([0.0, 0.0, 1.0, 0.0]).reshape(result.plan.shape)
    )
    with (tmp_path / "table.csv").open() as file:
        assert [line["simulation_sound"] for line in csv.DictReader(file)] == ["0.0", "0.0", "1.0", "0.0"]


def test_values_that_a_scenario_refuses_are_failures_and_are_not_tried(tmp_path, computed):
    result = small(tmp_path, {GAIN: [0.1, -1.0, 0.2]})
    small(tmp_path, {GAIN: [0.1, -1.0, 0.2]})
    assert len(computed) == 2
    (failure,) = result.failures
    assert failure.number == 1
    assert "sign_gain" in failure.message
    assert_array_equal(result.data["status"], ["ok", "failed", "ok"])


def test_a_run_beyond_its_time_limit_is_given_up_and_tried_again_on_request(tmp_path, computed):
    plan = SweepPlan(base="adept-paper", changes=SHORT | law("slow"), time_limit_s=0.12)
    options = {"out": tmp_path, "execution": cp.Execution(workers=0, quiet=True)}
    (failure,) = sweep(plan, **options).failures
    assert failure.kind == "RunTimeoutError"
    sweep(plan, **options)
    assert len(computed) == 1
    sweep(plan.replace(time_limit_s=60.0), retry_failed=True, **options)
    assert len(computed) == 2
    assert SweepResult.load(tmp_path).counts()["ok"] == 1


def test_a_job_answers_whatever_its_run_raises():
    for mode, kind in (("raise", "UserCodeError"), ("none", "")):
        scenario = cp.Scenario.load("adept-paper", SHORT | law(mode))
        assert run_job(Job("key", scenario)).record.failure == kind


@pytest.mark.parametrize(
    ("mode", "kind"), [("SystemExit", "UserCodeError"), ("KeyboardInterrupt", "KeyboardInterrupt")]
)
def test_user_code_that_wants_to_end_the_program_ends_its_run(tmp_path, mode, kind):
    """And what it prints stays out of our output."""
    cases = {"law": {"wild": law(mode), "tame": law("none")}}
    result = small(tmp_path, {"clock.rate_hz": [80.0]}, cases=cases)
    assert [(f.number, f.kind) for f in result.failures] == [(0, kind)]
    assert result.counts() == {"ok": 1, "failed": 1, "missing": 0}


def test_what_user_code_prints_stays_out_of_our_output(tmp_path, capsys):
    small(tmp_path, {"clock.rate_hz": [80.0]}, metrics=("faulty:loud",))
    said = capsys.readouterr()
    assert said.out == ""
    assert "printed by a metric" in said.err


def test_ctrl_c_in_user_code_ends_the_sweep_and_is_no_failure_of_its_run(tmp_path):
    cases = {"law": {"first": law("none"), "second": law("ctrl-c")}}
    with pytest.raises(SweepInterruptedError) as stopped:
        small(tmp_path, {"clock.rate_hz": [80.0]}, cases=cases)
    assert stopped.value.finished == 1
    assert SweepResult.load(tmp_path).counts() == {"ok": 1, "failed": 0, "missing": 1}
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_code_that_workers_cannot_import_is_refused_before_anything_runs(tmp_path):
    with pytest.raises(FieldError, match="workers cannot import"):
        sweep("adept-paper", out=tmp_path, execution=cp.Execution(workers=1), metrics=("__main__:mine",))


# ---------------------------------------------------------------- what is kept


def test_kept_runs_are_read_and_others_computed_with_the_same_numbers(tmp_path):
    result = small(tmp_path, keep=[1])
    assert len(list((tmp_path / "results").rglob("*.nc"))) == 1
    fresh = cp.run("adept-paper", SHORT | {GAIN: 0.2}, warn=False).data
    assert result.open(2).data.equals(fresh)
    kept = [result.store.read_result(key) is not None for key in result.table.key]
    assert kept == [False, True, False]
    assert result.open(1).scenario == result.plan.scenario(1)
    assert result.open(1).metrics()["torque_peak_Nm"] == result.values("torque_peak_Nm").values[1]


def test_a_damaged_kept_run_is_computed_again(tmp_path, computed):
    small(tmp_path, keep="all")
    path = sorted((tmp_path / "results").rglob("*.nc"))[0]
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    path.write_bytes(content)
    result = small(tmp_path, keep="all")
    assert len(computed) == 4
    assert result.store.read_result(path.stem) is not None


def test_asking_for_full_results_later_computes_them(tmp_path, computed):
    small(tmp_path)
    small(tmp_path, keep="all")
    assert len(computed) == 6
    small(tmp_path, keep="all")
    assert len(computed) == 6


def test_tables_have_a_line_for_each_run_and_times_stand_apart(tmp_path):
    result = small(tmp_path)
    with (tmp_path / "table.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [float(line[GAIN]) for line in lines] == [0.0, 0.1, 0.2]
    assert [float(line["torque_peak_Nm"]) for line in lines] == result.values(
        "torque_peak_Nm"
    ).values.tolist()
    assert not any("wall" in name for name in lines[0])
    with (tmp_path / "times.csv").open(newline="") as file:
        assert all(float(line["wall_s"]) > 0.0 for line in csv.DictReader(file))
    assert b"\r" not in (tmp_path / "times.csv").read_bytes() + (tmp_path / "table.csv").read_bytes()
    again = SweepResult.load(tmp_path)
    assert again.plan == result.plan
    assert again.data.identical(result.data)


def test_garbage_collection_is_as_before_after_a_sweep(tmp_path):
    with open_session(tmp_path, Execution(workers=0, quiet=True), 1):
        assert gc.get_freeze_count() > 10_000
    assert gc.get_freeze_count() == 0


def test_stored_runs_that_cannot_be_read_are_told(tmp_path, computed, caplog):
    """Their checksums hold, so that they are not damaged: another version has written them."""
    small(tmp_path)
    (segment,) = (tmp_path / "runs").iterdir()
    first, *others = filter(None, segment.read_bytes().splitlines())
    content = json.loads(checked_content(first)) | {"wall_s": "soon"}
    segment.write_bytes(b"\n".join([checksummed(json.dumps(content).encode()), *others]))
    with caplog.at_level(logging.WARNING):
        assert small(tmp_path).counts() == {"ok": 2, "failed": 0, "missing": 1}
    assert len(computed) == 3
    assert [message for message in caplog.messages if message.startswith("1 stored runs")]


def test_a_folder_without_a_sweep_is_refused(tmp_path):
    with pytest.raises(FileReadError, match="holds no sweep"):
        SweepResult.load(tmp_path)


def test_nothing_but_files_of_the_sweep_is_in_its_folder(tmp_path):
    small(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        "lock",
        "plan.json",
        "runs",
        "table.csv",
        "table.nc",
        "tables.json",
        "times.csv",
    }
    assert (tmp_path / "lock").read_text() == ""
    assert not np.any([path.name.startswith(".") for path in tmp_path.rglob("*")])


WITHOUT_DASK = """
import sys
sys.modules["distributed"] = sys.modules["dask"] = None  # importing it raises from here on
from coop_pin.base.errors import MissingExtraError
from coop_pin import Execution, sweep
short = {"duration": 0.1, "events": []}
here = Execution(workers=0, quiet=True)
assert sweep("adept-paper", out="here", execution=here, changes=short).counts()["ok"] == 1
try:
    there = Execution(scheduler="tcp://127.0.0.1:9", quiet=True)
    sweep("adept-paper", {"clock.rate_hz": [100]}, out="here", execution=there)
except MissingExtraError as error:
    print(error)
"""


@pytest.mark.gate
def test_without_dask_sweeps_work_and_a_scheduler_says_what_to_install(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_DASK],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert "pip install 'coop-pin[sweep]'" in done.stdout


def test_a_run_that_is_missing_has_an_empty_line_in_the_tables(tmp_path):
    plan, store = small(tmp_path).plan, SweepStore(tmp_path)
    key = [each.key for each in keyed_points(plan)][1]
    (segment,) = (tmp_path / "runs").iterdir()
    lines = [line for line in segment.read_bytes().splitlines() if key.encode() not in line]
    segment.write_bytes(b"\n".join(lines))
    result = SweepResult(plan, store)
    result.write_tables()
    with (tmp_path / "table.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["status"] for line in lines] == ["ok", "missing", "ok"]
    empty = dict.fromkeys(("failure", "message", "failed_at_s", "merged", *result.metric_names), "")
    assert lines[1] == {"number": "1", GAIN: "0.1", "status": "missing", **empty, "key": key}
    assert np.isnan(result.data["torque_peak_Nm"]).values.tolist() == [False, True, False]


def test_a_mistake_that_all_runs_have_is_told_before_the_first_and_leaves_no_folder(tmp_path):
    """An event after the end: in all runs; a sweep that searches for the limit has runs within it."""
    axes = {"controller.gains.sign_gain": [0.1, 0.2]}
    late = {"changes": {"duration": 6.0}}
    with pytest.raises(ScenarioError) as caught:
        sweep("adept-anchored", axes, out=tmp_path / "late", execution=cp.Execution(workers=0), **late)
    assert {problem.path for problem in caught.value.problems} == {"events.0.time", "events.1.time"}
    assert not (tmp_path / "late").exists()
    small(tmp_path / "mixed", {"clock.steps_per_tick": [0, 1]})
    assert [len(record.failure) > 0 for record in SweepStore(tmp_path / "mixed").records()].count(True) == 1
