"""Fault drill: faults are injected into a sweep at random times, and it must lose nothing.

    python benchmarks/drill.py [--faults 110] [--runs 400] [--seed 0]

Each round runs ``coop-pin sweep`` on one folder and injects a fault: it kills a worker, at work or while it
starts, the host of the workers, the process itself or a remote dask scheduler, stops a worker for ever, sends
Ctrl-C, starts a second sweep, also after removing the lock by hand, adds runs that end their process or eat
memory, limits the size of files, fills the disk (a small one in memory, if this user may mount it), flips
bits in stored files, or adds foreign files, pipes among them. After every round each run that was finished
before is still stored with the same numbers, but for one for each bit that the round flipped. The final table
is that of an undisturbed sweep, byte for byte.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import psutil

from coop_pin import Execution, SweepPlan, SweepResult, sweep
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers.job import JobRecord

HERE = ("kill", "interrupt", "second", "lock-removed", "file-size", "flip-bits", "foreign")
"""Faults of a sweep in one process, which starts faster than workers."""
FAULTS = (
    *HERE,
    "kill-worker",
    "kill-start",
    "kill-host",
    "kill-both",
    "kill-scheduler",
    "stop-worker",
    "rogue-runs",
    "full-disk",
)
OK, FAILED, INTERRUPTED = 0, 1, 130
WORKER = "--multiprocessing-fork"
_PATIENCE_S = 240.0

PLAN = """
base = "adept-paper"
time_limit_s = 6.0
engine = "{engine}"
changes = {{ duration = 0.25, events = [] }}
[axes]
# the last diverges
"controller.gains.damping_gain" = [[60.0, 60.0, 10.0], [50.0, 50.0, 9.0], [40.0, 40.0, 8.0], [3e3, 3e3, 5e2]]
"controller.gains.sign_gain" = {{ linspace = [0.0, 0.4, {count}] }}
"""

ROGUES = """
base = "adept-paper"
changes = { duration = 0.25, events = [] }
memory_limit_gb = 0.5
axes = { "clock.rate_hz" = [80.0, 100.0] }
[cases.rogue]
none = {}
exit = { "controller" = { kind = "user", target = "rogue:Exit" } }
memory = { "controller" = { kind = "user", target = "rogue:Memory" } }
"""
ROGUE_LAWS = """
import os
import numpy as np
import coop_pin as cp

class Exit(cp.CellController):
    def __init__(self, scenario):
        self.blocks = []

    def init(self, measurements, references):
        return None

    def step(self, measurements, references, state):
        os._exit(3)

class Memory(Exit):
    def step(self, measurements, references, state):
        while True:
            self.blocks.append(np.ones(1 << 24))
"""


class Session:
    """A running ``coop-pin sweep``.

    Attributes:
        process: its process.
    """

    def __init__(self, drill: Drill, *options: str, plan: Path | None = None) -> None:
        self._drill = drill
        words = ["-m", "coop_pin", "sweep", str(plan or drill.file), "--out", str(drill.folder), "--quiet"]
        path = os.pathsep.join(sys.path)
        self.process = subprocess.Popen(
            [sys.executable, *words, *options],
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=os.environ | {"PYTHONPATH": path},
        )
        self._start = drill.count()

    def progress(self, runs: int) -> None:
        """Wait until this many more runs are stored, or the session has ended; then for a random time."""
        end = time.monotonic() + _PATIENCE_S
        while self._drill.count() < self._start + runs and self.process.poll() is None:
            assert time.monotonic() < end, f"no progress in {_PATIENCE_S:g} s"
            time.sleep(0.02)
        self._start = self._drill.count()
        time.sleep(self._drill.random.uniform(0.0, 0.1))

    def end(self, sent: int | None, *codes: int) -> str:
        """Send a signal, wait, check the exit code and return the messages; exit code 0 is always allowed."""
        done = self.process.poll() is not None
        if sent is not None and not done:
            self.process.send_signal(sent)
        said = self.process.communicate(timeout=_PATIENCE_S)[1]
        code = self.process.returncode
        if code == -signal.SIGINT:  # Python's own exit if Ctrl-C comes during imports; 130 in a shell
            code = INTERRUPTED
        assert code in (*codes, OK), f"exit code {code}, expected {codes}: {said}"
        assert "Traceback" not in said, said
        return said if code != OK else ""

    def children(self, mark: str) -> list[psutil.Process]:
        """Return descendant processes with a word in their command line."""
        with contextlib.suppress(psutil.NoSuchProcess):
            return [
                child
                for child in psutil.Process(self.process.pid).children(recursive=True)
                if mark in " ".join(_command(child))
            ]
        return []


def _command(process: psutil.Process) -> list[str]:
    with contextlib.suppress(psutil.Error):
        return list(process.cmdline())
    return []


class Drill:
    """A folder and the faults injected into it.

    Attributes:
        folder: of the sweep.
        done: faults so far, by name.
        random: random number generator.
    """

    def __init__(self, place: Path, runs: int, seed: int, engine: str = "pinocchio") -> None:
        self.place, self.folder, self.file = place, place / "sweep", place / "sweep.toml"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.file.write_text(PLAN.format(count=runs // 4, engine=engine))
        self.plan = SweepPlan.load(self.file)
        (place / "rogue.py").write_text(ROGUE_LAWS)
        sys.path.insert(0, str(place))  # for keys of runs with these laws, here and in sessions
        self.random = random.Random(seed)
        self.done: Counter[str] = Counter()

    # ------------------------------------------------------------ stored runs

    def segments(self) -> list[Path]:
        """Return the files of records, in order."""
        return sorted(path for path in (self.folder / "runs").glob("*.jsonl") if path.is_file())

    def count(self) -> int:
        """Return the number of stored records."""
        return sum(path.read_bytes().count(b'{"sha256"') for path in self.segments())

    def records(self) -> dict[str, JobRecord]:
        """Return every undamaged record, without times."""
        records = SweepStore(self.folder).records()
        return {record.key: dataclasses.replace(record, wall_s=0.0, cpu_s=0.0) for record in records}

    def make_work(self) -> None:
        """Remove a part of the records when few runs are missing."""
        lines = {line for path in self.segments() for line in path.read_bytes().splitlines() if line}
        if len(self.records()) > 0.7 * len(self.plan):
            kept = self.random.sample(sorted(lines), len(lines) // 2)
            first, *others = self.segments()
            first.write_bytes(b"".join(b"\n%s\n" % line for line in kept))
            for path in others:
                path.unlink()

    # ------------------------------------------------------------ rounds

    def inject(self, fault: str) -> None:
        """Run one round with a fault and check that nothing was lost."""
        self.make_work()
        before = self.records()
        damaged: int = getattr(self, "_" + fault.replace("-", "_"))() or 0
        after = self.records()
        lost = before.keys() - after.keys()
        assert len(lost) <= damaged, f"{fault}: finished runs are lost: {lost}"
        for key in before.keys() - lost:
            assert repr(after[key]) == repr(before[key]), f"{fault}: the run {key} changed"
        self.done[fault] += 1

    def finish(self) -> bytes:
        """Let the sweep end undisturbed and return its table."""
        assert not Session(self, "--workers", "0").end(None)
        return (self.folder / "table.csv").read_bytes()

    def undisturbed(self) -> bytes:
        """Return the table of the same sweep in another folder without faults."""
        sweep(self.plan, out=self.place / "undisturbed", execution=Execution(workers=0, quiet=True))
        return (self.place / "undisturbed" / "table.csv").read_bytes()

    def _here(self) -> Session:
        session = Session(self, "--workers", "0")
        session.progress(self.random.randint(0, 12))
        return session

    def _kill(self) -> None:
        self._here().end(signal.SIGKILL, -signal.SIGKILL)

    def _interrupt(self) -> None:
        session = self._here()
        session.progress(1)  # Python itself handles a Ctrl-C during imports
        said = session.end(signal.SIGINT, INTERRUPTED)
        assert not said or "go on with: coop-pin sweep" in said, said

    def _second(self) -> None:
        first = self._here()
        first.progress(1)
        if first.process.poll() is None:
            said = Session(self, "--workers", "0").end(None, FAILED)
            assert not said or f"in use by process {first.process.pid}" in said, said
        first.end(signal.SIGINT, INTERRUPTED)

    def _file_size(self) -> None:
        session = self._here()
        session.progress(1)
        with contextlib.suppress(psutil.NoSuchProcess):
            limit = self.random.randint(0, 2000)
            psutil.Process(session.process.pid).rlimit(resource.RLIMIT_FSIZE, (limit, limit))
        said = session.end(None, FAILED)
        assert not said or "File too large" in said, said

    def _full_disk(self) -> None:
        session = self._here()
        session.progress(1)
        filler = self.folder / "filler"
        with filler.open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(4096))
        said = session.end(None, FAILED)
        filler.unlink()
        assert not said or "No space left" in said, said

    def _lock_removed(self) -> None:
        first = self._here()
        first.progress(1)
        (self.folder / "lock").unlink(missing_ok=True)
        second = self._here()
        for session in (first, second):
            session.end(signal.SIGINT, INTERRUPTED)

    def _flip_bits(self) -> int:
        """Flip bits, or cut a segment in its last line, while a sweep runs or not."""
        session = self._here() if self.random.random() < 0.5 else None
        damaged = 0
        for path in [*self.segments()[-3:], self.folder / "plan.json"]:
            if path.exists() and (content := bytearray(path.read_bytes())):
                if session is None and self.random.random() < 0.3:
                    content = content[: -self.random.randint(1, min(100, len(content)))]
                else:
                    content[self.random.randrange(len(content))] ^= 1 << self.random.randrange(8)
                with path.open("r+b") as file:  # in place: the session writes to it
                    file.write(content)
                    if session is None:
                        file.truncate()
                damaged += 1
        if session:
            session.progress(1)  # see _interrupt
            session.end(signal.SIGINT, INTERRUPTED)
        self._interrupt()
        return damaged

    def _foreign(self) -> None:
        (self.folder / "runs").mkdir(exist_ok=True)
        for name in ("runs/notes.txt", "runs/readme.jsonl", f".{64 * 'c'}", "ab"):
            (self.folder / name).write_bytes(self.random.randbytes(100))
        for name in ("runs/000000.jsonl", "runs/pipe", "table.csv", "times.csv"):
            (self.folder / name).unlink(missing_ok=True)
            os.mkfifo(self.folder / name)
        self._interrupt()
        (self.folder / "runs" / "readme.jsonl").unlink()

    def _kill_worker(self) -> None:
        session = Session(self, "--workers", "2")
        for _ in range(self.random.randint(1, 3)):
            session.progress(self.random.randint(1, 12))
            for worker in session.children(WORKER)[:1]:
                worker.kill()
        session.progress(1)
        session.end(signal.SIGINT, INTERRUPTED)

    def _kill_start(self) -> None:
        """Kill workers as soon as they are there."""
        session = Session(self, "--workers", "2")
        killed = set[int]()
        end = time.monotonic() + _PATIENCE_S
        while len(killed) < 3 and session.process.poll() is None and time.monotonic() < end:
            for worker in session.children(WORKER):
                if worker.pid not in killed and len(killed) < 3:
                    time.sleep(self.random.uniform(0.0, 0.3))
                    with contextlib.suppress(psutil.NoSuchProcess):
                        worker.kill()
                    killed.add(worker.pid)
        session.progress(1)
        session.end(signal.SIGINT, INTERRUPTED)

    def _stop_worker(self) -> None:
        """Stop one of two workers at work: it is replaced, and all runs end."""
        session = Session(self, "--workers", "2")
        session.progress(1)
        for worker in session.children(WORKER)[:1]:
            worker.suspend()
        session.end(None)

    def _rogue_runs(self) -> None:
        """Add runs that end their process, and some that eat memory, to the folder."""
        rogues = self.place / "rogues.toml"
        rogues.write_text(ROGUES)
        said = Session(self, "--workers", "2", plan=rogues).end(None)
        assert not said, said
        found = SweepResult.load(self.folder)  # of the engine that the folder has
        kinds = {"none": set(), "exit": {"WorkerDiedError"}, "memory": {"MemoryError"}}
        for law, wanted in kinds.items():
            part = found.at({"rogue": law})
            assert part.counts()["missing"] == 0, law
            assert {failure.kind for failure in part.failures} == wanted

    def _kill_host(self) -> None:
        session = Session(self, "--workers", "2")
        session.progress(self.random.randint(1, 12))
        for host in session.children("coop_pin.sweeps.workers.worker_host"):
            host.kill()
        session.progress(1)
        session.end(signal.SIGINT, INTERRUPTED)

    def _kill_both(self) -> None:
        """Kill the process together with its workers, at any time from its start."""
        session = Session(self, "--workers", "2")
        time.sleep(self.random.uniform(0.0, 6.0))
        children = session.children("")
        session.end(signal.SIGKILL, -signal.SIGKILL)
        assert psutil.wait_procs(children, timeout=60)[1] == [], "workers outlive a killed sweep"

    def _kill_scheduler(self) -> None:
        with remote_scheduler(self.place) as (address, scheduler):
            session = Session(self, "--scheduler", address)
            session.progress(self.random.randint(1, 12))
            scheduler.kill()
            session.end(None, FAILED)


@contextlib.contextmanager
def remote_scheduler(folder: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Yield the address and the process of a scheduler with one worker, started with dask's own commands."""
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    local = ["--host", "127.0.0.1", "--scheduler-file", str(file), "--no-dashboard"]
    words = [["scheduler", *local, "--port", "0"], ["worker", *local, "--nthreads", "1"]]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    processes = []
    try:
        for part in words:
            command = [sys.executable, "-m", "dask", *part]
            processes.append(
                subprocess.Popen(
                    command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment
                )
            )
            while not (file.exists() and file.read_text()):
                time.sleep(0.05)
        yield json.loads(file.read_text())["address"], processes[0]
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=20)
            process.kill()
            process.wait()


@contextlib.contextmanager
def small_disk(folder: Path, megabytes: int) -> Iterator[bool]:
    """Mount a small disk in memory at a folder where this user may; yield whether it is there."""
    folder.mkdir(parents=True, exist_ok=True)
    mounted = not subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(folder)],
        check=False,
        capture_output=True,
    ).returncode
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)


def run_drill(
    place: Path, faults: int, runs: int, seed: int, kinds: tuple[str, ...] = FAULTS, engine: str = "pinocchio"
) -> Counter[str]:
    """Inject faults and return how often each kind; an AssertionError reports what was lost."""
    with small_disk(place / "sweep", 64) as is_small:
        drill = Drill(place, runs, seed, engine)
        kinds = tuple(kind for kind in kinds if is_small or kind != "full-disk")
        for number in range(faults):
            fault = kinds[number % len(kinds)]
            drill.inject(fault)
            print(
                f"{number + 1:4d} {fault:15s} {drill.count():5d} of {len(drill.plan)} runs kept", flush=True
            )
        assert drill.finish() == drill.undisturbed(), "the table is not that of an undisturbed sweep"
    return drill.done


def main(arguments: list[str] | None = None) -> None:
    """Drill and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faults", type=int, default=110)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", default="pinocchio", help="of the sweep: pinocchio or compiled")
    options = parser.parse_args(arguments)
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as place:
        done = run_drill(Path(place), options.faults, options.runs, options.seed, engine=options.engine)
    kinds = ", ".join(f"{count} {name}" for name, count in done.items())
    faults = f"{done.total()} faults ({kinds}) in {time.monotonic() - start:.0f} s"
    print(f"{faults}: nothing lost, the table is that of an undisturbed sweep")


if __name__ == "__main__":
    main()
