"""Single runs against a batch where "auto" changes over, from fresh processes without compiled code.

Prints, for sweeps of so many 2 s runs that auto takes a batch, of one run less and of twice as many, the
processor time of a batch as a ratio to that of single runs: medians, with the range over the rounds.

With --one, single runs by the engines in turn in one process: first calls with code on disk or not, and
warm ones, as ratios to Pinocchio.

Usage: python benchmarks/bench_engine.py [--rounds N] [--one]
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time

CELLS = (
    "adept-anchored",
    "two-pandas-box",
    "three-ur5-plate",
    "panda-ur5-bar",
    "kinova-pair",
    "five-joint-pair",
)
SWEEP = """
import sys, coop_pin as cp
name, engine, runs, out = sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4]
base = cp.Scenario.load(name).replace(duration=2.0, events=())
gains = list(cp.sweeps.linspace(0.01, 0.1, runs))
axes, here = {"controller.gains.sign_gain": gains}, cp.Execution(workers=0, quiet=True)
cp.sweep(base, axes, out=out, engine=engine, execution=here)
"""


def seconds(cell: str, engine: str, runs: int) -> float:
    """Return the processor time of a sweep in a process of its own, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": folder, "OMP_NUM_THREADS": "1"}
        arguments = [sys.executable, "-c", SWEEP, cell, engine, str(runs), f"{folder}/sweep"]
        subprocess.run(arguments, check=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def one_run(cell: str, engine: str) -> float:
    """Return the processor time of a single run in this process, its labelled result included, s."""
    import coop_pin as cp
    from coop_pin.compiled import plant_of
    from coop_pin.laws import build_controller

    start = time.process_time()
    if engine == "plant":  # under the law as Python, as with a view
        scenario = cp.Scenario.load(cell)
        _ = cp.simulate(scenario, build_controller(scenario), plant=plant_of("compiled")).data
    else:
        _ = cp.run(cell, engine=engine, warn=False).data
    return time.process_time() - start


def single_runs(rounds: int) -> None:
    """Print the first call by each compiled engine, and warm ones, as ratios to Pinocchio."""
    for cell in ("adept-paper", "two-pandas-box"):
        one_run(cell, "pinocchio")
        first = {engine: one_run(cell, engine) for engine in ("plant", "auto")}
        blocks = [[one_run(cell, engine) for engine in ("pinocchio", *first)] for _ in range(rounds)]
        slow = statistics.median(block[0] for block in blocks)
        for index, engine in enumerate(first, start=1):
            ratios = [block[index] / block[0] for block in blocks]
            warm = f"{statistics.median(ratios):.3f} ({min(ratios):.3f} .. {max(ratios):.3f})"
            print(f"| `{cell}` | {engine} | {first[engine] / slow:.2f} | {warm} |", flush=True)


def main() -> None:
    """Print the table."""
    import coop_pin as cp
    from coop_pin.compiled.engine_choice import runs_worth_a_batch

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--one", action="store_true")
    arguments = parser.parse_args()
    rounds = arguments.rounds
    if arguments.one:
        single_runs(rounds)
        return
    for cell in CELLS:
        enough = runs_worth_a_batch(cp.Scenario.load(cell).replace(duration=2.0, events=()))
        texts = []
        for runs in (enough - 1, enough, 2 * enough):
            ratios = [
                seconds(cell, "compiled", runs) / seconds(cell, "pinocchio", runs) for _ in range(rounds)
            ]
            texts.append(f"{runs}: {statistics.median(ratios):.2f} ({min(ratios):.2f} .. {max(ratios):.2f})")
        print(f"| `{cell}` | " + " | ".join(texts) + " |", flush=True)


if __name__ == "__main__":
    main()
