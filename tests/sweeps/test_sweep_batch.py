"""Sweeps whose runs are simulated together: the same table, the same errors, the engine in key and record."""

import logging
import sys

import numpy as np
import pytest
from faulty import law

import coop_pin as cp
from coop_pin.base.errors import FieldError
from coop_pin.compiled import engine_choice
from coop_pin.sweeps import engine
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.run_key import keyed_points
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers import batch_job
from coop_pin.sweeps.workers.job import CtrlC, Job

GAINS = {"controller.gains.damping_gain": [40.0, 1e5, 50.0]}
"""The second one diverges."""


def plan(**fields):
    base = cp.Scenario.load("adept-paper").replace(duration=0.1, events=(), beyond_bound=True)
    return SweepPlan(base=base, **{"axes": GAINS, "engine": "compiled"} | fields)


def swept(chosen, folder):
    """The runs of a sweep, and the engine of each."""
    result = cp.sweep(chosen, out=folder, execution=cp.Execution(workers=0, quiet=True))
    engines = {record.key: record.engine for record in SweepStore(folder).records()}
    return [result.point(n) for n in range(len(chosen))], [engines[p.key] for p in keyed_points(result.plan)]


def bits(runs):
    """The metrics as text, in which NaN equals NaN."""
    return [repr(run.metrics) for run in runs]


def test_the_table_of_batches_is_that_of_single_runs_and_errors_are_the_same(tmp_path):
    single, _ = swept(plan(engine="pinocchio"), tmp_path / "single")
    batch, engines = swept(plan(keep=(0,)), tmp_path / "batch")
    assert engines == ["compiled", "pinocchio", "compiled"]
    for found, wanted in zip(batch, single, strict=True):
        assert (found.parameters, found.kind, found.message) == (
            wanted.parameters,
            wanted.kind,
            wanted.message,
        )
        assert found.metrics == pytest.approx(wanted.metrics, rel=1e-9, abs=1e-9, nan_ok=True)
    assert [run.kind for run in batch] == ["", "DivergedError", ""]
    kept = cp.SweepResult.load(tmp_path / "batch").open(0).metrics()
    assert kept == pytest.approx({name: batch[0].metrics[name] for name in kept}, rel=0, abs=0, nan_ok=True)


@pytest.mark.slow
def test_a_finished_batch_is_kept_and_values_that_come_later_are_simulated(tmp_path, monkeypatch):
    simulated, original = [], batch_job.run_batch

    def counted(jobs, *rest):
        simulated.append(len(jobs))
        return original(jobs, *rest)

    monkeypatch.setattr(batch_job, "run_batch", counted)
    gain = "controller.gains.pose_gain"
    first, _ = swept(plan(axes={gain: [5.0, 6.0]}), tmp_path)
    again, _ = swept(plan(axes={gain: [5.0, 6.0]}), tmp_path)
    more, _ = swept(plan(axes={gain: [5.0, 5.5, 6.0]}), tmp_path)
    assert simulated == [2, 1]
    assert bits(again) == bits(more[::2]) == bits(first)


@pytest.mark.slow
def test_what_a_run_gives_does_not_depend_on_the_runs_beside_it(tmp_path):
    axes = {"controller.gains.pose_gain": [5.0, 6.0], "cell.payload.mass": [1.0, 2.0]}
    together, _ = swept(plan(axes=axes), tmp_path / "together")
    batch_job._simulator.__init__()  # as in another process
    (alone,), _ = swept(plan(axes={field: values[1:] for field, values in axes.items()}), tmp_path / "alone")
    assert bits([alone]) == bits(together[3:])
    assert bits([alone]) != bits(together[:1])


@pytest.mark.slow
def test_runs_that_cannot_start_or_be_traced_are_single_and_the_others_are_not(tmp_path):
    runs, engines = swept(plan(axes={"start.xyz": [[0.6, 0.14, 0.0], [5.0, 0.0, 0.0]]}), tmp_path / "far")
    assert engines == ["compiled", "pinocchio"]
    assert [run.kind for run in runs] == ["", "UnreachablePoseError"]
    runs, engines = swept(plan(axes={"plant.payload": ["welded", "free"]}), tmp_path / "free")
    assert engines == ["compiled", "pinocchio"]
    assert [run.kind for run in runs] == ["", ""]


@pytest.fixture
def warned_anew():
    """Warnings that are given once in a process, as if no test before had met them."""
    batch_job._warn_once.cache_clear()


@pytest.mark.usefixtures("warned_anew")
def test_a_law_that_cannot_be_traced_is_not_traced_again_for_the_next_batch(tmp_path, caplog):
    steps = tmp_path / "steps"
    steps.touch()
    jobs = [Job("key", plan(changes=law("raise", marker=str(steps)), axes={}).scenario(0), way="lanes")]
    with caplog.at_level(logging.WARNING):
        assert batch_job.run_batch(jobs) == ["plant"]
    assert "cannot be traced" in caplog.text
    traced = steps.read_text()
    assert batch_job.run_batch(jobs) == ["plant"]
    assert steps.read_text() == traced != ""


@pytest.mark.usefixtures("warned_anew")
@pytest.mark.parametrize(("function", "way"), [("prepare", "plant"), ("run_prepared", "pinocchio")])
def test_why_a_batch_breaks_is_told_once_for_all_its_runs(function, way, monkeypatch, caplog):
    monkeypatch.setattr(batch_job._simulator, function, lambda *_: 1 / 0)
    jobs = [Job("key", scenario, way="lanes") for scenario in map(plan().scenario, range(3))]
    with caplog.at_level(logging.WARNING, "coop_pin.sweeps"):
        assert batch_job.run_batch(jobs) == [way] * 3
    assert len(caplog.records) == 1
    assert "ZeroDivisionError: division by zero" in caplog.text


def test_compiled_code_ends_between_its_parts_when_nobody_waits_and_leaves_the_output_alone():
    """Threads of a sweep share sys.stdout and the lock of batches: both are as before, also after Ctrl-C."""
    jobs, outputs = [Job("key", plan(axes={}).scenario(0), way="lanes")], []
    (outcome,) = batch_job.run_batch(jobs, lambda: outputs.append(sys.stdout))
    assert outcome is not None
    assert set(outputs) == {sys.stdout}
    with pytest.raises(CtrlC):
        batch_job.run_batch(jobs, lambda: True)
    assert not batch_job.IN_PYTHON.locked()


def test_a_run_that_cannot_start_tells_it_in_its_own_record_only(caplog):
    far = plan(changes={"start.xyz": [5.0, 0.0, 0.0]}, axes={}).scenario(0)
    with caplog.at_level(logging.WARNING, "coop_pin.sweeps"):
        assert batch_job.run_batch([Job("key", far, way="lanes")]) == ["plant"]
    assert not caplog.records


# ---------------------------------------------------------------- the choice


def test_auto_weighs_runs_against_compiling_and_a_folder_keeps_its_engine(tmp_path, caplog):
    """0.1 s at 80 Hz are 8 ticks; six joints are worth 1500."""
    store, axes = SweepStore(tmp_path), {"controller.gains.damping_gain": list(np.linspace(40.0, 50.0, 188))}
    many, few = plan(engine="auto", axes=axes), plan(engine="auto")
    assert engine_choice.runs_worth_a_batch(many.scenario(0)) == len(many)
    with caplog.at_level(logging.WARNING):
        assert [engine.with_engine(each, store).engine for each in (many, few)] == ["compiled", "pinocchio"]
        assert engine.with_engine(few, store, runs=188).engine == "compiled"
    assert not caplog.records
    store.write_plan(few.replace(engine="pinocchio"))
    assert engine.with_engine(many, store).engine == "pinocchio"
    assert engine.with_engine(many.replace(engine="compiled"), store).engine == "compiled"


def test_a_sweep_that_began_with_single_runs_goes_on_with_them(tmp_path, caplog):
    """One run by its name; the choice for the two runs of the longer plan would be to compile."""
    base = cp.Scenario.load("adept-paper").replace(duration=10.0, events=())
    again = SweepPlan(base=base, axes={"controller.gains.sign_gain": [0.1, 0.2]})
    assert engine.with_engine(again, SweepStore(tmp_path / "new")).engine == "compiled"
    swept(again.replace(axes={"controller.gains.sign_gain": [0.1]}, engine="pinocchio"), tmp_path)
    runs, engines = swept(again, tmp_path)
    assert engines == ["pinocchio", "pinocchio"]
    assert [run.kind for run in runs] == ["", ""]
    assert cp.SweepResult.load(tmp_path).counts() == {"ok": 2, "failed": 0, "missing": 0}
    assert not caplog.records
    assert SweepStore(tmp_path).read_plan().engine == "pinocchio"


@pytest.mark.parametrize(
    ("name", "duration", "runs"),
    [("adept-anchored", 2.0, 10), ("two-pandas-box", 2.0, 4), ("five-joint-pair", 2.0, 3)],
)
def test_runs_that_are_worth_compiling(name, duration, runs):
    """They are those of benchmarks/README.md; two more check a user's law."""
    scenario = cp.Scenario.load(name).replace(duration=duration, events=())
    assert engine_choice.runs_worth_a_batch(scenario) == runs
    users = scenario.override(law("none"))
    assert engine_choice.runs_worth_a_batch(users) == runs + 2


def test_scenarios_that_differ_in_numbers_times_and_events_are_counted_together():
    base = cp.Scenario.load("adept-anchored").replace(events=())  # 20 s, 1600 ticks: one run is enough
    short = base.replace(duration=0.5)  # 40 ticks: 38 are
    biased = [short.override({"cell.payload.mass": mass}) for mass in np.linspace(5.0, 8.0, 30)]
    heavy = [{"kind": "payload-change", "time": 0.2, "mass": 9.0}]
    others = [short.override(changes) for changes in ({"duration": 0.6}, {"events": heavy})] * 3
    noisy = [short.override({"sensors.encoder.noise": 1e-5})] * 30  # other code
    found = engine_choice.choose_engines([*biased, *others, *noisy], "auto", [1] * 66)
    assert {each.engine for each in found} == {"pinocchio"}  # 30 + 3 + 3.6 runs
    found = engine_choice.choose_engines([*biased, *others, *noisy], "auto", [1] * 31 + [2] * 5 + [1] * 30)
    assert [each.engine for each in found] == 36 * ["compiled"] + 30 * ["pinocchio"]
    assert {each.obstacle for each in found} == {None, "few runs"}
    assert engine_choice.choose_engines([base, *noisy], "auto", [1] * 31)[0].engine == "compiled"


@pytest.mark.parametrize("changes", [{}, law("none")], ids=["plant", "user"])
def test_the_reason_why_runs_are_single_is_told(changes, tmp_path, caplog):
    wanted = plan(changes=changes | {"plant.payload": "free"}, axes={})
    with caplog.at_level(logging.WARNING):
        assert engine.with_engine(wanted.replace(engine="auto"), SweepStore(tmp_path)).engine == "pinocchio"
    assert "free" in caplog.text
    with pytest.raises(FieldError, match="free") as caught:
        engine.with_engine(wanted, SweepStore(tmp_path))
    assert caught.value.path == "engine"


@pytest.mark.parametrize("mode", ["raise", "SystemExit", "KeyboardInterrupt"])
def test_a_users_code_is_not_traced_by_the_process_that_chooses_and_fails_in_its_own_run(mode, tmp_path):
    wanted = plan(changes=law(mode), axes={})
    assert engine.with_engine(wanted, SweepStore(tmp_path)).engine == "compiled"
    (run,), engines = swept(wanted, tmp_path)
    assert engines == ["pinocchio"]
    assert run.kind == {"KeyboardInterrupt": mode}.get(mode, "UserCodeError")
    (single,), _ = swept(wanted.replace(engine="pinocchio"), tmp_path / "single")
    assert run.message == single.message
    assert ("faulty.py:" in run.message) == (mode != "KeyboardInterrupt")


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
def test_options_that_the_users_code_changes_are_those_of_its_own_run(engine, tmp_path):
    options = {"kind": "user", "target": "faulty:Forgetful", "options": {"torques": [0.3, 0.2, 0.1, 0.0] * 9}}
    wanted = plan(changes={"controller": options}, axes={"cell.payload.mass": [1.0, 1.0, 1.0]}, engine=engine)
    first, *others = swept(wanted, tmp_path)[0]
    assert first.kind == ""
    assert bits(others) == bits([first, first])
    assert wanted.scenario(0).controller.options["torques"][-1] == 0.0


def test_keys_of_single_runs_do_not_name_an_engine_and_those_of_batches_do():
    keys = {
        name: [point.key for point in keyed_points(plan(engine=name))] for name in ("pinocchio", "compiled")
    }
    assert keys["pinocchio"][0] == cp.sweeps.run_key.run_key(plan().scenario(0))
    assert len({*keys["pinocchio"], *keys["compiled"]}) == 6


@pytest.mark.slow
def test_workers_simulate_batches_with_the_bits_of_this_process(tmp_path):
    axes = {"controller.gains.pose_gain": list(np.linspace(5.0, 9.0, 150))}
    here, _ = swept(plan(axes=axes), tmp_path / "here")
    there = cp.sweep(plan(axes=axes), out=tmp_path / "there", execution=cp.Execution(workers=2, quiet=True))
    assert bits([there.point(n) for n in range(150)]) == bits(here)


@pytest.mark.parametrize(
    ("limits", "failure"), [({"time_limit_s": 1e-4}, "RunTimeoutError"), ({"memory_limit_gb": 1e-5}, "")]
)
def test_limits_hold_for_batches_whose_runs_are_then_single(limits, failure, tmp_path, caplog):
    """Of memory only in workers; in this process a single run has no limit."""
    chosen = plan(axes={"controller.gains.damping_gain": [40.0, 50.0]}, **limits)
    result = cp.sweep(chosen, out=tmp_path, execution=cp.Execution(workers=0, quiet=True))
    assert result.table["failure"].tolist() == [failure] * 2
    assert "compiled" not in {record.engine for record in SweepStore(tmp_path).records()}
    assert next(iter(limits)) in caplog.text
