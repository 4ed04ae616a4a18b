"""Code of whole runs: the kernels of a tick, and the program that calls them.

A tick is that of coop_pin.simulation: sense, events, law and actuation, observe and record, plant steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from coop_pin.batch.cell_dynamics import CellMotion, payload_energy
from coop_pin.batch.law_code import only_tracing_errors
from coop_pin.batch.plant_code import OBSERVED, PlantNumbers, PlantState, plant_motion, write_step
from coop_pin.batch.run_actuation import RunActuation
from coop_pin.batch.run_block import RunBlock
from coop_pin.batch.run_constants import RunConstants
from coop_pin.batch.run_sensing import RunSensing
from coop_pin.batch.serial_arm import Numbers, frames
from coop_pin.simulation.actuation import TORQUE_LIMIT, TorqueResponse
from coop_pin.simulation.simulation import CLOSURE_ERROR_LIMIT, SPEED_LIMIT
from coop_pin.spatial.generic_numbers import inverse
from coop_pin.tracing import elementary
from coop_pin.tracing.kernel import Kernel
from coop_pin.tracing.tape import Number
from coop_pin.tracing.traced_array import traced
from coop_pin.tracing.tree import SharedFunctions, leaves, rebuilt

KERNELS = ("start", "law", "observe", "rates", "step", "sense", "drive", "release")
"""Kernels of every program, in order."""


class RunCode:
    """Kernels of the runs of a block."""

    def __init__(self, block: RunBlock) -> None:
        self._block, self._shape = block, block.shape
        self._sensing, self._actuation = RunSensing(block), RunActuation(block)
        self._functions = SharedFunctions()
        self._state: Any = None

    def kernels(self) -> list[Kernel]:
        """Return the kernels: those of KERNELS, and one for each instant of events."""
        made = [getattr(self, f"_{name}")() for name in KERNELS]
        return made + [self._event(index) for index in range(len(self._block.constants.instants))]

    def _plant(self, kernel: Kernel, constants: RunConstants) -> PlantNumbers:
        """Return the numbers of the plant with the present push."""
        external = kernel.read("external") if self._shape.pushes else np.zeros(6)
        return PlantNumbers(constants.cell, tuple(arm.friction for arm in constants.arms), external)

    def _motion(self, kernel: Kernel, constants: RunConstants) -> tuple[CellMotion, list[Number]]:
        """Return the motion under the held torques and its rates."""
        return plant_motion(self._functions, self._plant(kernel, constants), PlantState.of(kernel))

    # ------------------------------------------------------------ kernels

    def _start(self) -> Kernel:
        """Return the kernel of the first tick before the law: measurements, its state, and f_m[0] = f_d."""
        kernel, constants = self._block.kernel("start")
        references = self._block.arm_references(kernel)
        drives = self._sensing.read_encoders(kernel, constants, is_first=True)
        first: dict[str, Sequence[Any]] = {"holding_torque": self._block.split(kernel.read("holding"))}
        if self._shape.wrist_delays is not None:
            weight = np.concatenate((constants.cell.payload.mass * constants.cell.gravity, np.zeros(3)))
            loads = np.stack([arm.share * weight for arm in constants.arms])
            own, *_ = self._block.split(kernel.read("q"))
            R_WP = frames(constants.cell.arms[0], own).R_WP
            readings = self._sensing.read_wrists(kernel, constants, drives, loads, R_WP)
            first["interaction_wrench"] = [
                traced(self._shape.rows.select(wrench)) if has_wrist else None
                for wrench, has_wrist in zip(readings, self._shape.has_wrist, strict=True)
            ]
        measurements = self._sensing.measurements(kernel, constants, drives, **first)
        if self._shape.delay is not None:
            desired = [
                self._shape.rows.turn(seen.payload_pose, reference.internal_wrench)
                for seen, reference in zip(measurements, references, strict=True)
            ]
            measurements = [
                seen._replace(internal_wrench=traced(wrench))
                for seen, wrench in zip(measurements, desired, strict=True)
            ]
            kernel.write("measured", np.stack(desired))
        with only_tracing_errors():
            self._state = constants.controller.init(measurements, references)
        self._block.lanes.add("law", len(leaves(self._state)))
        kernel.write("law", self._state)
        self._guard(kernel, [])
        return kernel

    def _law(self) -> Kernel:
        """Return the kernel of laws and actuation."""
        kernel, constants = self._block.kernel("law")
        references = self._block.arm_references(kernel)
        state = rebuilt(self._state, iter(kernel.read("law")))
        measurements = self._sensing.measurements(kernel, constants, self._sensing.drives(kernel, constants))
        with only_tracing_errors():
            command = constants.controller.step(measurements, references, state)
            kernel.write("law", command.state)
        commanded = [traced(torque) for torque in command.torques]
        self._actuation.actuate(kernel, constants, commanded)
        kernel.write("seen_poses", np.stack([seen.payload_pose for seen in measurements]))
        kernel.write("jacobians", np.concatenate([seen.payload_jacobian.ravel() for seen in measurements]))
        kernel.write("condition_bounds", [_condition_bound(seen.payload_jacobian) for seen in measurements])
        kernel.write("commanded", np.concatenate(commanded))
        self._guard(kernel, [elementary.less(abs(u), TORQUE_LIMIT) for part in commanded for u in part])
        return kernel

    def _drive(self) -> Kernel:
        """Return the kernel before a plant step: the mean force of varying torques over it."""
        return self._varying("drive", lambda response, s, h: response.mean(s, h))

    def _release(self) -> Kernel:
        """Return the kernel at the end of a tick: the force of varying torques there."""
        return self._varying("release", lambda response, s, _: response.at(s))

    def _varying(self, name: str, torques: Callable[[TorqueResponse, Any, Any], Numbers]) -> Kernel:
        kernel, constants = self._block.kernel(name)
        if constants.response is not None:
            response = self._actuation.response(kernel, constants.response)
            now = torques(response, kernel.uniform("s"), kernel.uniform("h"))
            self._actuation.hold(kernel, constants, self._actuation.acting(kernel, now))
        return kernel

    def _observe(self) -> Kernel:
        """Return the kernel of what is recorded of the state and the forces on it, and of the rates."""
        kernel, constants = self._block.kernel("observe")
        motion, rates = self._motion(kernel, constants)
        kernel.write("rates", rates)
        for name in OBSERVED:
            kernel.write(name, getattr(motion, name))
        bounds = [elementary.less(abs(rate), SPEED_LIMIT) for rate in kernel.read("v")]
        bounds += [elementary.less(error, CLOSURE_ERROR_LIMIT) for error in motion.closure_errors.ravel()]
        self._guard(kernel, bounds)
        return kernel

    def _rates(self) -> Kernel:
        """Return the kernel of the rates after another step of a tick."""
        kernel, constants = self._block.kernel("rates")
        kernel.write("rates", self._motion(kernel, constants)[1])
        return kernel

    def _step(self) -> Kernel:
        """Return the kernel of one plant step of h."""
        kernel, constants = self._block.kernel("step")
        write_step(kernel, self._functions, self._plant(kernel, constants))
        return kernel

    def _sense(self) -> Kernel:
        """Return the kernel of sensors: encoders, wrists, and the force path f_m <- p f_m + (1 - p) f."""
        kernel, constants = self._block.kernel("sense")
        drives, wrists = (
            self._sensing.read_encoders(kernel, constants, is_first=False),
            self._shape.wrist_delays,
        )
        if self._shape.delay is None and wrists is None:
            return kernel
        motion, _ = self._motion(kernel, constants)
        wrenches = motion.wrenches
        if wrists is not None:
            wrenches = self._sensing.read_wrists(kernel, constants, drives, wrenches, motion.R_WP)
        if self._shape.delay is not None:
            self._sensing.send(kernel, constants, wrenches)
        return kernel

    def _event(self, index: int) -> Kernel:
        """Return the kernel of an instant of events: the payload and the push from then on."""
        kernel, constants = self._block.kernel(f"event_{index}")
        instant = constants.instants[index]
        if self._shape.pushes:
            kernel.write("external", instant.push)
        if self._shape.changes_payload:
            motion, _ = self._motion(kernel, constants)
            after = constants.cell._replace(payload=instant.payload)
            gained = payload_energy(after, motion) - payload_energy(constants.cell, motion)
            kernel.write("payload_energy", kernel.read("payload_energy") + gained)
            kernel.write("payload", leaves(instant.payload))
        return kernel

    def _guard(self, kernel: Kernel, conditions: Sequence[Number]) -> None:
        """Keep in mind whether all conditions of a valid run have held so far."""
        is_valid = kernel.read("is_valid")
        for condition in (*conditions, *kernel.tape.guards):
            is_valid = is_valid * condition
        kernel.write("is_valid", is_valid)


def _condition_bound(J: Numbers) -> Number:
    """Return an upper bound of the condition number of J, NaN or inf if it is singular.

    By the Frobenius norms of J and its inverse, or those of its smaller Gram matrix.
    """
    if len(J) == J.shape[1]:
        return inverse(J)[1]
    return elementary.sqrt(inverse(J.dot(J.T) if len(J) < J.shape[1] else J.T.dot(J))[1])
