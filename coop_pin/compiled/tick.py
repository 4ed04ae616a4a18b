"""Code of a tick: kernels of the sensors, law, drives, observation, plant steps and events of runs.

Sensors and drives are the functions of coop_pin.simulation, called with traced numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from coop_pin.base.spatial.generic_numbers import inverse
from coop_pin.compiled.block import RunBlock
from coop_pin.compiled.constants import Desired, RunConstants, RunSignals
from coop_pin.compiled.laws.law_code import law_code
from coop_pin.compiled.plant.arm_dynamics import newton_euler
from coop_pin.compiled.plant.cell_dynamics import CellMotion, CellState, cell_motion, energy_gain
from coop_pin.compiled.plant.plant_code import write_observed, write_step
from coop_pin.compiled.plant.serial_arm import Numbers, frames
from coop_pin.control import ArmMeasurement, ArmReference
from coop_pin.control.measurement import Outgoing, SentIf
from coop_pin.description.events import Surroundings
from coop_pin.results.energies import WORK
from coop_pin.simulation.devices.actuation import TORQUE_LIMIT
from coop_pin.simulation.devices.drives import Applied, DriveMotion, DriveState, Given
from coop_pin.simulation.devices.exchange import heard
from coop_pin.simulation.devices.network import Mail, NetworkSignals, said
from coop_pin.simulation.devices.sensors import Truth, View
from coop_pin.simulation.devices.torque_response import TorqueResponse
from coop_pin.simulation.plant import CLOSURE_ERROR_LIMIT, SPEED_LIMIT
from coop_pin.tracing.comparisons import less
from coop_pin.tracing.elementary import sqrt
from coop_pin.tracing.kernel import Kernel
from coop_pin.tracing.tape import Number
from coop_pin.tracing.traced_array import masks, traced
from coop_pin.tracing.tree import SharedFunctions, leaves, rebuilt


class TickCode:
    """Kernels of the runs of a block.

    Attributes:
        law: state of the law, once there are kernels.
    """

    def __init__(self, block: RunBlock, *, exact: bool) -> None:
        """Begin without code; ``exact`` as of law_code."""
        self._block, self._exact = block, exact
        self._functions = SharedFunctions()
        self._sensors: Any = None
        self._network: Any = None
        self.law: Any = None

    def kernels(self) -> list[Kernel]:
        """Return the kernels, the last of which are one for each instant of events."""
        start = self._start()  # it adds the slots of the states of sensors and law
        return [
            *(start, self._tick(), *self._in_motion(), self._step()),
            *map(self._sample, self._block.constants.drives.samples()),
            self._varying("drive", lambda response, state, s, h: response.mean(state, s, h)),
            self._varying("release", lambda response, state, s, _: response.at(state, s)),
        ]

    # ------------------------------------------------------------ kernels

    def _start(self) -> Kernel:
        """Return the kernel before the first tick: states of sensors and law, and the wrenches at rest."""
        kernel, constants = self._block.kernel("start")
        signals, weight = self._block.signals_at(kernel), constants.cell.surroundings
        references = self._block.references(signals)
        truth, view = self._truth(kernel, constants, signals)
        if constants.sensors.wrists:
            loads = constants.sensors.at_rest(weight.mass, weight.gravity)
            at_rest = frames(constants.cell.arms[0], truth.angles[0])
            truth = truth._replace(wrenches=traced(loads), R_WP=traced(at_rest.R_WP))
            kernel.write("interaction_wrench", loads)
            kernel.write("payload_pose", np.concatenate((at_rest.R_WP, at_rest.p_WP[:, None]), axis=1))
        self._sensors = constants.sensors.start(truth, view, references)
        measurements, _ = constants.sensors.step(self._sensors, truth, view)
        holding = constants.cell.by_arm(kernel.read("holding"))
        with law_code(kernel.tape, exact=self._exact):
            measurements, _ = self._heard(constants, signals, measurements, references, None)
            self.law = constants.controller.init(
                [
                    measurement._replace(holding_torque=torque)
                    for measurement, torque in zip(measurements, holding, strict=True)
                ],
                references,
            )
        for name, state in (("sensors", self._sensors), ("network", self._network), ("law", self.law)):
            self._block.lanes.add(**{name: (len(leaves(state)),)})
            kernel.write(name, state)
        self._guard(kernel, [])
        return kernel

    def _truth(self, kernel: Kernel, constants: RunConstants, signals: RunSignals) -> tuple[Truth, View]:
        """Return what the sensors sense at a tick, and the kinematics of the arms."""
        q, v = (constants.cell.by_arm(kernel.read(name)) for name in "qv")
        applied: Applied = rebuilt(self._block.applied, iter(kernel.read("applied")))
        truth = Truth(
            time=signals.desired.time,
            angles=q,
            rates=v,
            signals=signals.drawn.sensors,
            applied=applied._replace(saturated=[masks(cut) for cut in applied.saturated]),
            wrenches=kernel.read("interaction_wrench"),
            R_WP=kernel.read("payload_pose")[:, :3],
        )
        return truth, partial(constants.view, q)

    def _tick(self) -> Kernel:
        """Return the kernel of sensors, law and drives."""
        kernel, constants = self._block.kernel("tick")
        signals = self._block.signals_at(kernel)
        sensors, network, law = (
            rebuilt(state, iter(kernel.read(name)))
            for name, state in (("sensors", self._sensors), ("network", self._network), ("law", self.law))
        )
        measurements, sensors = constants.sensors.step(sensors, *self._truth(kernel, constants, signals))
        references = self._block.references(signals)
        with law_code(kernel.tape, exact=self._exact):
            measurements, network = self._heard(constants, signals, measurements, references, network, law)
            command = constants.controller.step(measurements, references, law)
            kernel.write("law", command.state)
        commanded = [traced(values) for values in command.values]
        applied, drives = constants.drives.step(
            self._drives(kernel),
            commanded,
            signals.drawn.missed,
            self._sensed(kernel, constants),
            Given(*kernel.uniform("gives")),
            kernel.uniform("s"),
        )
        kernel.write("sensors", sensors)
        kernel.write("network", network)
        kernel.write("drives", drives)
        kernel.write("applied", applied._replace(servo_commands=()))
        self._hold(kernel, constants, applied.torques)
        self._record(kernel, measurements, applied)
        self._guard(kernel, [less(abs(u), TORQUE_LIMIT) for part in commanded for u in part])
        return kernel

    def _heard(
        self,
        constants: RunConstants,
        signals: RunSignals,
        measurements: list[ArmMeasurement],
        references: Sequence[ArmReference],
        state: Any,
        law: Any = None,
    ) -> tuple[list[ArmMeasurement], Any]:
        """Return the measurements with own clocks and messages, if there are any, and the network's state.

        Args:
            constants: Numbers of the run.
            signals: Signals of the tick.
            measurements: Measurements of the tick.
            references: References of the tick.
            state: State of the network; None before the first tick, whose messages are said again.
            law: State of the law; None before the first tick.
        """
        for index, clocked in enumerate(signals.clocked):
            if isinstance(clocked, Desired):
                shown: Any = clocked.time
                measurements[index] = measurements[index]._replace(time=shown)
        network, timing = constants.network, signals.drawn.network
        if network is None or not isinstance(timing, NetworkSignals):
            return measurements, None

        def exchange(messages: Sequence[Outgoing]) -> list[Mail]:
            nonlocal state
            sent = [SentIf(traced(numbers), condition) for numbers, condition in map(said, messages)]
            if state is None:
                self._network = state = network.start(sent)
            mail, state = network.step(state, sent, timing)
            return mail

        return heard(constants.controller, measurements, references, law, exchange), state

    def _record(self, kernel: Kernel, measurements: Sequence[ArmMeasurement], applied: Applied) -> None:
        """Write what is recorded of measurements and torques; NaN of what an arm does not measure."""
        jacobians = [measurement.payload_jacobian for measurement in measurements]
        kernel.write("jacobians", np.concatenate([J.ravel() for J in jacobians]))
        kernel.write("condition_bounds", [_condition_bound(J) for J in jacobians])
        for name, (read, is_of_drives) in self._block.read.items():
            absent: Any = np.full(self._block.lanes.slots(name).shape or (1,), np.nan)
            if is_of_drives:  # those of all arms are in one row
                absent = self._block.constants.cell.by_arm(absent)
            pairs = zip(absent, read(measurements, applied), strict=True)
            kernel.write(name, [traced(none if value is None else value) for none, value in pairs])

    def _sensed(self, kernel: Kernel, constants: RunConstants) -> DriveMotion:
        """Return what the drives sense."""
        arms, gravity = constants.sensors.arms, constants.cell.surroundings.gravity
        q, v = (constants.cell.by_arm(kernel.read(name)) for name in "qv")

        def torque(index: int, gravity: Numbers, rates: Numbers, accelerations: Numbers) -> Numbers:
            tau, *_ = newton_euler(constants.cell.arms[index], gravity, q[index], rates, accelerations)
            return arms[index].to_joints.T.dot(traced(tau))

        def inertial(index: int, accelerations: Numbers) -> Numbers:
            return torque(index, np.zeros(3), v[index], arms[index].to_joints.dot(accelerations))

        return DriveMotion(
            weight=lambda index: torque(index, gravity, *np.zeros((2, len(q[index])))),
            motion=lambda index: (arms[index].drive.dot(q[index]), arms[index].drive.dot(v[index])),
            inertial=inertial,
        )

    def _sample(self, due: Sequence[int]) -> Kernel:
        """Return the kernel of samples of the servos of arms within a tick."""
        kernel, constants = self._block.kernel(sample_name(due))
        torques, drives = constants.drives.sample(
            self._drives(kernel),
            due,
            self._sensed(kernel, constants),
            Given(*kernel.uniform("gives")),
            kernel.uniform("s"),
        )
        kernel.write("drives", drives)
        self._hold(kernel, constants, torques)
        return kernel

    def _drives(self, kernel: Kernel) -> DriveState:
        """Return the memory of the drives."""
        return rebuilt(self._block.drives, iter(kernel.read("drives")))

    def _hold(self, kernel: Kernel, constants: RunConstants, torques: Sequence[Numbers]) -> None:
        """Write the generalised force of drive torques."""
        forces = [
            arm.drive.T.dot(torque) for arm, torque in zip(constants.sensors.arms, torques, strict=True)
        ]
        kernel.write("force", np.concatenate(forces))

    def _varying(self, name: str, torques: Callable[[TorqueResponse, Any, Any, Any], Numbers]) -> Kernel:
        """Return the kernel of varying torques: "drive" before a plant step, "release" at the end of a tick.

        Args:
            name: Name of the kernel.
            torques: Function of response, state, time since the command and step; returns torques.
        """
        kernel, constants = self._block.kernel(name)
        drives = constants.drives
        if drives.response is not None:
            now = torques(drives.response, self._drives(kernel).response, *map(kernel.uniform, ("s", "h")))
            self._hold(kernel, constants, drives.acting(now, Given(*kernel.uniform("gives"))))
        return kernel

    def _in_motion(self) -> list[Kernel]:
        """Return the kernels that need the motion under the held torques, which is traced once.

        "observe" writes what is recorded of the state and the forces on it, and the rates; "rates" the rates
        after another step of a tick; "weigh" what wrist sensors and force path sense before a later tick. The
        slots of the wrenches serve both: a tick reads what "weigh" wrote, the record what "observe" wrote.
        """
        observe, constants = self._block.kernel("observe")
        cell = self._block.present_cell(observe, constants)
        motion = cell_motion(self._functions, cell, CellState.of(observe))
        observe.write("rates", motion.rates)
        write_observed(observe, constants.cell, motion)
        bounds = [less(abs(rate), SPEED_LIMIT) for rate in observe.read("v")]
        bounds += [less(error, CLOSURE_ERROR_LIMIT) for error in motion.closure_errors.ravel()]
        self._guard(observe, bounds)
        rates, weigh = observe.on_same_tape("rates"), observe.on_same_tape("weigh")
        rates.write("rates", motion.rates)
        if constants.sensors.needs_wrenches:
            weigh.write("interaction_wrench", motion.observation.interaction_wrench)
            weigh.write("payload_pose", motion.observation.payload_pose)
        instants = constants.changes[1:]
        events = [observe.on_same_tape(f"event_{index}") for index in range(len(instants))]
        for event, changed in zip(events, instants, strict=True):
            _happen(event, cell.surroundings, changed, motion)
        return [observe, rates, weigh, *events]

    def _step(self) -> Kernel:
        """Return the kernel of one plant step of h."""
        kernel, constants = self._block.kernel("step")
        write_step(kernel, self._functions, self._block.present_cell(kernel, constants))
        return kernel

    def _guard(self, kernel: Kernel, conditions: Sequence[Number]) -> None:
        """Keep in mind whether all conditions of a valid run have held so far."""
        is_valid = kernel.read("is_valid")
        for condition in (*conditions, *kernel.tape.guards):
            is_valid = is_valid * condition
        kernel.write("is_valid", is_valid)


def sample_name(due: Sequence[int]) -> str:
    """Return the name of the kernel of samples of the servos of arms."""
    return "_".join(map(str, ("sample", *due)))


def _happen(event: Kernel, before: Surroundings, changed: Mapping[str, Any], motion: CellMotion) -> None:
    """Write the surroundings from an instant of events on, and the work of the change.

    Args:
        event: Kernel of the instant.
        before: Surroundings until then.
        changed: Those fields of the surroundings that events change.
        motion: Motion in the surroundings until then.
    """
    event.write("surroundings", changed)
    if {*changed} - {"push"}:  # whose gain is zero: a push does its work while it lasts
        gain = energy_gain(before, before._replace(**changed), motion)
        *works, last = event.read("work")[: len(WORK)]
        event.write("work", [*works, last + gain, *event.read("work")[len(WORK) :]])


def _condition_bound(J: Numbers) -> Number:
    """Return an upper bound of the condition number of J, NaN or inf if it is singular.

    By the Frobenius norms of J and its inverse, or those of its smaller Gram matrix.
    """
    if len(J) == J.shape[1]:
        return inverse(J)[1]
    return sqrt(inverse(J.dot(J.T) if len(J) < J.shape[1] else J.T.dot(J))[1])
