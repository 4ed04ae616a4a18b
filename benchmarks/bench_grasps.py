"""Cost of compliant grasps against rigid ones at equal steps, by every engine.

    python benchmarks/bench_grasps.py [--blocks 15] [--runs 64] [--duration 0.2]

Plant steps of a single run, on Pinocchio and compiled, and whole runs as lanes, rigid and compliant in turn.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial

from common import interleaved, ratio

import coop_pin as cp
from coop_pin import Simulation
from coop_pin.compiled import BatchSimulator, plant_of
from coop_pin.laws import build_controller

CELLS = ("adept-anchored", "two-pandas-box", "three-ur5-plate")
STEP, STEPS = 1e-5, 64


def pair(name: str, duration: float) -> dict[str, cp.Scenario]:
    """Return a scenario with its rigid grasps and with compliant ones, at the steps that these need."""
    rigid = cp.Scenario.load(name).replace(events=(), duration=duration, beyond_bound=True)
    grasps = {
        arm: cp.CompliantGrasp(xyz=grasp.xyz, rpy=grasp.rpy, stiffness="paper")
        for arm, grasp in rigid.cell.grasps.items()
    }
    return {"rigid": rigid, "compliant": rigid.replace(cell=rigid.cell.replace(grasps=grasps))}


def steps_of(scenario: cp.Scenario, engine: str) -> Callable[[], object]:
    """Return a function that makes some plant steps from the start."""
    plant = Simulation(scenario, build_controller(scenario), plant=plant_of(engine)).plant
    q, v = plant.q, plant.v

    def steps() -> object:
        plant.restore(plant.state()._replace(q=q, v=v))
        for step in range(STEPS):
            plant.advance(step * STEP, STEP)
        return plant.v

    return steps


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blocks", type=int, default=15)
    parser.add_argument("--runs", type=int, default=64)
    parser.add_argument("--duration", type=float, default=0.2)
    options = parser.parse_args(words)
    for name in CELLS:
        scenarios = pair(name, options.duration)
        for engine in ("pinocchio", "compiled"):
            tasks = {kind: steps_of(scenario, engine) for kind, scenario in scenarios.items()}
            report(name, f"{engine}, step", interleaved(tasks, options.blocks, 4), STEPS)
        simulator = BatchSimulator()
        runs = {kind: [simulator.prepare(each)] * options.runs for kind, each in scenarios.items()}
        tasks = {kind: partial(simulator.run_prepared, each) for kind, each in runs.items()}
        clock = scenarios["rigid"].clock
        ticks = options.runs * clock.ticks(options.duration)
        report(name, f"batch of {options.runs}, tick", interleaved(tasks, options.blocks, 1), ticks)


def report(name: str, what: str, seconds: dict, count: int) -> None:
    """Print one row: microseconds of both, and their ratio."""
    rigid, compliant = (
        1e6 * float(sorted(seconds[kind])[len(seconds[kind]) // 2]) / count for kind in seconds
    )
    ratios = ratio(seconds["compliant"], seconds["rigid"])
    print(f"{name:16} {what:20} {rigid:8.2f} us rigid {compliant:8.2f} us compliant {ratios}", flush=True)


if __name__ == "__main__":
    main()
