"""Code of whole runs: the kernels of a tick, and the program that calls them.

A tick is that of coop_pin.simulation: sense, events, law and actuation, observe and record, plant steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from coop_pin.batch import elementary
from coop_pin.batch.cell_dynamics import CellMotion, CellState, cell_motion, payload_energy
from coop_pin.batch.kernel import Kernel
from coop_pin.batch.run_block import RunBlock
from coop_pin.batch.run_constants import RunConstants
from coop_pin.batch.serial_arm import Numbers
from coop_pin.batch.tape import Number
from coop_pin.batch.traced_array import traced
from coop_pin.batch.tree import SharedFunctions, leaves, rebuilt
from coop_pin.control import ArmMeasurement
from coop_pin.simulation.actuation import TORQUE_LIMIT
from coop_pin.simulation.simulation import CLOSURE_ERROR_LIMIT, SPEED_LIMIT

STAGES = ((0.0, 1.0 / 6.0), (0.5, 1.0 / 3.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 6.0))
"""Of the classical Runge-Kutta method: nodes, also the coefficients of the stage before, and weights."""


class RunCode:
    """Kernels of the runs of a block."""

    def __init__(self, block: RunBlock) -> None:
        self._block, self._shape = block, block.shape
        self._functions = SharedFunctions()
        self._state: Any = None

    def kernels(self) -> list[Kernel]:
        """Return the kernels: start, law, observe, step, sense, and one for each instant of events."""
        made = [self._start(), self._law(), self._observe(), self._step(), self._sense()]
        return made + [self._event(index) for index in range(len(self._block.constants.instants))]

    def _measurements(self, kernel: Kernel, constants: RunConstants, is_first: bool) -> list[ArmMeasurement]:
        has_path, made = self._shape.delay is not None, []
        parts = (self._block.split(kernel.read(name)) for name in ("q", "v", "saturated", "holding"))
        for index, (arm, q, v, saturated, holding) in enumerate(zip(constants.arms, *parts, strict=True)):
            made.append(
                arm.measurement(
                    self._shape.rows,
                    q,
                    arm.drive.dot(q),
                    arm.drive.dot(v),
                    time=kernel.uniform("time"),
                    internal_wrench=kernel.read("measured")[index] if has_path else None,
                    saturated=saturated,
                    internal_wrench_age=kernel.uniform("age") if has_path else np.inf,
                    holding_torque=holding if is_first else None,
                )
            )
        return made

    def _motion(
        self, kernel: Kernel, constants: RunConstants, q: Numbers, v: Numbers
    ) -> tuple[CellMotion, list[Numbers]]:
        """Return the motion under the held torques, and the friction of each arm."""
        split = self._block.split
        friction = [arm.friction.force(own) for arm, own in zip(constants.arms, split(v), strict=True)]
        tau = [force + own for force, own in zip(split(kernel.read("force")), friction, strict=True)]
        external = kernel.read("external") if self._shape.pushes else np.zeros(6)
        state = CellState(split(q), split(v), tau, external)
        return cell_motion(self._functions, kernel.tape, constants.cell, state), friction

    # ------------------------------------------------------------ kernels

    def _start(self) -> Kernel:
        """Return the kernel of the first tick before the law: its state, and f_m[0] = f_d."""
        kernel, constants = self._block.kernel("start")
        references = self._block.arm_references(kernel)
        measurements = self._measurements(kernel, constants, True)
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
        self._state = [
            arm.law.init(seen, reference)
            for arm, seen, reference in zip(constants.arms, measurements, references, strict=True)
        ]
        self._block.lanes.add("law", len(leaves(self._state)))
        kernel.write("law", self._state)
        self._guard(kernel, [])
        return kernel

    def _law(self) -> Kernel:
        """Return the kernel of laws and actuation."""
        kernel, constants = self._block.kernel("law")
        references = self._block.arm_references(kernel)
        states = rebuilt(self._state, iter(kernel.read("law")))
        commanded, torques, saturated, forces, after = [], [], [], [], []
        measurements = self._measurements(kernel, constants, False)
        for arm, seen, reference, state in zip(constants.arms, measurements, references, states, strict=True):
            command = arm.law.step(seen, reference, state)
            asked = traced(command.torque)
            torque = np.minimum(np.maximum(asked, -arm.limit), arm.limit)
            commanded.append(asked)
            torques.append(torque)
            saturated.append(np.not_equal(torque, asked))
            forces.append(arm.drive.T.dot(torque))
            after.append(command.state)
        kernel.write("seen_poses", np.stack([seen.payload_pose for seen in measurements]))
        kernel.write("jacobians", np.concatenate([seen.payload_jacobian.ravel() for seen in measurements]))
        kernel.write("commanded", np.concatenate(commanded))
        kernel.write("torque", np.concatenate(torques))
        kernel.write("saturated", np.concatenate(saturated))
        kernel.write("force", np.concatenate(forces))
        kernel.write("law", after)
        self._guard(kernel, [elementary.less(abs(u), TORQUE_LIMIT) for part in commanded for u in part])
        return kernel

    def _observe(self) -> Kernel:
        """Return the kernel of what is recorded of the state and the forces on it."""
        kernel, constants = self._block.kernel("observe")
        v = kernel.read("v")
        motion, _ = self._motion(kernel, constants, kernel.read("q"), v)
        for name in ("R_WP", "p_WP", "V_WP", "tips", "wrenches", "closure_errors", "kinetic", "potential"):
            kernel.write(name, getattr(motion, name))
        bounds = [elementary.less(abs(rate), SPEED_LIMIT) for rate in v]
        bounds += [elementary.less(error, CLOSURE_ERROR_LIMIT) for error in motion.closure_errors.ravel()]
        self._guard(kernel, bounds)
        return kernel

    def _step(self) -> Kernel:
        """Return the kernel of one plant step of h: Runge-Kutta 4, with the work of the forces."""
        kernel, constants = self._block.kernel("step")
        q, v, h = kernel.read("q"), kernel.read("v"), kernel.uniform("h")
        force = kernel.read("force")
        q_end, v_end, work = q, v, kernel.read("work")
        q_rate, v_rate = np.zeros(len(q)), np.zeros(len(v))
        for node, weight in STAGES:
            q_i, v_i = q + node * h * q_rate, v + node * h * v_rate
            motion, friction = self._motion(kernel, constants, q_i, v_i)
            q_rate, v_rate = v_i, traced(np.concatenate(motion.accelerations))
            external = kernel.read("external") @ motion.V_WP if self._shape.pushes else 0.0
            power = traced([force @ v_i, np.concatenate(friction) @ v_i, external])
            q_end, v_end = q_end + weight * h * q_rate, v_end + weight * h * v_rate
            work = work + weight * h * power
        kernel.write("q", q_end)
        kernel.write("v", v_end)
        kernel.write("work", work)
        return kernel

    def _sense(self) -> Kernel:
        """Return the kernel of the force path: f_m <- p f_m + (1 - p) f, of a sample that has arrived."""
        kernel, constants = self._block.kernel("sense")
        if self._shape.delay is None:
            return kernel
        motion, _ = self._motion(kernel, constants, kernel.read("q"), kernel.read("v"))
        shares = np.array([arm.share for arm in constants.arms], dtype=object)
        internal = motion.wrenches - shares[:, None] * motion.wrenches.sum(axis=0)
        sample = np.stack([self._shape.rows.select(wrench) for wrench in internal])
        if self._shape.delay:
            late = kernel.read("late")
            kernel.write("late", np.concatenate((late[1:], sample[None])))
            sample = late[0]
        p, before = constants.pole, kernel.read("measured")
        filtered = p * before + (1.0 - p) * sample
        kernel.write("measured", np.where(kernel.uniform("arrived"), filtered, before))
        return kernel

    def _event(self, index: int) -> Kernel:
        """Return the kernel of an instant of events: the payload and the push from then on."""
        kernel, constants = self._block.kernel(f"event_{index}")
        instant = constants.instants[index]
        if self._shape.pushes:
            kernel.write("external", instant.push)
        if self._shape.changes_payload:
            motion, _ = self._motion(kernel, constants, kernel.read("q"), kernel.read("v"))
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
