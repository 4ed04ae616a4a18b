"""Batches of runs against coop_pin.run and mujoco.rollout: processor time of one core, interleaved.

Each line is the time of one run of 2 s and ratios, medians of the rounds with their range. The compiled loop
is the closed loop with everything recorded; a batch also prepares it and finds all metrics; a sweep adds
scenarios, keys, records and table. The rollout advances MuJoCo's model of the cell (as in bench_arms.py) by
the same steps, open loop and without friction, and keeps its state.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable

import numpy as np
from common import elsewhere, interleaved, ratio

import coop_pin as cp
from coop_pin import Simulation, SweepPlan
from coop_pin.compiled import BatchSimulator
from coop_pin.compiled.preparation import Prepared
from coop_pin.laws import build_controller
from coop_pin.tracing.llvm_machine import native_width

DURATION_S = 2.0
FIELD = "controller.gains.transient_rate"


def scenarios(base: cp.Scenario, count: int) -> list[cp.Scenario]:
    """Return scenarios that differ in a gain."""
    return [base.override({FIELD: float(rate)}) for rate in np.linspace(4.0, 6.0, count)]


def loop(runs: list[cp.Scenario], width: int) -> Callable[[], object]:
    """Return the compiled loop of runs, with its record and without what comes before and after."""
    simulator = BatchSimulator(width=width)
    prepared = [simulator.prepare(run) for run in runs]
    batch = Prepared.joined(prepared)
    family = simulator.family([batch])
    _, machine, order = family.orders[batch.kind.times]
    block, loads = family.code.begin(batch)
    memory = np.empty(machine.record_size(len(runs)))
    return lambda: machine.run(block.copy(), order.uniforms, loads, out=memory)


def measured(simulator: BatchSimulator, runs: list[cp.Scenario]) -> Callable[[], object]:
    """Return a batch from scenarios to metrics, whose memory the next one has."""

    def run() -> None:
        batch = simulator.run(runs)
        batch.metrics()
        batch.release()

    return run


def swept(base: cp.Scenario, count: int) -> Callable[[], object]:
    """Return a sweep from plan to table in this process, with other values each time."""
    plan = SweepPlan(base=base, axes={FIELD: np.linspace(4.0, 6.0, count).tolist()}, engine="compiled")

    def run() -> None:
        with tempfile.TemporaryDirectory() as folder:
            cp.sweep(plan, out=folder, execution=cp.Execution(workers=0, quiet=True))

    return run


def rollout(base: cp.Scenario, count: int) -> Callable[[], object]:
    """Return rollouts of the cell's tree without friction in MuJoCo, under the torques that hold it."""
    import mujoco
    import mujoco.rollout
    from bench_arms import mjcf

    run = Simulation(base, build_controller(base))
    model = mujoco.MjModel.from_xml_string(mjcf(run.plant))
    model.opt.timestep = base.clock.period / base.clock.steps_per_tick
    model.eq_solref[:, 0] = 2.0 * model.opt.timestep
    data, steps = mujoco.MjData(model), base.clock.ticks(base.duration) * base.clock.steps_per_tick
    data.qpos[:], kind = run.plant.q, mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    held = run.chain.transmission.torque(run.actuation.holding_commands(run.plant.q))
    states, control = np.tile(state, (count, 1)), np.tile(held, (count, steps, 1))
    given = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
    return lambda: mujoco.rollout.rollout(model, data, states, control, control_spec=given, nstep=steps)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", nargs="*", default=["adept-paper", "two-pandas-box"])
    parser.add_argument("--runs", type=int, default=64, help="of a batch")
    parser.add_argument("--swept", type=int, default=1000, help="runs of a sweep")
    parser.add_argument("--rounds", type=int, default=5)
    chosen = parser.parse_args()
    widths = [width for width in (8, 4, 1) if width <= native_width()]
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; {chosen.runs} runs of {DURATION_S:g} s")
    for name in chosen.cells:
        base = cp.Scenario.load(name).replace(duration=DURATION_S, events=())
        tasks: dict[str, Callable[[], object]] = {"cp.run": lambda base=base: cp.run(base)}
        counts = {"cp.run": 1}
        try:
            tasks["mujoco.rollout, open loop"] = rollout(base, chosen.runs)
        except ImportError:
            print("mujoco is not installed")
        simulator, runs = BatchSimulator(), scenarios(base, chosen.runs)
        for width in widths:
            tasks[f"compiled loop, {width} lanes"] = loop(runs, width)
        tasks["batch"] = measured(simulator, runs)
        tasks["sweep with table"] = swept(base, chosen.swept)
        counts["sweep with table"] = chosen.swept
        seconds = {
            task: times / counts.get(task, chosen.runs)
            for task, times in interleaved(tasks, chosen.rounds, 1).items()
        }
        print(f"\n{name}: ms a run, and how many of them take as long as one of")
        widest = f"compiled loop, {widths[0]} lanes"
        others = [task for task in ("cp.run", "mujoco.rollout, open loop", widest) if task in tasks]
        for task, times in seconds.items():
            line = [f"  {task:28}{1e3 * np.median(times):10.3f}"]
            line += [f"{other}: {ratio(seconds[other], times)}" for other in others if other != task]
            print("  ".join(line), flush=True)


if __name__ == "__main__":
    with elsewhere():
        main()
