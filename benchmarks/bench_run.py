"""Processor time of ``coop-pin run adept-paper`` with everything it writes, and of a tick of two Pandas.

    python benchmarks/bench_run.py [--trees CHECKOUT ...] [--rounds 5] [--duration 20] [--ticks 400]

Each is a process of its own, user and system time together; those of the checkouts of other commits alternate
with those of this one, so that their ratios hold on a busy machine. Printed, never asserted.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
BLOCK = 50
TICK = f"""
import sys, time, coop_pin as cp
scenario, marks = cp.Scenario.load("two-pandas-box"), []
ticks = int(sys.argv[1])
scenario = scenario.replace(duration=ticks * scenario.clock.period)
for _ in range(4):
    marks.append([])
    cp.run(scenario, progress=lambda *_: marks[-1].append(time.process_time()))
size = min({BLOCK}, ticks // 2)
blocks = [run[i + size] - run[i] for run in marks for i in range(1, len(run) - size, size)]
print(1e6 * min(blocks) / size)
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
    if done.returncode not in (0, 3):  # 3: not trustworthy
        raise SystemExit(done.stderr)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def report(name: str, unit: str, found: dict[Path, list[float]]) -> None:
    """Print best and median of each checkout, and the median of its ratios to this one."""
    print(name)
    for tree, values in found.items():
        ratio = statistics.median(a / b for a, b in zip(values, found[HERE], strict=True))
        middle = statistics.median(values)
        print(f"  {tree.name:20s} best {min(values):8.2f} {unit}, median {middle:8.2f} {unit}, {ratio:.2f}")


def main(arguments: list[str] | None = None) -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trees", type=Path, nargs="*", default=[], help="checkouts of other commits")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--duration", type=float, default=20.0, help="of the run, s; shorter ones have no events"
    )
    parser.add_argument("--ticks", type=int, default=400)
    options = parser.parse_args(arguments)
    runs: dict[Path, list[float]] = {tree: [] for tree in (*options.trees, HERE)}
    ticks: dict[Path, list[float]] = {tree: [] for tree in runs}
    short = ["--duration", str(options.duration), "--events", "[]"] if options.duration < 20.0 else []
    for turn in range(options.rounds + 1):  # the first round writes bytecode
        for tree in runs:
            with tempfile.TemporaryDirectory() as folder:
                seconds, _ = child(tree, "-m", "coop_pin", "run", "adept-paper", *short, "--out", folder)
            _, printed = child(tree, "-c", TICK, str(options.ticks))
            if turn:
                runs[tree].append(seconds)
                ticks[tree].append(float(printed))
    print("load", *(f"{load:.1f}" for load in os.getloadavg()))
    report("coop-pin run adept-paper, all files", "s", runs)
    report("a tick of two-pandas-box, best block", "us", ticks)


if __name__ == "__main__":
    main()
