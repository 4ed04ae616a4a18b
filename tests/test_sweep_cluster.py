"""Workers: the same bits on every backend, runs that kill or hang their workers, modules and ports."""

import contextlib
import json
import os
import subprocess
import sys
import time
from types import SimpleNamespace

import psutil
import pytest
from faulty import law

import coop_pin as cp
from coop_pin.sweeps import SweepPlan, linspace, sweep

pytest.importorskip("distributed", reason="dask is not installed (extra 'sweep')")

from coop_pin.sweeps import cluster
from coop_pin.sweeps.dask_backend import DaskBackend, run_jobs
from coop_pin.sweeps.job import Job

SHORT = {"duration": 0.25, "events": []}
PLAN = SweepPlan(
    base="adept-paper",
    changes=SHORT,
    axes={
        "controller.gains.sign_gain": linspace(0.0, 0.4, 6),
        "controller.gains.damping_gain": [[60.0, 60.0, 10.0], [3e3, 3e3, 5e2]],
    },
)


def tables(folder):
    return (folder / "table.csv").read_bytes()


@contextlib.contextmanager
def scheduler_elsewhere(folder):
    """A scheduler and a worker in processes of their own, as dask's own commands start them."""
    file = folder / "scheduler.json"
    quiet = {
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
        "env": os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    }
    local = ["--host", "127.0.0.1", "--scheduler-file", str(file), "--no-dashboard"]
    words = [
        ["scheduler", *local, "--port", "0"],
        ["worker", *local, "--nthreads", "1", "--dashboard-address", "127.0.0.1:0"],
    ]
    processes = []
    try:
        for part in words:
            processes.append(subprocess.Popen([sys.executable, "-m", "dask", *part], **quiet))
            while not (file.exists() and file.read_text()):
                time.sleep(0.05)
        yield json.loads(file.read_text())["address"]
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in processes:
            process.wait(timeout=20)


@pytest.fixture(scope="module")
def in_process(tmp_path_factory):
    folder = tmp_path_factory.mktemp("in-process")
    return sweep(PLAN, out=folder, workers=0, quiet=True), tables(folder)


def test_workers_give_the_bits_of_a_single_process(tmp_path, in_process):
    result, table = in_process
    assert sweep(PLAN, out=tmp_path, workers=2, quiet=True).data.identical(result.data)
    assert tables(tmp_path) == table
    assert result.counts() == {"ok": 6, "failed": 6, "missing": 0}


def test_full_results_come_back_from_workers_bit_for_bit(tmp_path, in_process):
    plan = PLAN.replace(keep="all")
    result = sweep(plan, out=tmp_path, workers=1, quiet=True)
    assert result.data.identical(in_process[0].data)
    assert tables(tmp_path) == in_process[1]
    kept = [
        result.store.read_result(result.store.read(path.stem))
        for path in (tmp_path / "results").rglob("*.nc")
    ]
    assert len(kept) == result.counts()["ok"] == 6
    for run in kept:
        assert run.data.identical(cp.run(run.scenario).data)


def test_a_scheduler_elsewhere_gives_the_bits_of_a_single_process(tmp_path, in_process):
    result, table = in_process
    with scheduler_elsewhere(tmp_path) as address:
        assert sweep(PLAN, out=tmp_path / "out", scheduler=address, quiet=True).data.identical(result.data)
    assert tables(tmp_path / "out") == table


KINDS = {
    "exit": "WorkerDiedError",
    "crash": "WorkerDiedError",
    "hang": "RunTimeoutError",
    "raise": "UserCodeError",
    "none": None,
}


@pytest.mark.parametrize(
    "modes",
    [
        ("hang", "exit", "raise", "none"),
        pytest.param(("none", "crash", "hang", "exit") * 2, marks=pytest.mark.slow),
    ],
)
def test_runs_that_hang_exit_or_crash_are_recorded_and_the_rest_goes_on(tmp_path, modes):
    laws = {f"{mode} {i}": law(mode) for i, mode in enumerate(modes)}
    plan = SweepPlan(
        base="adept-paper", changes={"duration": 0.05, "events": []}, cases={"law": laws}, time_limit_s=2.0
    )
    result = sweep(plan, out=tmp_path, workers=2, quiet=True)
    seen = {failure.number: failure.kind for failure in result.failures}
    assert [seen.get(i) for i in range(len(modes))] == [KINDS[mode] for mode in modes]
    assert result.counts()["missing"] == 0


def loaded_modules():
    return sorted(
        {name.split(".")[0] for name in sys.modules}
        | {name for name in sys.modules if name.startswith("coop_pin.")}
    )


def listening(process):
    with contextlib.suppress(psutil.NoSuchProcess):
        return [
            connection.laddr
            for connection in process.net_connections()
            if connection.status == psutil.CONN_LISTEN
        ]
    return []


def test_workers_load_no_viewer_start_lightly_and_nothing_listens_beyond_loopback_or_on_a_web_port():
    me = psutil.Process()
    before = listening(me)
    with cluster.local_cluster(2) as local:
        local.client.wait_for_workers(2, timeout=60)
        jobs = [Job("key", cp.Scenario.load("adept-paper", SHORT).model_dump_json())]
        (outcome,) = local.client.submit(run_jobs, jobs, pure=False).result()
        modules = local.client.run(loaded_modules)
        threads = local.client.run(
            lambda: [os.environ[f"{name}_NUM_THREADS"] for name in ("OMP", "MKL", "OPENBLAS")]
        )
        seconds = local.client.run(lambda: sum(psutil.Process().cpu_times()[:2]))
        processes = [me, *me.children(recursive=True)]
        addresses = [
            address for process in processes for address in listening(process) if address not in before
        ]
        workers = [process for process in processes if "multiprocessing.spawn" in " ".join(process.cmdline())]
    assert outcome.record.failure is None
    assert len(modules) == len(workers) == 2
    for names in modules.values():
        assert {"coop_pin", "pinocchio", "coop_pin.sweeps.job"} <= set(names)
        assert (
            set(names) & {"meshcat", "matplotlib", "trimesh", "zmq", "coop_pin.viz", "tqdm.notebook"} == set()
        )
    assert set(map(tuple, threads.values())) == {("1", "1", "1")}
    assert max(seconds.values()) < 3.0  # processor time, which the load of the machine does not stretch
    assert {address.ip for address in addresses} == {"127.0.0.1"}
    assert len(addresses) == 1 + 2 + 2  # the scheduler, and each worker with its keeper
    _, alive = psutil.wait_procs(processes[1:], timeout=10)
    assert [process for process in alive if process in workers] == []


UP = """
import time
from coop_pin.sweeps import cluster
with cluster.local_cluster(1) as local:
    local.client.wait_for_workers(1)
    print("up", flush=True)
    time.sleep(600)
"""


def test_workers_end_with_their_parent_however_it_ends():
    parent = subprocess.Popen([sys.executable, "-c", UP], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert parent.stdout.readline() == b"up\n"
    children = psutil.Process(parent.pid).children(recursive=True)
    assert len(children) >= 2
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert psutil.wait_procs(children, timeout=30)[1] == []


def test_batches_hold_short_runs_together_and_long_ones_apart():
    backend = DaskBackend(SimpleNamespace(listen=lambda *_: None))
    backend._mean_s = 0.025
    assert backend._batch_size() == 10
    backend._mean_s = 60.0
    assert backend._batch_size() == 1
