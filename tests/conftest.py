"""What all tests share."""

import gc
import os
import signal
import sys

import pytest
from built_once import top_folder
from matplotlib import get_cachedir

# A shell starts background jobs with Ctrl-C ignored, and children inherit that; several tests send it to
# children.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Bytecode is kept, as in tools/gate.sh: tests start hundreds of processes, and compiling is half an import.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


def pytest_collection_modifyitems(items):
    """What the gate adds takes longest: it comes first, and short tests keep all workers busy at the end."""
    items.sort(key=lambda item: item.get_closest_marker("gate") is None)


def pytest_collection_finish():
    """Leave modules and tests, which live as long as the process, out of each later search for garbage."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def cache(tmp_path_factory):
    """Compiled code is kept in a folder of the tests' own, which all workers of a test run share.

    Matplotlib keeps its own: to build its list of fonts anew takes seconds.
    """
    folder = top_folder(tmp_path_factory) / "cache"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MPLCONFIGDIR", get_cachedir())
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield


@pytest.fixture(autouse=True)
def brief_code(request, monkeypatch):
    """By default LLVM chooses registers as for single runs: a fraction of the time, and the same bits.

    What the gate runs, and what is slow, has the code that batches have.
    """
    if not any(map(request.node.get_closest_marker, ("gate", "slow"))):
        monkeypatch.setattr("coop_pin.tracing.llvm_machine.LASTING", 0)


class RunsHere:
    """The jobs that this process has simulated one by one, and what is done before each."""

    def __init__(self):
        self.jobs, self.before = [], lambda _job: None


@pytest.fixture
def runs_here(monkeypatch):
    """Runs of sweeps, searches and comparisons that are computed in this process, not read."""
    from coop_pin.sweeps.workers import backend

    runs, compute = RunsHere(), backend.run_job

    def counted(job):
        runs.before(job)
        runs.jobs.append(job)
        return compute(job)

    monkeypatch.setattr(backend, "run_job", counted)
    return runs


@pytest.fixture
def control_groups(monkeypatch, tmp_path):
    """A function that puts this process into listed control groups, and returns the folder of them all."""
    from coop_pin.base import memory

    def put(listed):
        path = tmp_path / "system" / "proc" / "self" / "cgroup"
        path.parent.mkdir(parents=True)
        path.write_text(listed + "\n")
        monkeypatch.setattr(memory, "_SYSTEM", tmp_path / "system")
        return tmp_path / "system" / "sys" / "fs" / "cgroup"

    return put


@pytest.fixture
def leave_free(control_groups):
    """A function that lets the control group of this process leave a number of bytes free, once."""

    def leave(free):
        group = control_groups("0::/job") / "job"
        group.mkdir(parents=True)
        for name, text in (("max", free), ("current", 0), ("stat", "inactive_file 0")):
            (group / f"memory.{name}").write_text(f"{text}\n")

    return leave


@pytest.fixture
def observe_together(monkeypatch):
    """A function that sets how many samples of a run are observed, and thinned, together."""
    return lambda count: monkeypatch.setattr("coop_pin.simulation.recorder._BLOCK", count)
