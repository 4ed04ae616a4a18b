"""What a tick costs, in units of one pinocchio.constraintDynamics call on the rooted planar chain.

    python benchmarks/bench_tick.py [--blocks 40] [--calls 100] [--duration 20]

Times of a shared machine mean little; the ratios of one interleaved run do. Printed, never asserted.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import pinocchio as pin
from common import Task, interleaved, ratio

import coop_pin as cp
from coop_pin.chain import CellChain
from coop_pin.control import ArmReference
from coop_pin.control.inverse import jacobian_inverse
from coop_pin.controllers import build_controller
from coop_pin.reference import ConstantSqueeze
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.recorder import Recorder
from coop_pin.simulation.sensing import ArmSensor
from coop_pin.simulation.timeline import Timeline

UNIT = "constraintDynamics"


class Bench:
    """Everything that a tick of the paper's experiment touches, at a state in motion."""

    def __init__(self) -> None:
        self.scenario = scenario = cp.Scenario.load("adept-paper")
        before = cp.run(scenario.replace(duration=0.5, events=())).data.isel(time=-1)
        self.time, rows = float(before.time), scenario.cell.task_rows
        self.chain = CellChain(scenario.cell, scenario.plant)
        self.plant = Plant(self.chain, scenario.plant, before.configuration.values)
        self.plant.v = before.velocity.values
        self.torques = list(before.torque.values)
        self.plant.hold(self.torques)
        self.tau = self.plant.generalised_force()
        self.motion, self.squeeze = scenario.motion.build(), ConstantSqueeze(scenario.squeeze_wrenches)
        target = self.motion.at(self.time)
        self.references = [
            ArmReference(target.X_WP_d, rows.select(target.V_WP_d), rows.select(target.A_WP_d), rows.select(wrench))
            for wrench in self.squeeze.at(self.time)
        ]
        self.sensors = [ArmSensor(scenario.cell, place) for place in self.chain.tree.arms]
        self.measurements = self.measure()
        self.controller = build_controller(scenario)
        self.state = self.controller.init(self.measurements, self.references)
        self.recorder = Recorder(scenario, self.plant, Timeline(scenario.clock, 1.0, ()))

    def measure(self) -> list:
        return [sensor.measure(self.time, self.plant.q, self.plant.v, None) for sensor in self.sensors]

    def constraint_dynamics(self) -> Task:
        """Return the bare Pinocchio call, with constraints of its own."""
        model, tip = self.chain.tree.model, self.chain.tree.arms[1].tip
        a, b = model.frames[tip], model.frames[model.getFrameId("payload/right")]
        kind = pin.ContactType.CONTACT_6D
        weld = pin.RigidConstraintModel(kind, model, a.parentJoint, a.placement, b.parentJoint, b.placement, pin.LOCAL)
        welds, data = pin.StdVec_RigidConstraintModel([weld]), model.createData()
        weld_data = pin.StdVec_RigidConstraintData([weld.createData()])
        settings = pin.ProximalSettings(1e-14, 1e-8, 20)
        pin.initConstraintDynamics(model, data, welds, weld_data)
        q, v, tau = self.plant.q, self.plant.v, self.tau
        return lambda: pin.constraintDynamics(model, data, q, v, tau, welds, weld_data, settings)

    def tasks(self) -> dict[str, Task]:
        """Return what is timed, by name."""
        plant, t, measured, reference = self.plant, self.time, self.measurements[0], self.references[0]
        law, state = next(iter(self.controller.controllers.values())), self.state[0]
        sensor, rows, angles = self.sensors[0], law.rows, plant.q[self.chain.tree.arms[0].q]
        target, squeeze = self.motion.at(t), self.squeeze.at(t)
        h = self.scenario.clock.period / self.scenario.clock.steps_per_tick
        return {
            UNIT: self.constraint_dynamics(),
            "ProximalSolver.acceleration": lambda: self.chain.chain.solver.acceleration(plant.q, plant.v, self.tau),
            "one arm's tick of law (23), kinematics included": lambda: law.step(
                sensor.measure(t, plant.q, plant.v, None), reference, state
            ),
            "  ArmSensor.measure": lambda: sensor.measure(t, plant.q, plant.v, None),
            "    ArmKinematics.view": lambda: sensor._kinematics.view(angles),
            "  SlidingModeController.step": lambda: law.step(measured, reference, state),
            "    jacobian_inverse": lambda: jacobian_inverse(measured.payload_jacobian, t),
            "    pose_error": lambda: rows.pose_error(measured.payload_pose, reference.pose),
            "both arms": lambda: self.controller.step(self.measure(), self.references, self.state),
            "RK4 step of the plant": lambda: plant._integrator.step(plant._rate, plant.q, plant.v, h),
            "  rate (one of its four)": lambda: plant._rate(plant.q, plant.v),
            "    friction": lambda: plant.drives.friction(plant.v),
            "Recorder.record": lambda: self.recorder.record(0, t, self.measurements, self.torques, target, squeeze),
            "  CellChain.observe": lambda: plant.observe(),
            "closure guard (gaps)": lambda: self.chain.gaps(plant.q),
            "motion and squeeze": lambda: (self.motion.at(t), self.squeeze.at(t)),
        }


def whole_run(scenario: cp.Scenario, seconds: dict[str, np.ndarray]) -> list[str]:
    """Return lines that say where the time of a whole run goes."""
    ticks = Timeline(scenario.clock, scenario.duration, scenario.events).ticks
    first: list[float] = []
    start = time.perf_counter()
    controller = build_controller(scenario)
    cp.simulate(scenario, controller, lambda *_: first.append(time.perf_counter()))
    end = time.perf_counter()
    unit, loop = float(np.median(seconds[UNIT])), first[-1] - first[0]
    steps = scenario.clock.steps_per_tick * float(np.median(seconds["RK4 step of the plant"]))
    both, kept = float(np.median(seconds["both arms"])), float(np.median(seconds["Recorder.record"]))
    shares = {
        "set-up and first tick": first[0] - start,
        "plant steps": ticks * steps,
        "both arms' sensing and law": ticks * both,
        "recording": ticks * kept,
        "events, references, guards, loop": loop - ticks * (steps + both + kept),
        "labelling the result": end - first[-1],
    }
    total = end - start
    title = f"whole run: {ticks} ticks, {total / unit / ticks:.0f} units a tick, {scenario.duration / total:.0f} times real time here"
    return [title, *(f"  {name:46s} {100 * share / total:5.1f} %" for name, share in shares.items())]


def main(arguments: list[str] | None = None) -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--blocks", type=int, default=40)
    parser.add_argument("--calls", type=int, default=100)
    parser.add_argument("--duration", type=float, default=20.0, help="of the whole run, s")
    options = parser.parse_args(arguments)
    bench = Bench()
    seconds = interleaved(bench.tasks(), options.blocks, options.calls)
    print(f"unit: one {UNIT} call on the rooted planar chain, {1e6 * np.median(seconds[UNIT]):.2f} us here; median (min .. max)")
    for name, values in seconds.items():
        print(f"{name:48s} {ratio(values, seconds[UNIT])}")
    events = bench.scenario.events if options.duration == bench.scenario.duration else ()
    print(*whole_run(bench.scenario.replace(duration=options.duration, events=events), seconds), sep="\n")


if __name__ == "__main__":
    main()
