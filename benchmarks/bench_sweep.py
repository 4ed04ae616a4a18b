"""Cost of a sweep: throughput of two workers against one, overhead per run, start of workers, memory, store.

    python benchmarks/bench_sweep.py [--runs 1000] [--duration 1.0] [--rounds 5] [--records 100000]
    python benchmarks/bench_sweep.py --many 100000 [--workers 2]

The numbers are printed and not asserted: on a busy machine the second processor is not available. One and two
workers take turns, and the ratio is the median of the rounds. The store is filled with records of short runs.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import resource
import statistics
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

import psutil

import coop_pin as cp
from coop_pin import SweepPlan, SweepResult, sweep
from coop_pin.sweeps import linspace
from coop_pin.sweeps.run_key import keyed_points
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers.backend import LocalBackend, outcomes
from coop_pin.sweeps.workers.job import Job, Outcome, run_job


class Cost(NamedTuple):
    """Cost of one sweep.

    Attributes:
        wall_s: wall time per run, s.
        in_run_s: wall time inside the run, s.
        overhead_cpu_s: processor time of this process per run beyond the run itself, s.
        memory_mb: memory of this process after each quarter, MB.
    """

    wall_s: float
    in_run_s: float
    overhead_cpu_s: float
    memory_mb: list[float]


class Memory(threading.Thread):
    """Samples the memory of this process until it is stopped."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self._stopped, self.samples = threading.Event(), []

    def run(self) -> None:
        process = psutil.Process()
        while not self._stopped.wait(0.1):
            self.samples.append(process.memory_info().rss / 2**20)

    def stop(self) -> list[float]:
        self._stopped.set()
        self.join()
        return [self.samples[min(len(self.samples) - 1, len(self.samples) * i // 4)] for i in range(1, 5)]


def plan(runs: int, duration: float) -> SweepPlan:
    return SweepPlan(
        base="adept-paper",
        changes={"duration": duration, "events": []},
        axes={"controller.gains.sign_gain": linspace(0.0, 0.4, runs)},
    )


def cost(made: SweepPlan, workers: int) -> Cost:
    """Run a sweep; the start of workers is excluded by timing a short sweep before."""
    with tempfile.TemporaryDirectory() as folder:
        first = made.replace(
            axes={"controller.gains.sign_gain": [0.5 + i / 100.0 for i in range(2 * max(workers, 1))]}
        )
        start = time.perf_counter()
        sweep(first, out=folder, execution=cp.Execution(workers=workers, quiet=True))
        few = time.perf_counter() - start
        memory = Memory()
        memory.start()
        start, cpu = time.perf_counter(), time.process_time()
        result = sweep(made, out=folder, execution=cp.Execution(workers=workers, quiet=True))
        wall, cpu = time.perf_counter() - start - few, time.process_time() - cpu
        samples = memory.stop()
        records = list(result.store.records())
        in_run = statistics.fmean(record.wall_s for record in records)
        in_run_cpu = statistics.fmean(record.cpu_s for record in records)
        return Cost(wall / len(made), in_run, cpu / len(made) - (0.0 if workers else in_run_cpu), samples)


def bare(made: SweepPlan, count: int) -> float:
    """Return the time of one run with its metrics, in this process, s."""
    scenarios = [made.scenario(i) for i in range(min(count, len(made)))]
    cp.run(scenarios[0]).metrics()
    start = time.perf_counter()
    for scenario in scenarios:
        cp.run(scenario).metrics()
    return (time.perf_counter() - start) / len(scenarios)


def worker_start() -> float:
    """Return the time from nothing to a worker that has everything loaded, s."""
    start = time.perf_counter()
    job = Job("key", plan(1, 0.0125).scenario(0))
    with contextlib.closing(LocalBackend(1)) as pool:
        list(outcomes(pool, iter([job])))
        return time.perf_counter() - start


def storage(count: int) -> None:
    """Store records of short runs, read their table, and print what that takes."""

    def times() -> tuple[float, float]:
        return time.perf_counter(), time.process_time()

    made = plan(count, 0.0125)
    record = run_job(Job("key", made.scenario(0))).record
    with tempfile.TemporaryDirectory() as folder:
        store, seconds = SweepStore(folder), [times()]
        runs = [(key, point.changes) for point, key, *_ in keyed_points(made)]
        seconds.append(times())
        with store.locked():
            store.write_plan(made)
            for first in range(0, count, 64):
                batch = runs[first : first + 64]
                store.append([Outcome(dataclasses.replace(record, key=k, changes=c)) for k, c in batch])
        seconds.append(times())
        memory = Memory()
        memory.start()
        result = SweepResult.load(folder)
        assert result.counts()["ok"] == count, result.counts()
        seconds.append(times())
        result.write_tables()
        seconds.append(times())
        files = [file for file in Path(folder).rglob("*.jsonl") if file.is_file()]
        megabytes = sum(file.stat().st_size for file in files) / 1e6
        names = ("keys", "stored, a sync for every 64", "table read, keys included", "tables written")
        spent = [
            f"{name} {end[0] - start[0]:.1f} s, {end[1] - start[1]:.1f} s of the processor"
            for name, start, end in zip(names, seconds[:-1], seconds[1:], strict=True)
        ]
        print(f"{count} records in {len(files)} files of {megabytes:.1f} MB: {'; '.join(spent)}", end="")
        print(f"; memory at most {max(memory.stop()):.0f} MB", flush=True)


def many(runs: int, workers: int) -> None:
    """Compute a sweep of runs of 2 s in batches, resume it finished, and print what both take."""

    def times() -> tuple[float, float]:
        usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return time.perf_counter(), sum(each.ru_utime + each.ru_stime for each in usage)

    field, execution = "controller.gains.transient_rate", cp.Execution(workers=workers, quiet=True)
    made = plan(1, 2.0).replace(axes={field: linspace(4.0, 6.0, runs)}, engine="compiled")
    with tempfile.TemporaryDirectory() as folder:
        sweep(made.replace(axes={field: linspace(4.0, 6.0, 64)}), out=f"{folder}/few", execution=execution)
        for name in ("computed", "resumed"):
            start = times()
            sweep(made, out=f"{folder}/many", execution=execution)
            wall, processor = (end - begin for end, begin in zip(times(), start, strict=True))
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            spent = f"wall {wall:.2f} s, processor of this process {processor:.2f} s"
            print(f"{runs} runs {name} with {workers} workers: {spent}, memory at most {memory:.0f} MB")


def main(arguments: list[str] | None = None) -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--duration", type=float, default=1.0, help="of each run, simulated s")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--records", type=int, default=100_000, help="for the storage; 0 for none")
    parser.add_argument(
        "--many", type=int, default=0, help="runs in batches, computed and resumed; nothing else"
    )
    parser.add_argument("--workers", type=int, default=0, help="for --many")
    options = parser.parse_args(arguments)
    if options.many:
        many(options.many, options.workers)
        return
    made = plan(options.runs, options.duration)
    load = f"load {psutil.getloadavg()[0]:.1f} on {psutil.cpu_count()} processors"
    print(f"{options.runs} runs of {options.duration:g} s, {load}")
    print(f"a worker starts in {worker_start():.2f} s")
    if options.records:
        storage(options.records)
    ratios = []
    for _ in range(options.rounds):
        alone = bare(made, 50)
        here, one, two = (cost(made, workers) for workers in (0, 1, 2))
        print(f"one run alone            {1e3 * alone:7.2f} ms")
        for name, found in (("in this process", here), ("one worker", one), ("two workers", two)):
            flat = " ".join(f"{sample:.0f}" for sample in found.memory_mb)
            times = f"per run {1e3 * found.wall_s:7.2f} ms, in the run {1e3 * found.in_run_s:7.2f} ms"
            overhead = f"processor overhead {1e3 * found.overhead_cpu_s:.2f} ms here"
            print(f"{name:16s} {times}, {overhead}, memory by quarters {flat} MB")
        here_ms, one_ms = (1e3 * (found.wall_s - found.in_run_s) for found in (here, one))
        print(f"overhead per run: {here_ms:.2f} ms here, {one_ms:.2f} ms with one worker")
        ratios.append(one.wall_s / two.wall_s)
        print(
            f"throughput of two workers / one: {ratios[-1]:.2f}, load {psutil.getloadavg()[0]:.1f}",
            flush=True,
        )
    if ratios:
        print(f"throughput of two workers / one, median of {len(ratios)}: {statistics.median(ratios):.2f}")


if __name__ == "__main__":
    main()
