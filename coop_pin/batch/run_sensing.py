"""Sensors of the runs of a block as traced code: encoders, wrists, force path, and what the arms measure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.batch.run_block import RunBlock
from coop_pin.batch.run_constants import RunConstants
from coop_pin.batch.serial_arm import Numbers, frames
from coop_pin.control import ArmMeasurement
from coop_pin.simulation.encoder import EncoderState
from coop_pin.spatial import rotate_vector6
from coop_pin.tracing.kernel import Kernel
from coop_pin.tracing.traced_array import traced


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


class RunSensing:
    """Sensors of a block."""

    def __init__(self, block: RunBlock) -> None:
        self._block, self._shape = block, block.shape

    def measurements(
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

    def drives(self, kernel: Kernel, constants: RunConstants) -> list[Drives]:
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

    def read_encoders(self, kernel: Kernel, constants: RunConstants, *, is_first: bool) -> list[Drives]:
        """Return what the encoders read at a tick, or the truth, and write it."""
        block = self._block
        if not any(self._shape.has_encoders):
            return self.drives(kernel, constants)
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

    def read_wrists(
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

    def send(self, kernel: Kernel, constants: RunConstants, wrenches: Numbers) -> None:
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
