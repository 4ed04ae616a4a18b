"""Cost of a tick, in units of one pinocchio.constraintDynamics call on the planar chain, payload welded.

    python benchmarks/bench_tick.py [--blocks 40] [--calls 100] [--duration 20]

Ratios of one interleaved run are reproducible on a shared machine; times are not. Printed, never asserted.
"""

from __future__ import annotations

import argparse
import time

import common
import numpy as np
import pinocchio as pin

import coop_pin as cp
from coop_pin import ArmMeasurement, Simulation
from coop_pin.control.terms import jacobian_inverse
from coop_pin.grasps import CellChain
from coop_pin.laws import build_controller
from coop_pin.simulation.devices.sensors import measured_motion
from coop_pin.simulation.tick import TickInputs

UNIT = "constraintDynamics"
STEP, BOTH, RECORD = "RK4 step of the plant", "both arms' sensing and law", "Recorder.record"
TICK = 40


def constraint_dynamics(chain: CellChain, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> common.Task:
    """Return the bare Pinocchio call, with a weld of its own."""
    model = chain.mechanism.model
    a, b = (model.frames[model.getFrameId(name)] for name in ("right/grasp", "payload/right"))
    kind = pin.ContactType.CONTACT_6D
    weld = pin.RigidConstraintModel(
        kind, model, a.parentJoint, a.placement, b.parentJoint, b.placement, pin.LOCAL
    )
    welds, data = pin.StdVec_RigidConstraintModel([weld]), model.createData()
    weld_data = pin.StdVec_RigidConstraintData([weld.createData()])
    settings = pin.ProximalSettings(1e-14, 1e-8, 20)
    pin.initConstraintDynamics(model, data, welds, weld_data)
    return lambda: pin.constraintDynamics(model, data, q, v, tau, welds, weld_data, settings)


def tasks(scenario: cp.Scenario) -> dict[str, common.Task]:
    """Return the timed calls by name, at a state in motion: tick 40 of the experiment."""
    controller = build_controller(scenario)
    run = Simulation(scenario, controller)
    for _ in range(TICK):
        run.tick()
    plant, chain, sensing, t = run.plant, run.chain, run.sensing, run.timeline.time(TICK)
    target, squeeze, references = run.motion.at(t), run.squeeze.at(t, scenario.cell.grasps), run.references(t)
    signals = next(run.signals())
    measured = run.sensing.start(plant.q, plant.v, references, signals.sensors)
    law, state = controller.controllers["left"], run.controller_state
    command = controller.step(measured, references, state)
    applied, free = run.actuation.apply(t, command, signals.missed), measured[0].saturated
    q, v, tau, h = (
        plant.q,
        plant.v,
        plant.generalised_force(),
        run.timeline.period / scenario.clock.steps_per_tick,
    )
    place = chain.model.arms[0]
    angles, rates = q[place.q_slice], v[place.v_slice]

    def measured_by_one_arm() -> ArmMeasurement:
        view, T = sensing._view(q, 0, None), place.drive
        return ArmMeasurement(t, *measured_motion(view, T.dot(angles), T.dot(rates)), None, free)

    def recorded() -> None:
        run.recorder.count = TICK
        run.recorder.record(t, TickInputs(measured, references, target, squeeze, signals), applied, shares)

    seen = [np.tile(part, (100, 1)) for part in (q, v, plant.force)]
    shares = run.sensing.sensors.shares
    return {
        UNIT: constraint_dynamics(chain, q, v, tau),
        "ProximalSolver.acceleration": lambda: chain.mechanism.solver.acceleration(q, v, tau),
        "one arm's tick of law (23), kinematics included": lambda: law.step(
            measured_by_one_arm(), references[0], state[0]
        ),
        "  measurement of one arm": measured_by_one_arm,
        "    ArmKinematics.view": lambda: sensing._kinematics[0].view(angles),
        "  SlidingModeController.step": lambda: law.step(measured[0], references[0], state[0]),
        "    jacobian_inverse": lambda: jacobian_inverse(measured[0].payload_jacobian, t),
        "    pose_error": lambda: law.arm.rows.pose_error(measured[0].payload_pose, references[0].pose),
        BOTH: lambda: controller.step(
            run.sensing.measure(t, plant, applied, signals.sensors), references, state
        ),
        "Actuation.apply": lambda: run.actuation.apply(t, command, signals.missed),
        "references": lambda: run.references(t),
        STEP: lambda: plant._integrator.step(plant._rate, t, q, v, h),
        "  rate (one of its four)": lambda: plant._rate(t, q, v),
        "    friction": lambda: plant.transmission.friction(v),
        RECORD: recorded,
        "100 ticks of Plant.observe": lambda: plant.observe(*seen, np.full(100, t)),
        "closure error": lambda: chain.closure_errors(plant.q),
    }


def whole_run(scenario: cp.Scenario, seconds: dict[str, np.ndarray]) -> str:
    """Return the shares of a whole run's processor time: parts as measured alone, the rest by difference."""
    cp.run(scenario.replace(duration=0.1, events=()))  # warm-up: imports and caches
    marks: list[float] = []
    start = time.process_time()
    cp.simulate(scenario, build_controller(scenario), progress=lambda *_: marks.append(time.process_time()))
    total, ticks = time.process_time() - start, len(marks) - 1
    alone = {name: float(np.median(seconds[name])) for name in (UNIT, STEP, BOTH, RECORD)}
    shares = {
        "set-up and first tick": marks[0] - start,
        "plant": ticks * scenario.clock.steps_per_tick * alone[STEP],
        BOTH: ticks * alone[BOTH],
        "recording": ticks * alone[RECORD],
        "labelling the result": start + total - marks[-1],
    }
    shares["references, events, checks, colder caches"] = total - sum(shares.values())
    title = (
        f"whole run: {ticks} ticks of {total / ticks / alone[UNIT]:.0f} units, "
        f"{scenario.duration / total:.0f} times real time here"
    )
    return "\n".join(
        [title, *(f"  {name:46s} {100 * share / total:5.1f} %" for name, share in shares.items())]
    )


def main(arguments: list[str] | None = None) -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--blocks", type=int, default=40)
    parser.add_argument("--calls", type=int, default=100)
    parser.add_argument(
        "--duration", type=float, default=20.0, help="of the whole run, s; shorter ones have no events"
    )
    options = parser.parse_args(arguments)
    scenario = cp.Scenario.load("adept-paper")
    seconds = common.interleaved(tasks(scenario), options.blocks, options.calls)
    print(
        f"unit: one {UNIT} call on the planar chain with a welded payload, "
        f"{1e6 * np.median(seconds[UNIT]):.2f} us here; median (min .. max)"
    )
    for name, values in seconds.items():
        print(f"{name:48s} {common.ratio(values, seconds[UNIT])}")
    print(whole_run(common.shortened(scenario, options.duration), seconds))


if __name__ == "__main__":
    main()
