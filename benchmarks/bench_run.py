"""Processor time of ``coop-pin run adept-paper`` with all its files, and of ticks and batches of a cell.

    python benchmarks/bench_run.py [--trees CHECKOUT ...] [--cell two-pandas-box] [--rounds 15]

Each is a process of its own, user and system time together; those of the checkouts of other commits alternate
with those of this one, so that their ratios hold on a busy machine. A batch has other gains in each run, and
is timed from overrides to metrics. Printed, never asserted.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
BLOCK, BATCHES = 50, 6
TICK = f"""
import sys, time, coop_pin as cp
scenario, marks = cp.Scenario.load(sys.argv[1]), []
ticks = int(sys.argv[2])
scenario = scenario.replace(duration=ticks * scenario.clock.period, events=())
for _ in range(4):
    marks.append([])
    cp.run(scenario, progress=lambda *_: marks[-1].append(time.process_time()))
size = min({BLOCK}, ticks // 2)
blocks = [run[i + size] - run[i] for run in marks for i in range(1, len(run) - size, size)]
print(1e6 * min(blocks) / size)
"""
BATCH = f"""
import sys, time, coop_pin as cp
from coop_pin.compiled import BatchSimulator
cell, duration, runs = sys.argv[1], float(sys.argv[2]), int(sys.argv[3])
base = cp.Scenario.load(cell).replace(duration=duration, events=())
simulator, times = BatchSimulator(), []
for _ in range({BATCHES} + 1):
    start = time.process_time()
    rates = [4.0 + 2.0 * run / runs for run in range(runs)]
    batch = simulator.run([base.override({{"controller.gains.transient_rate": rate}}) for rate in rates])
    batch.metrics()
    getattr(batch, "release", list)()  # 4824ca2 has none
    times.append(time.process_time() - start)
print(1e3 * min(times[1:]))
"""


def child(tree: Path, *words: str) -> tuple[float, str]:
    """Return processor time and output of Python with the package of a checkout."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, *words],
        env={**kept, **one, "PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
        check=False,
        cwd=tree,  # which Python searches first
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 3, 4):  # the verdicts
        raise SystemExit(done.stderr)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def report(name: str, unit: str, found: dict[Path, list[float]]) -> None:
    """Print best and median of each checkout, and the median of ratios to it with its 95 % interval."""
    print(name)
    for tree, values in found.items():
        ratios = sorted(here / there for here, there in zip(found[HERE], values, strict=True))
        low, high = interval(ratios)
        middle, ratio = map(statistics.median, (values, ratios))
        print(
            f"  {tree.name:20s} best {min(values):8.2f} {unit}, median {middle:8.2f} {unit};"
            f" this one takes {ratio:.3f} of it ({low:.3f} .. {high:.3f})"
        )


def interval(values: list[float]) -> tuple[float, float]:
    """Return the 95 % confidence interval of the median of sorted values; the range of fewer than six.

    The number of values below the median is binomial, whatever their distribution.
    """
    n, rank = len(values), 0
    while sum(math.comb(n, k) for k in range(rank + 1)) <= 0.025 * 2**n:
        rank += 1
    rank = max(rank - 1, 0)
    return values[rank], values[n - 1 - rank]


def main(arguments: list[str] | None = None) -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trees", type=Path, nargs="*", default=[], help="checkouts of other commits")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--duration", type=float, default=20.0, help="of the run, s; shorter ones have no events"
    )
    parser.add_argument("--cell", default="two-pandas-box", help="of ticks and batches")
    parser.add_argument("--ticks", type=int, default=400)
    parser.add_argument("--runs", type=int, default=64, help="of a batch, 2 s each; 0 for no batches")
    options = parser.parse_args(arguments)
    runs: dict[Path, list[float]] = {tree: [] for tree in (*options.trees, HERE)}
    ticks, batches = ({tree: list[float]() for tree in runs} for _ in range(2))
    batch = [options.cell, str(min(options.duration, 2.0)), str(options.runs)]
    short = ["--duration", str(options.duration), "--events", "[]"] if options.duration < 20.0 else []
    for turn in range(options.rounds + 1):  # the first round writes bytecode
        for tree in runs:
            with tempfile.TemporaryDirectory() as folder:
                seconds, _ = child(tree, "-m", "coop_pin", "run", "adept-paper", *short, "--out", folder)
            _, tick = child(tree, "-c", TICK, options.cell, str(options.ticks))
            together = child(tree, "-c", BATCH, *batch)[1] if options.runs else "nan"
            if turn:
                runs[tree].append(seconds)
                ticks[tree].append(float(tick))
                batches[tree].append(float(together))
    print("load", *(f"{load:.1f}" for load in os.getloadavg()))
    report("coop-pin run adept-paper, all files", "s", runs)
    report(f"a tick of {options.cell}, best block", "us", ticks)
    if options.runs:
        report(f"a batch of {options.runs} runs of {options.cell}, from overrides to metrics", "ms", batches)


if __name__ == "__main__":
    main()
