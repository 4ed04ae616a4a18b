"""Code of whole runs: the kernels of a tick, and the program that calls them.

A tick is that of coop_pin.simulation: sense, events, law and actuation, observe and record, plant steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.batch import elementary
from coop_pin.batch.arm_code import Numbers, frames, payload_jacobian
from coop_pin.batch.cell_code import CellMotion, CellState, cell_motion, payload_energy
from coop_pin.batch.kernel import Kernel, Layout
from coop_pin.batch.run_constants import RunConstants
from coop_pin.batch.tape import Number
from coop_pin.batch.traced_array import traced
from coop_pin.batch.tree import SharedFunctions, leaves, rebuilt
from coop_pin.control import ArmMeasurement, ArmReference
from coop_pin.simulation.actuation import TORQUE_LIMIT
from coop_pin.simulation.simulation import CLOSURE_ERROR_LIMIT, SPEED_LIMIT
from coop_pin.spatial.task_rows import TaskRows

STAGES = ((0.0, 1.0 / 6.0), (0.5, 1.0 / 3.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 6.0))
"""Of the classical Runge-Kutta method: nodes, also the coefficients of the stage before, and weights."""


class References(NamedTuple):
    """Desired motion and squeeze at all ticks, split by what must be given to the code.

    Attributes:
        constants: entries that never change, else anything, shape (entries,).
        is_uniform: which entries change in time, alike in all runs, shape (entries,).
        is_loaded: which entries differ between runs, shape (entries,).
    """

    constants: Array
    is_uniform: Mask
    is_loaded: Mask


class RunShape(NamedTuple):
    """What runs of one program share besides numbers.

    Attributes:
        rows: task rows of the cell.
        delay: ticks of transport of the internal wrench; None without a force path.
        changes_payload: whether events change it.
        pushes: whether events push it.
    """

    rows: TaskRows
    delay: int | None
    changes_payload: bool
    pushes: bool


class RunCode:
    """Kernels of the runs of a shape.

    Attributes:
        lanes: slots of a block.
        uniforms: numbers that all runs share at a row.
        recorded: number of slots that are recorded.
    """

    def __init__(
        self, shape: RunShape, constants: RunConstants, differs: Mask, references: References
    ) -> None:
        """Lay out the block.

        Args:
            shape: of the runs.
            constants: of one of them.
            differs: which of its leaves differ between the runs.
            references: of all runs.
        """
        self._shape, self._constants, self._differs, self._references = shape, constants, differs, references
        self._functions = SharedFunctions()
        self._sizes = [len(arm.drive) for arm in constants.arms]
        m, N, k_0 = len(self._sizes), sum(self._sizes), shape.rows.size
        self.lanes, self.uniforms = lanes, uniforms = Layout(), Layout()
        for name, *sizes in (
            *(("q", N), ("v", N), ("work", 3), ("payload_energy",), ("torque", N), ("commanded", N)),
            *(("saturated", N), ("R_WP", 3, 3), ("p_WP", 3), ("V_WP", 6), ("tips", m, 3)),
            *(("wrenches", m, 6), ("closure_errors", m, 2), ("kinetic",), ("potential",), ("is_valid",)),
            *(("external", 6), ("measured", m, k_0)),
        ):
            lanes.add(str(name), *sizes)
        self.recorded = lanes.size
        lanes.add("references", int(references.is_loaded.sum()))
        self.loaded = lanes.size - self.recorded
        lanes.add("force", N)
        lanes.add("holding", N)
        lanes.add("constants", int(differs.sum()))
        lanes.add("payload", 13)
        lanes.add("late", 0 if shape.delay is None else shape.delay, m, k_0)
        uniforms.add("h")
        uniforms.add("time")
        uniforms.add("age")
        uniforms.add("arrived")
        uniforms.add("references", int(references.is_uniform.sum()))
        self._state: Any = None

    def kernels(self) -> list[Kernel]:
        """Return the kernels: start, law, observe, step, sense, and one for each instant of events."""
        made = [self._start(), self._law(), self._observe(), self._step()]
        made += [self._sense()]
        return made + [self._event(index) for index in range(len(self._constants.instants))]

    # ------------------------------------------------------------ reading

    def _kernel(self, name: str) -> tuple[Kernel, RunConstants]:
        """Return an empty kernel and the constants as it reads them."""
        kernel = Kernel(name, self.lanes, self.uniforms)
        given = iter(kernel.read("constants"))
        numbers = leaves(self._constants)
        known = (
            next(given) if differs else number
            for number, differs in zip(numbers, self._differs.tolist(), strict=True)
        )
        constants = rebuilt(self._constants, known)
        if self._shape.changes_payload:
            payload = rebuilt(constants.cell.payload, iter(kernel.read("payload")))
            constants = constants._replace(cell=constants.cell._replace(payload=payload))
        return kernel, constants

    def _split(self, values: Numbers) -> list[Numbers]:
        """Return the part of each arm."""
        return [
            traced(part) for part in np.split(np.asarray(values, dtype=object), np.cumsum(self._sizes)[:-1])
        ]

    def _references_of(self, kernel: Kernel) -> list[ArmReference]:
        split, entries = self._references, np.empty(len(self._references.constants), dtype=object)
        entries[:] = split.constants
        entries[split.is_uniform] = kernel.uniform("references")
        entries[split.is_loaded] = kernel.read("references")
        pose, twist, acceleration, squeeze = np.split(entries, (16, 22, 28))
        rows = self._shape.rows
        return [
            ArmReference(
                traced(pose.reshape(4, 4)),
                traced(rows.select(twist)),
                traced(rows.select(acceleration)),
                traced(rows.select(wrench)),
            )
            for wrench in squeeze.reshape(-1, 6)
        ]

    def _measurements(self, kernel: Kernel, constants: RunConstants, is_first: bool) -> list[ArmMeasurement]:
        has_path, made = self._shape.delay is not None, []
        parts = (self._split(kernel.read(name)) for name in ("q", "v", "saturated", "holding"))
        for index, (arm, q, v, saturated, holding) in enumerate(zip(constants.arms, *parts, strict=True)):
            seen, v_drive = frames(arm.seen, q), traced(arm.drive.dot(v))
            X_WP = np.eye(4).astype(object)
            X_WP[:3, :3], X_WP[:3, 3] = seen.R_WP, seen.p_WP
            J = traced(self._shape.rows.select(payload_jacobian(seen.S, seen.p_WP)).dot(arm.to_joints))
            made.append(
                ArmMeasurement(
                    time=kernel.uniform("time"),
                    q=traced(arm.drive.dot(q)),
                    v=v_drive,
                    payload_pose=traced(X_WP),
                    payload_twist=J.dot(v_drive),
                    payload_jacobian=J,
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
        friction = [arm.friction.force(own) for arm, own in zip(constants.arms, self._split(v), strict=True)]
        tau = [force + own for force, own in zip(self._split(kernel.read("force")), friction, strict=True)]
        external = kernel.read("external") if self._shape.pushes else np.zeros(6)
        state = CellState(self._split(q), self._split(v), tau, external)
        return cell_motion(self._functions, kernel.tape, constants.cell, state), friction

    # ------------------------------------------------------------ kernels

    def _start(self) -> Kernel:
        """Return the kernel of the first tick before the law: its state, and f_m[0] = f_d."""
        kernel, constants = self._kernel("start")
        references = self._references_of(kernel)
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
        self.lanes.add("law", len(leaves(self._state)))
        kernel.write("law", self._state)
        self._guard(kernel, [])
        return kernel

    def _law(self) -> Kernel:
        """Return the kernel of laws and actuation."""
        kernel, constants = self._kernel("law")
        references = self._references_of(kernel)
        states = rebuilt(self._state, iter(kernel.read("law")))
        commanded, torques, saturated, forces, after = [], [], [], [], []
        for arm, seen, reference, state in zip(
            constants.arms, self._measurements(kernel, constants, False), references, states, strict=True
        ):
            command = arm.law.step(seen, reference, state)
            asked = traced(command.torque)
            torque = np.minimum(np.maximum(asked, -arm.limit), arm.limit)
            commanded.append(asked)
            torques.append(torque)
            saturated += [*np.atleast_1d(elementary_differs(torque, asked))]
            forces.append(arm.drive.T.dot(torque))
            after.append(command.state)
        kernel.write("commanded", np.concatenate(commanded))
        kernel.write("torque", np.concatenate(torques))
        kernel.write("saturated", np.array(saturated, dtype=object))
        kernel.write("force", np.concatenate(forces))
        kernel.write("law", after)
        self._guard(kernel, [elementary.less(abs(u), TORQUE_LIMIT) for part in commanded for u in part])
        return kernel

    def _observe(self) -> Kernel:
        """Return the kernel of what is recorded of the state and the forces on it."""
        kernel, constants = self._kernel("observe")
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
        kernel, constants = self._kernel("step")
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
        kernel, constants = self._kernel("sense")
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
        kernel, constants = self._kernel(f"event_{index}")
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


def elementary_differs(a: Any, b: Any) -> Any:
    """Return where two arrays differ, as masks."""
    return np.not_equal(traced(a), b) * 1.0
