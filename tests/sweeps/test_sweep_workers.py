"""Local workers: the same bits in every process, runs that kill or hang their workers, ports."""

import contextlib
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest
from faulty import law

import coop_pin as cp
from coop_pin.base.errors import CodeChangedError, FieldError, WorkerDiedError, WorkersLostError
from coop_pin.sweeps import linspace
from coop_pin.sweeps.engine import sweep
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.workers import backend
from coop_pin.sweeps.workers.backend import LocalBackend, Worker, outcomes
from coop_pin.sweeps.workers.batch_job import IN_PYTHON
from coop_pin.sweeps.workers.job import Job, JobRecord, Outcome

PLAN = SweepPlan(
    base="adept-paper",
    changes={"duration": 0.1, "events": [], "sensors.encoder.noise": 1e-6, "actuators.missed_ticks": 0.1},
    repeats=2,
    axes={
        "controller.gains.sign_gain": linspace(0.0, 0.4, 3),
        "controller.gains.damping_gain": [[60.0, 60.0, 10.0], [3e4, 3e4, 5e3]],
    },
    keep="all",
)


def tables(folder):
    return (folder / "table.csv").read_bytes()


@pytest.fixture(scope="module")
def in_process(tmp_path_factory):
    folder = tmp_path_factory.mktemp("in-process")
    return sweep(PLAN, out=folder, execution=cp.Execution(workers=0, quiet=True)), tables(folder)


def descendants(mark="", process=None):
    """Descendants of a process, of this one when omitted, with a word in their command lines."""
    found = []
    for child in (process or psutil.Process()).children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            if mark in " ".join(child.cmdline()):
                found.append(child)
    return found


def workers_of(process=None):
    return descendants("--multiprocessing-fork", process)


def wait_until(found, seconds=60.0):
    end = time.monotonic() + seconds
    while not (value := found()):
        assert time.monotonic() < end
        time.sleep(0.02)
    return value


class Watcher(threading.Thread):
    """Looks at the processes of a sweep while it runs."""

    def __init__(self):
        super().__init__()
        self.me, self.seen, self.listening, self.done = psutil.Process(), set(), set(), threading.Event()
        self.before = self.ports(self.me)

    @staticmethod
    def ports(process):
        with contextlib.suppress(psutil.NoSuchProcess):
            return {c.laddr for c in process.net_connections(kind="all") if c.status == psutil.CONN_LISTEN}
        return set()

    def run(self):
        while not self.done.wait(0.05):
            for process in (self.me, *descendants()):
                self.seen.add(process.pid)
                self.listening |= self.ports(process) - self.before


@pytest.mark.parametrize("workers", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 4))])
def test_workers_give_the_bits_of_a_single_process_and_listen_nowhere(tmp_path, in_process, workers):
    """Full results, of runs that finish and that diverge, included; noise is that of each run's seed."""
    result, table = in_process
    watcher = Watcher()
    watcher.start()
    found = sweep(PLAN, out=tmp_path, execution=cp.Execution(workers=workers, quiet=True))
    watcher.done.set()
    watcher.join()
    assert found.data.identical(result.data)
    assert tables(tmp_path) == table
    assert result.counts() == {"ok": 6, "failed": 6, "missing": 0}
    peaks = result.data["torque_peak_Nm"].values[:, 0]
    assert (peaks[:, 0] != peaks[:, 1]).all()
    for number in (0, 1, 4):
        key = found.table["key"][number]
        assert found.store.read_result(key).data.identical(result.store.read_result(key).data)
    assert len(watcher.seen) > 1 + workers
    assert watcher.listening == set()
    assert descendants("coop_pin") == []


KINDS = {
    "exit": "WorkerDiedError",
    "crash": "WorkerDiedError",
    "hang": "RunTimeoutError",
    "raise": "UserCodeError",
    "SystemExit": "UserCodeError",
    "KeyboardInterrupt": "KeyboardInterrupt",
    "memory": "MemoryError",
    "none": None,
}


@pytest.mark.parametrize(
    "modes",
    [
        ("exit", "none"),
        pytest.param(("hang", "exit", "memory", "none"), marks=pytest.mark.slow),
        pytest.param(tuple(KINDS) * 2, marks=pytest.mark.slow),
    ],
)
def test_runs_that_hang_exit_crash_or_eat_memory_are_recorded_and_the_rest_goes_on(tmp_path, modes):
    laws = {f"{mode} {i}": law(mode) for i, mode in enumerate(modes)}
    plan = SweepPlan(
        base="adept-paper", changes={"duration": 0.05, "events": []}, cases={"law": laws}, time_limit_s=1.5
    )
    result = sweep(plan, out=tmp_path, execution=cp.Execution(workers=2, quiet=True))
    seen = {failure.number: failure.kind for failure in result.failures}
    assert [seen.get(i) for i in range(len(modes))] == [KINDS[mode] for mode in modes]
    assert result.counts()["missing"] == 0
    assert result.table["message"][modes.index("exit")] == str(WorkerDiedError(3, 3))


def job(mode, **limits):
    scenario = cp.Scenario.load("adept-paper", {"duration": 0.05, "events": []} | law(mode))
    return Job(mode, scenario, **limits)


def computed(pool, *jobs):
    found = [outcome.record for batch in outcomes(pool, iter(jobs)) for outcome in batch]
    return {record.key: record.failure or None for record in found}


@contextlib.contextmanager
def meanwhile(action):
    thread = threading.Thread(target=action)
    thread.start()
    yield
    thread.join()


@pytest.mark.gate
def test_workers_that_are_stopped_or_killed_at_any_time_and_a_host_that_is_killed_are_replaced():
    """Also while they start, and between two runs; no run is lost or recorded as failed."""
    with contextlib.closing(LocalBackend(1)) as pool:
        with meanwhile(lambda: wait_until(workers_of)[0].kill()):  # starting
            assert computed(pool, job("none")) == {"none": None}
        (worker,) = workers_of()
        assert loaded(worker) == {"pinocchio"}
        with pytest.raises(CodeChangedError):
            computed(pool, job("none", code=(("faulty:Faulty", ("other",)),)))
        assert {worker.environ()[f"{name}_NUM_THREADS"] for name in ("OMP", "MKL", "OPENBLAS")} == {"1"}
        worker.kill()  # idle
        assert computed(pool, job("none")) == {"none": None}
        (host,), old = descendants("worker_host"), workers_of()
        host.kill()
        assert computed(pool, job("none")) == {"none": None}
        assert psutil.wait_procs(old, timeout=10)[1] == []
        processes = descendants()
    assert psutil.wait_procs(processes, timeout=10)[1] == []


@pytest.mark.gate
def test_the_runs_of_a_batch_whose_worker_dies_are_tried_again_each_alone():
    """A run that costs three workers has failed; the others of its batch have not."""
    modes = {"a": "none", "b": "crash", "c": "none"}
    batch = [Job(key, job(mode).scenario) for key, mode in modes.items()]
    with contextlib.closing(Worker()) as worker:
        found = [outcome.record for outcome in worker.compute(batch)]
    assert [(record.key, record.failure) for record in found] == [
        ("a", ""),
        ("b", "WorkerDiedError"),
        ("c", ""),
    ]
    assert found[1].message == str(WorkerDiedError(3, -11))


@pytest.mark.gate
def test_a_thread_that_turns_to_another_sweep_closes_its_own_worker_only():
    """As in a dask worker that serves two sweeps at once."""
    before = {worker.pid for worker in workers_of()}

    def alive_after(thread, sweep):
        thread.submit(backend.run_in_thread, sweep, [job("none")]).result()
        return alive()

    def alive():
        return {worker.pid for worker in workers_of()} - before

    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(1) as other:
        (first,) = alive_after(one, "a")
        (second,) = alive_after(other, "a") - {first}
        assert alive_after(one, "a") == {first, second}
        (third,) = alive_after(one, "b") - {second}
        assert third != first
        backend.close_workers("a")
        assert alive() == {third}
        backend.close_workers("b")
        assert alive() == set()


@pytest.mark.parametrize(("wall_s", "largest"), [(0.001, 64), (0.05, 5), (2.0, 1)])
def test_short_runs_travel_in_batches_of_a_quarter_of_a_second(wall_s, largest):
    batches = []

    class Here:
        def slots(self):
            return 2

        def submit(self, batch):
            batches.append(len(batch))
            future = Future()
            future.set_result([Outcome(JobRecord(job.key, wall_s=wall_s)) for job in batch])
            return future

    jobs = (Job(str(i), "{}") for i in range(2000))
    found = [outcome.record.key for batch in outcomes(Here(), jobs) for outcome in batch]
    assert sorted(found, key=int) == [str(i) for i in range(2000)]
    assert batches[0] == 1
    assert max(batches) == largest


def batch_jobs(count):
    """Jobs of batches of 256 runs, and a note of each that is drawn."""
    drawn, scenario = [], cp.Scenario.load("adept-paper", {"duration": 0.1, "events": []})

    def jobs():
        for i in range(count):
            drawn.append(i)
            yield Job(str(i), scenario, way="lanes")

    return drawn, jobs()


def test_threads_draw_batches_by_themselves_and_at_most_two_each_beyond_what_is_taken(monkeypatch):
    monkeypatch.setattr(backend, "_batch_here", lambda batch, _: [[Outcome(JobRecord(j.key)) for j in batch]])
    drawn, jobs = batch_jobs(4000)
    with contextlib.closing(LocalBackend(2)) as pool, contextlib.closing(pool.outcomes(jobs)) as found:
        taken = next(found)
        time.sleep(0.2)
        assert len(drawn) <= (4 + 1) * 256
        keys = [outcome.record.key for batch in (taken, *found) for outcome in batch]
    assert sorted(keys, key=int) == [str(i) for i in range(4000)]


def test_no_jobs_have_no_outcomes():
    with contextlib.closing(LocalBackend(2)) as pool:
        assert list(pool.outcomes(iter([]))) == []


def test_threads_that_wait_for_a_batch_draw_none_after_the_end():
    drawn, jobs = batch_jobs(4000)
    pool = LocalBackend(2)
    with IN_PYTHON:
        under_way = [pool._threads.submit(pool._drawn, jobs) for _ in range(2)]
        wait_until(lambda: all(future.running() for future in under_way))
        pool.close()
    assert [future.result() for future in under_way] == [[], []]
    assert drawn == []


def test_an_error_of_a_plan_is_raised_when_a_thread_draws_it():
    def jobs():
        yield from batch_jobs(300)[1]
        raise FieldError("is wrong", "plan")

    with contextlib.closing(LocalBackend(2)) as pool, pytest.raises(FieldError):
        list(pool.outcomes(jobs()))


def loaded(worker):
    """Packages whose shared libraries a process has mapped."""
    return {name for name in ("pinocchio", "meshcat", "matplotlib", "zmq") if any(
        name in region.path for region in worker.memory_maps())}  # fmt: skip


def test_a_host_that_cannot_start_is_a_typed_error(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with contextlib.closing(LocalBackend(1)) as pool, pytest.raises(WorkersLostError, match="exit code 1"):
        computed(pool, job("none"))


UP = """
import contextlib, sys
sys.path[:0] = FOLDERS
from test_sweep_workers import LocalBackend, computed, job
with contextlib.closing(LocalBackend(1)) as pool:
    print("up", flush=True)
    computed(pool, job("hang"))
"""


def test_workers_end_with_their_parent_however_it_ends():
    here = Path(__file__).parent
    code = UP.replace("FOLDERS", repr([str(here), str(here.parent)]))
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert parent.stdout.readline() == b"up\n"
    process = psutil.Process(parent.pid)
    wait_until(lambda: workers_of(process))[0].suspend()
    children = descendants("", process)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert psutil.wait_procs(children, timeout=30)[1] == []


@pytest.mark.slow
def test_a_worker_stopped_for_ever_is_killed_at_its_time_limit_and_its_run_repeated(tmp_path):
    laws = {"stops": law("stop once", marker=str(tmp_path / "stopped")), "runs": law("none")}
    plan = SweepPlan(
        base="adept-paper", changes={"duration": 0.05, "events": []}, cases={"law": laws}, time_limit_s=1.0
    )
    result = sweep(plan, out=tmp_path / "out", execution=cp.Execution(workers=1, quiet=True))
    assert (tmp_path / "stopped").exists()
    assert result.failures == []
    assert result.counts() == {"ok": 2, "failed": 0, "missing": 0}
