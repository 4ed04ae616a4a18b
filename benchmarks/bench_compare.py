"""A comparison by engine "auto" against single runs: 14 laws, 12 trials of 2 s, whole processes.

Prints the processor time of the processes, s: single runs; "auto" without code on disk, and with it; the laws
that no engine but Pinocchio runs; the ratio of "auto" with code on disk to these laws; and the first
comparison called again, from its start on. With --six the ratio of "auto" to single runs where there are six
runs: one law in six trials, and six laws in one.

Usage: python benchmarks/bench_compare.py [--cell NAME] [--rounds N] [--six]
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile

COMPARE = """
import sys, time
import coop_pin as cp
from coop_pin.comparison.controllers import controller_names
from coop_pin.comparison.trials import benchmark_scenario, standard_trials

cell, engine, part, out = sys.argv[1:]
left_out = {"friction x0", "friction x3", "bias 0.1 mm", "mass x0.5", "80 Hz", "1000 Hz", "held by palms"}
known = standard_trials(benchmark_scenario(cp.Scenario.load(cell), 2.0))
trials = [name for name in known if name not in left_out]
laws = [name for name in controller_names() if name != "adaptive-verginis"]
models = [law for law in laws if law.startswith(("computed", "object", "adaptive", "torque"))]
laws, trials = {
    "all": (laws, trials),
    "models": (models, trials),
    "six trials": (laws[:1], trials[:6]),
    "six laws": (laws[:6], trials[:1]),
}[part]
start, here = time.process_time(), cp.Execution(workers=0, quiet=True, engine=engine)
cp.compare(cell, laws, trials, out=out, seeds=1, duration=2.0, execution=here)
print(time.process_time() - start)
"""


def seconds(cell: str, engine: str, part: str, folder: str, out: str) -> tuple[float, float]:
    """Return the processor time of a comparison in a process of its own, and that without its imports, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = os.environ | {"XDG_CACHE_HOME": folder, "OMP_NUM_THREADS": "1"}
    arguments = [sys.executable, "-c", COMPARE, cell, engine, part, f"{folder}/{out}"]
    text = subprocess.run(arguments, check=True, env=environment, capture_output=True, text=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, float(text.split()[-1])


def main() -> None:
    """Print the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cell", default="adept-anchored")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--six", action="store_true")
    chosen, times = parser.parse_args(), dict[str, list[float]]()
    for _ in range(chosen.rounds):
        if chosen.six:
            for part in ("six trials", "six laws"):
                with tempfile.TemporaryDirectory() as folder:
                    auto = seconds(chosen.cell, "auto", part, folder, "auto")[0]
                    times.setdefault(part, []).append(
                        auto / seconds(chosen.cell, "pinocchio", part, folder, "single")[0]
                    )
            continue
        with tempfile.TemporaryDirectory() as folder:
            tasks = (("single", "pinocchio", "all"), ("cold", "auto", "all"), ("on disk", "auto", "all"))
            for name, *task in (*tasks, ("models alone", "auto", "models")):
                times.setdefault(name, []).append(seconds(chosen.cell, *task, folder, name)[0])
            ratio = times["on disk"][-1] / times["models alone"][-1]
            times.setdefault("on disk / models alone", []).append(ratio)
            times.setdefault("again", []).append(seconds(chosen.cell, "auto", "all", folder, "cold")[1])
    for name, values in times.items():
        print(f"| {name} | {statistics.median(values):.2f} ({min(values):.2f} .. {max(values):.2f}) |")


if __name__ == "__main__":
    main()
