"""Code of whole runs: the kernels of a tick, and the program that calls them.

A tick is that of coop_pin.simulation: sense, events, law and actuation, observe and record, plant steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.batch import elementary
from coop_pin.batch.arm_dynamics import gravity_torque
from coop_pin.batch.cell_dynamics import CellMotion, CellState, cell_motion, payload_energy
from coop_pin.batch.kernel import Kernel
from coop_pin.batch.law_code import only_tracing_errors
from coop_pin.batch.run_block import RunBlock
from coop_pin.batch.run_constants import RunConstants
from coop_pin.batch.serial_arm import Numbers, frames
from coop_pin.batch.tape import Number
from coop_pin.batch.traced_array import traced
from coop_pin.batch.tree import SharedFunctions, leaves, rebuilt
from coop_pin.control import ArmMeasurement
from coop_pin.simulation.actuation import TORQUE_LIMIT, TorqueResponse
from coop_pin.simulation.encoder import EncoderState
from coop_pin.simulation.simulation import CLOSURE_ERROR_LIMIT, SPEED_LIMIT
from coop_pin.spatial import rotate_vector6

STAGES = ((0.0, 1.0 / 6.0), (0.5, 1.0 / 3.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 6.0))
"""Of the classical Runge-Kutta method: nodes, also the coefficients of the stage before, and weights."""


KERNELS = ("start", "law", "observe", "step", "sense", "drive", "release")
"""Kernels of every program, in order."""
_RESPONSE = ("target", "sign", "ramp", "rest")
"""Fields of a TorqueResponse that change."""


class Drives(NamedTuple):
    """What is measured of the joints of an arm.

    Attributes:
        angles: of the joints, shape (n,).
        q: drive coordinates, shape (k,).
        v: drive velocities, shape (k,).
    """

    angles: Numbers
    q: Numbers
    v: Numbers


class RunCode:
    """Kernels of the runs of a block."""

    def __init__(self, block: RunBlock) -> None:
        self._block, self._shape = block, block.shape
        self._functions = SharedFunctions()
        self._state: Any = None

    def kernels(self) -> list[Kernel]:
        """Return the kernels: those of KERNELS, and one for each instant of events."""
        made = [getattr(self, f"_{name}")() for name in KERNELS]
        return made + [self._event(index) for index in range(len(self._block.constants.instants))]

    def _measurements(
        self, kernel: Kernel, constants: RunConstants, drives: Sequence[Drives], **first: Sequence[Any]
    ) -> list[ArmMeasurement]:
        """Return what the arms measure, from the wrenches in the block and the drives given.

        Args:
            kernel: of the tick.
            constants: as the kernel reads them.
            drives: of each arm.
            first: fields of the first tick, one for each arm.
        """
        block, shape, made = self._block, self._shape, []
        saturated, ages = block.split(kernel.read("saturated")), block.signal(kernel, "wrist_age")
        for index, (arm, own) in enumerate(zip(constants.arms, drives, strict=True)):
            has_wrist = shape.has_wrist[index]
            others = {
                "time": block.signal(kernel, "time"),
                "internal_wrench": kernel.read("measured")[index] if shape.delay is not None else None,
                "saturated": saturated[index],
                "internal_wrench_age": block.signal(kernel, "age"),
                "interaction_wrench": shape.rows.select(kernel.read("readings")[index])
                if has_wrist
                else None,
                "interaction_wrench_age": ages[index],
            }
            others |= {name: values[index] for name, values in first.items()}
            made.append(arm.measurement(shape.rows, *own, **others))
        return made

    def _drives(self, kernel: Kernel, constants: RunConstants) -> list[Drives]:
        """Return what is measured of the joints of each arm at the tick: read, or the truth."""
        split, made = self._block.split, []
        q, v = split(kernel.read("q")), split(kernel.read("v"))
        for index, (arm, is_read) in enumerate(zip(constants.arms, self._shape.has_encoders, strict=True)):
            if is_read:
                seen_q, seen_v = (split(kernel.read(name))[index] for name in ("seen_q", "seen_v"))
                made.append(Drives(traced(arm.to_joints.dot(seen_q)), seen_q, seen_v))
            else:
                made.append(Drives(q[index], arm.drive.dot(q[index]), arm.drive.dot(v[index])))
        return made

    def _read_encoders(self, kernel: Kernel, constants: RunConstants, *, is_first: bool) -> list[Drives]:
        """Return what the encoders read at a tick, or the truth, and write it."""
        block = self._block
        if not any(self._shape.has_encoders):
            return self._drives(kernel, constants)
        q, v, noise = (
            block.split(values)
            for values in (kernel.read("q"), kernel.read("v"), block.signal(kernel, "encoder_noise"))
        )
        before, after, made = [block.split(row) for row in kernel.read("estimates")], [], []
        for index, arm in enumerate(constants.arms):
            seen_q, seen_v, angles = arm.drive.dot(q[index]), arm.drive.dot(v[index]), q[index]
            state = EncoderState(seen_q, seen_v)
            if arm.encoders is not None:
                last = None if is_first else EncoderState(*(row[index] for row in before))
                seen_q, seen_v, state = arm.encoders.read(seen_q, seen_v, noise[index], last)
                angles = traced(arm.to_joints.dot(seen_q))
            made.append(Drives(angles, seen_q, seen_v))
            after.append(state)
        for name, values in (
            ("seen_q", [own.q for own in made]),
            ("seen_v", [own.v for own in made]),
            ("estimates", [part for parts in zip(*after, strict=True) for part in parts]),
        ):
            kernel.write(name, np.concatenate(values))
        return made

    def _read_wrists(
        self, kernel: Kernel, constants: RunConstants, drives: Sequence[Drives], F: Numbers, R_WP: Numbers
    ) -> Numbers:
        """Return the newest sample of each wrist that has arrived, shape (m, 6), and write them.

        Args:
            kernel: of the tick.
            constants: as the kernel reads them.
            drives: of each arm.
            F: true wrench on each arm about P in world axes, shape (m, 6).
            R_WP: true orientation of the payload, shape (3, 3).
        """
        errors, arrived = (self._block.signal(kernel, name) for name in ("wrist_error", "wrist_arrived"))
        before, readings = kernel.read("readings"), []
        for index, (arm, own, delay) in enumerate(
            zip(constants.arms, drives, self._shape.wrist_delays or (), strict=True)
        ):
            F_P = rotate_vector6(traced(R_WP).T, traced(F[index]))
            sample = rotate_vector6(traced(frames(arm.seen, own.angles).R_WP), F_P + errors[index])
            if delay:
                late = kernel.read(f"late_{index}")
                kernel.write(f"late_{index}", np.concatenate((late[1:], sample[None])))
                sample = late[0]
            readings.append(np.where(arrived[index], sample, before[index]))
        kernel.write("readings", np.stack(readings))
        return np.stack(readings)

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
        """Return the kernel of the first tick before the law: measurements, its state, and f_m[0] = f_d."""
        kernel, constants = self._block.kernel("start")
        references = self._block.arm_references(kernel)
        drives = self._read_encoders(kernel, constants, is_first=True)
        first: dict[str, Sequence[Any]] = {"holding_torque": self._block.split(kernel.read("holding"))}
        if self._shape.wrist_delays is not None:
            weight = np.concatenate((constants.cell.payload.mass * constants.cell.gravity, np.zeros(3)))
            loads = np.stack([arm.share * weight for arm in constants.arms])
            own, *_ = self._block.split(kernel.read("q"))
            R_WP = frames(constants.cell.arms[0], own).R_WP
            readings = self._read_wrists(kernel, constants, drives, loads, R_WP)
            first["interaction_wrench"] = [
                traced(self._shape.rows.select(wrench)) if has_wrist else None
                for wrench, has_wrist in zip(readings, self._shape.has_wrist, strict=True)
            ]
        measurements = self._measurements(kernel, constants, drives, **first)
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
        measurements = self._measurements(kernel, constants, self._drives(kernel, constants))
        with only_tracing_errors():
            command = constants.controller.step(measurements, references, state)
            kernel.write("law", command.state)
        commanded = [traced(torque) for torque in command.torques]
        self._actuate(kernel, constants, commanded)
        kernel.write("seen_poses", np.stack([seen.payload_pose for seen in measurements]))
        kernel.write("jacobians", np.concatenate([seen.payload_jacobian.ravel() for seen in measurements]))
        kernel.write("commanded", np.concatenate(commanded))
        self._guard(kernel, [elementary.less(abs(u), TORQUE_LIMIT) for part in commanded for u in part])
        return kernel

    def _actuate(self, kernel: Kernel, constants: RunConstants, commanded: Sequence[Numbers]) -> None:
        """Write what the drives make of commands: see coop_pin.description.actuators."""
        split, missed = self._block.split, self._block.signal(kernel, "missed")
        q, last = split(kernel.read("q")), split(kernel.read("last"))
        arrived, requested = list(commanded), []
        for index, (arm, body) in enumerate(zip(constants.arms, constants.cell.arms, strict=True)):
            if self._shape.misses[index]:
                arrived[index] = np.where(missed[index], last[index], commanded[index])
            asked = arrived[index]
            if arm.carried is not None:
                weight = traced(gravity_torque(body, constants.cell.gravity, q[index]))
                asked = asked + arm.carried * arm.to_joints.T.dot(weight)
            requested.append(asked)
        torques = [
            np.minimum(np.maximum(asked, -arm.limit), arm.limit)
            for arm, asked in zip(constants.arms, requested, strict=True)
        ]
        saturated = np.concatenate(
            [np.not_equal(torque, asked) for torque, asked in zip(torques, requested, strict=True)]
        )
        if constants.response is not None:
            response = self._response(kernel, constants.response)
            response = response.follow(kernel.uniform("s"), traced(np.concatenate(torques)))
            saturated = np.maximum(saturated, response.is_limited(constants.period))
            kernel.write("response", np.stack([getattr(response, name) for name in _RESPONSE]))
            torques = self._acting(kernel, response.at(0.0))
        if any(self._shape.misses):
            kernel.write("last", np.concatenate(arrived))
        if any(arm.carried is not None for arm in constants.arms):
            kernel.write("requested", np.concatenate(requested))
        kernel.write("torque", np.concatenate(torques))
        kernel.write("saturated", saturated)
        self._hold(kernel, constants, torques)

    def _response(self, kernel: Kernel, start: TorqueResponse) -> TorqueResponse:
        """Return the response of the drives as it is."""
        return start._replace(**dict(zip(_RESPONSE, kernel.read("response"), strict=True)))

    def _acting(self, kernel: Kernel, torques: Numbers) -> list[Numbers]:
        """Return the torques of each arm, zero where they are lost."""
        parts = zip(kernel.uniform("gives"), self._block.split(torques), strict=True)
        return [gives * torque for gives, torque in parts]

    def _hold(self, kernel: Kernel, constants: RunConstants, torques: Sequence[Numbers]) -> None:
        """Write the generalised force of drive torques."""
        forces = [arm.drive.T.dot(torque) for arm, torque in zip(constants.arms, torques, strict=True)]
        kernel.write("force", np.concatenate(forces))

    def _drive(self) -> Kernel:
        """Return the kernel before a plant step: the mean force of varying torques over it."""
        return self._varying("drive", lambda response, s, h: response.mean(s, h))

    def _release(self) -> Kernel:
        """Return the kernel at the end of a tick: the force of varying torques there."""
        return self._varying("release", lambda response, s, _: response.at(s))

    def _varying(self, name: str, torques: Callable[[TorqueResponse, Any, Any], Numbers]) -> Kernel:
        kernel, constants = self._block.kernel(name)
        if constants.response is not None:
            response = self._response(kernel, constants.response)
            now = torques(response, kernel.uniform("s"), kernel.uniform("h"))
            self._hold(kernel, constants, self._acting(kernel, now))
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
        """Return the kernel of sensors: encoders, wrists, and the force path f_m <- p f_m + (1 - p) f."""
        kernel, constants = self._block.kernel("sense")
        drives, wrists = self._read_encoders(kernel, constants, is_first=False), self._shape.wrist_delays
        if self._shape.delay is None and wrists is None:
            return kernel
        motion, _ = self._motion(kernel, constants, kernel.read("q"), kernel.read("v"))
        wrenches = motion.wrenches
        if wrists is not None:
            wrenches = self._read_wrists(kernel, constants, drives, wrenches, motion.R_WP)
        if self._shape.delay is not None:
            self._send(kernel, constants, wrenches)
        return kernel

    def _send(self, kernel: Kernel, constants: RunConstants, wrenches: Numbers) -> None:
        """Write the internal wrenches that have arrived and passed the filter."""
        shares = np.array([arm.share for arm in constants.arms], dtype=object)
        internal = wrenches - shares[:, None] * wrenches.sum(axis=0)
        sample = np.stack([self._shape.rows.select(wrench) for wrench in internal])
        if self._shape.delay:
            late = kernel.read("late")
            kernel.write("late", np.concatenate((late[1:], sample[None])))
            sample = late[0]
        p, before = constants.pole, kernel.read("measured")
        filtered = p * before + (1.0 - p) * sample
        kernel.write("measured", np.where(self._block.signal(kernel, "arrived"), filtered, before))

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
