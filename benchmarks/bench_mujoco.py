"""Comparison with MuJoCo on the paper's experiment: cost, closure error, internal-force error.

    python benchmarks/bench_mujoco.py [--rounds 15] [--duration 20] [--solref 2 3 4] [--pages FILE ...]
    python benchmarks/bench_mujoco.py --equal-error [1e-6 1e-8 1e-9] [--rounds 15] [--duration 20]

Both run the same controller object on the same kinematics at 80 Hz, with the same events. Coulomb friction is
zero in both: MuJoCo models it as a constraint, coop_pin as a smooth function of speed. Errors are relative
to coop_pin at 64 steps in a tick. Printed, never asserted; --pages benchmarks/README.md
writes the table of plants there. --equal-error prints the cost of the coarsest steps with which each
plant keeps the error of payload position and closure below a limit, m, MuJoCo with its best time constant.
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from common import elsewhere, interleaved, ratio, shortened
from mujoco_cell import MujocoRun, Recorded

import coop_pin as cp
from coop_pin import simulate
from coop_pin.compiled import plant_of
from coop_pin.compiled.engines import Engine
from coop_pin.laws import build_controller

LADDER = (1, 2, 3, 4, 5, 7, 10, 14, 20, 28, 40, 56, 80, 112, 160)
"""Plant steps in a tick, of which the fewest with a small enough error are taken."""
SOLREF = (1.2, 1.5, 2.0, 2.5, 3.0)
"""Time constants of MuJoCo's weld in plant steps, of which the one with the smallest error is taken."""
OVERRIDES = {"cell.arms.left.friction.coulomb": 0.0, "cell.arms.right.friction.coulomb": 0.0}


def recorded(result: cp.RunResult) -> Recorded:
    """Return the same quantities of a result of coop_pin."""
    data, rows = result.data, list(result.scenario.cell.task_rows.indices)
    x, y, z, w = data.payload_quaternion.values.T
    return Recorded(
        position=data.payload_position.values,
        angle=np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        internal_wrench=data.internal_wrench.values[:, 1, rows],
        gap_m=data.closure_distance.values.max(axis=1),
        gap_rad=data.closure_angle.values.max(axis=1),
    )


def errors(run: Recorded, reference: Recorded) -> list[float]:
    """Return the largest closure errors and differences of pose and internal wrench, linear part first."""
    wrench = run.internal_wrench - reference.internal_wrench
    return [
        run.gap_m.max(),
        run.gap_rad.max(),
        np.linalg.norm(run.position - reference.position, axis=1).max(),
        np.abs(run.angle - reference.angle).max(),
        np.linalg.norm(wrench[:, :2], axis=1).max(),
        np.abs(wrench[:, 2]).max(),
    ]


def with_table(page: str, measured: dict[str, list[float]], cost: dict[str, np.ndarray]) -> str:
    """Return a page with the rows of its table of plants replaced.

    Args:
        page: its table has the columns plant, the six errors, cost.
        measured: errors of each plant.
        cost: of each plant, relative to the first row of the page, in every round.
    """
    rows = [
        f"| {name} | "
        + " | ".join(f"{error:.1e}" for error in measured[name])
        + f" | {spread(cost[name])} |\n"
        for name in measured
    ]
    head = r"^\| plant \|.*\n\|[-| ]+\n"
    written, found = re.subn(
        rf"({head})(?:\|.*\n)+", lambda table: table[1] + "".join(rows), page, flags=re.M
    )
    assert found == 1, "the page must have one table of plants"
    return written


def spread(cost: np.ndarray) -> str:
    """Return the median and the range of relative costs."""
    return f"{np.median(cost):.2f} ({cost.min():.2f} .. {cost.max():.2f})"


def coop_pin_run(scenario: cp.Scenario, steps: int, engine: Engine = "pinocchio") -> cp.RunResult:
    """Return a run on the plant of an engine, under the law as Python."""
    scenario = scenario.override({"clock.steps_per_tick": steps})
    return simulate(scenario, build_controller(scenario), plant=plant_of(engine))


def mujoco_run(scenario: cp.Scenario, steps: int, solref: float) -> Recorded:
    scenario = scenario.override({"clock.steps_per_tick": steps})
    return MujocoRun(scenario, build_controller(scenario), solref).run()


def coarsest(
    runs: Mapping[str, Callable[[int], Recorded]], reference: Recorded, limits: Sequence[float]
) -> dict[float, tuple[str, int, list[float]]]:
    """Return the fewest steps in a tick that keep the error of position and closure within each limit, m.

    Args:
        runs: variants of a plant by name, as functions of the number of steps in a tick.
        reference: what their errors are relative to.
        limits: those that no number of the ladder keeps are left out.

    Returns:
        by limit: the best variant with the fewest steps, their number and its errors.
    """
    found: dict[float, tuple[str, int, list[float]]] = {}
    for steps in LADDER:
        measured = {name: errors(run(steps), reference) for name, run in runs.items()}
        best = min(measured, key=lambda name: distance(measured[name]))
        for limit in limits:
            if distance(measured[best]) <= limit:
                found.setdefault(limit, (best, steps, measured[best]))
        if len(found) == len(limits):
            break
    return found


def distance(measured: Sequence[float]) -> float:
    """Return the largest error of gap and position, m."""
    return max(measured[0], measured[2])


def compare_at_equal_error(scenario: cp.Scenario, limits: Sequence[float], rounds: int) -> None:
    """Print cost relative to MuJoCo of the coarsest steps of each plant within each limit."""
    ours = {"coop_pin": "pinocchio", "coop_pin compiled": "compiled"}
    plants = {
        name: {name: lambda steps, e=engine: recorded(coop_pin_run(scenario, steps, e))}
        for name, engine in ours.items()
    } | {"MuJoCo": {f"MuJoCo, {s:g} dt": lambda steps, s=s: mujoco_run(scenario, steps, s) for s in SOLREF}}
    reference = recorded(coop_pin_run(scenario, 64))
    chosen = {plant: coarsest(runs, reference, limits) for plant, runs in plants.items()}
    seconds = interleaved(
        {
            (name, steps): lambda run=plants[plant][name], n=steps: run(n)
            for plant, found in chosen.items()
            for name, steps, _ in found.values()
        },
        rounds,
        1,
    )
    print(f"{scenario.duration:g} s of adept-paper, whole runs at equal error of position and closure")
    print(f"{'':20s} limit m   step ms     gap m    pose m    int. N   cost (MuJoCo = 1)")
    for limit, (plant, found) in itertools.product(limits, chosen.items()):
        if limit not in found:
            print(f"{plant:20s}{limit:8.0e}   not with {LADDER[-1]} steps in a tick")
            continue
        name, steps, (gap, _, position, _, force, _) = found[limit]
        unit = chosen["MuJoCo"].get(limit)
        cost = ratio(seconds[name, steps], seconds[unit[:2]]) if unit else "   -"
        print(f"{name:20s}{limit:8.0e}{12.5 / steps:10.4g}{gap:10.1e}{position:10.1e}{force:10.1e}{cost}")


def main(arguments: list[str] | None = None) -> None:
    """Run, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--duration", type=float, default=20.0, help="s; shorter runs have no events")
    parser.add_argument(
        "--solref",
        type=float,
        nargs="+",
        default=[2.0, 3.0, 4.0],
        help="time constants of the weld in plant steps",
    )
    parser.add_argument("--pages", type=Path, nargs="+", default=[], help="files with a table of plants")
    parser.add_argument("--equal-error", type=float, nargs="*", metavar="M", help="compare at these, m")
    options = parser.parse_args(arguments)
    scenario = shortened(cp.Scenario.load("adept-paper", OVERRIDES), options.duration)
    if options.equal_error is not None:
        compare_at_equal_error(scenario, options.equal_error or (1e-6, 1e-8, 1e-9), options.rounds)
        return
    runs = {
        f"coop_pin{title}, {12.5 / steps:g} ms": lambda n=steps, e=engine: recorded(
            coop_pin_run(scenario, n, e)
        )
        for engine, title in (("pinocchio", ""), ("compiled", " compiled"))
        for steps in (5, 2, 1)
    }
    for solref in options.solref:
        runs[f"MuJoCo, 2.5 ms, solref {solref:g} dt"] = lambda s=solref: MujocoRun(
            scenario, build_controller(scenario), s
        ).run()
    reference = recorded(coop_pin_run(scenario, 64))
    measured = {name: errors(run(), reference) for name, run in runs.items()}
    seconds = interleaved(runs, options.rounds, 1)
    unit = seconds[f"MuJoCo, 2.5 ms, solref {options.solref[0]:g} dt"]
    print(f"{options.duration:g} s of adept-paper, whole runs; largest errors over the run")
    titles = ("gap m", "gap rad", "pose m", "pose rad", "int. N", "int. N m")
    print(" " * 28 + "".join(f"{title:>10s}" for title in titles) + "   cost (MuJoCo = 1)")
    for name in runs:
        print(
            f"{name:28s}" + "".join(f"{error:10.1e}" for error in measured[name]) + ratio(seconds[name], unit)
        )
    for page in options.pages:
        cost = {name: seconds[name] / unit for name in runs}
        text = with_table(page.read_text(encoding="utf-8"), measured, cost)
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    words = [str(Path(word).resolve()) if word.endswith(".md") else word for word in sys.argv[1:]]
    with elsewhere():
        main(words)
