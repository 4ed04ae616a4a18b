"""Block of the runs of a program: its slots, and how kernels read constants and signals from it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.batch.run_constants import RunConstants
from coop_pin.batch.serial_arm import Numbers
from coop_pin.batch.signals import RunShape
from coop_pin.control import ArmReference
from coop_pin.tracing.kernel import Kernel, Layout
from coop_pin.tracing.traced_array import parts, traced
from coop_pin.tracing.tree import leaves, rebuilt


class SignalSplit(NamedTuple):
    """Signals of all runs, split by what must be given to the code.

    Attributes:
        layout: of the entries.
        constants: entries that never change, else anything, shape (entries,).
        is_uniform: which entries change in time, alike in all runs, shape (entries,).
        is_loaded: which entries differ between runs, shape (entries,).
    """

    layout: Layout
    constants: Array
    is_uniform: Mask
    is_loaded: Mask


class RunBlock:
    """Slots of the runs of a shape.

    Attributes:
        shape: of the runs.
        constants: of one of them.
        signals: of all runs.
        lanes: slots of a block.
        uniforms: numbers that all runs share at a row.
        recorded: number of slots that are recorded, the first ones.
        loaded: number of slots after them that are loaded at each tick.
    """

    def __init__(self, shape: RunShape, constants: RunConstants, differs: Mask, signals: SignalSplit) -> None:
        """Lay out the block.

        Args:
            shape: of the runs.
            constants: of one of them.
            differs: which of its leaves differ between the runs.
            signals: of all runs.
        """
        self.shape, self.constants, self.signals, self._differs = shape, constants, signals, differs
        self._sizes = [len(arm.drive) for arm in constants.arms]
        m, N, k_0 = len(self._sizes), sum(self._sizes), shape.rows.size
        self.lanes, self.uniforms = lanes, uniforms = Layout(), Layout()
        recorded: tuple[tuple[Any, ...], ...] = (
            *(("q", N), ("v", N), ("work", 3), ("payload_energy",), ("torque", N), ("commanded", N)),
            *(("saturated", N), ("R_WP", 3, 3), ("p_WP", 3), ("V_WP", 6), ("tips", m, 3)),
            *(("wrenches", m, 6), ("closure_errors", m, 2), ("kinetic",), ("potential",), ("is_valid",)),
            *(("external", 6), ("measured", m, k_0), ("seen_poses", m, 4, 4), ("jacobians", k_0 * N)),
            ("condition_bounds", m),
            *((("seen_q", N), ("seen_v", N)) if any(shape.has_encoders) else ()),
            *((("readings", m, 6),) if shape.wrist_delays is not None else ()),
            *((("requested", N),) if any(arm.carried is not None for arm in constants.arms) else ()),
        )
        for field in recorded:
            lanes.add(*field)
        self.recorded = lanes.size
        lanes.add("signals", int(signals.is_loaded.sum()))
        self.loaded = lanes.size - self.recorded
        others: tuple[tuple[Any, ...], ...] = (
            *(("force", N), ("holding", N), ("last", N), ("response", 4, N), ("estimates", 2, N)),
            *(("rates", N + 3), ("constants", int(differs.sum())), ("payload", 13)),
            *(("late", shape.delay or 0, m, k_0),),
            *((f"late_{index}", delay, 6) for index, delay in enumerate(shape.wrist_delays or ())),
        )
        for field in others:
            lanes.add(*field)
        uniforms.add("h")
        uniforms.add("s")
        uniforms.add("gives", m)
        uniforms.add("signals", int(signals.is_uniform.sum()))

    def kernel(self, name: str) -> tuple[Kernel, RunConstants]:
        """Return an empty kernel and the constants as it reads them."""
        kernel = Kernel(name, self.lanes, self.uniforms)
        given = iter(kernel.read("constants"))
        numbers = leaves(self.constants)
        known = (
            next(given) if differs else number
            for number, differs in zip(numbers, self._differs.tolist(), strict=True)
        )
        constants = rebuilt(self.constants, known)
        if self.shape.changes_payload:
            payload = rebuilt(constants.cell.payload, iter(kernel.read("payload")))
            constants = constants._replace(cell=constants.cell._replace(payload=payload))
        return kernel, constants

    def split(self, values: Numbers) -> list[Numbers]:
        """Return the part of each arm."""
        return parts(values, self._sizes)

    def signal(self, kernel: Kernel, name: str) -> Any:
        """Return a signal at the kernel's tick."""
        split, entries = self.signals, np.empty(len(self.signals.constants), dtype=object)
        entries[:] = split.constants
        entries[split.is_uniform] = kernel.uniform("signals")
        entries[split.is_loaded] = kernel.read("signals")
        return traced(entries[split.layout.slots(name)])

    def arm_references(self, kernel: Kernel) -> list[ArmReference]:
        """Return the reference of each arm at the kernel's tick."""
        pose, twist, acceleration, squeeze = (
            self.signal(kernel, name) for name in ("pose", "twist", "acceleration", "squeeze")
        )
        rows = self.shape.rows
        twist, acceleration = traced(rows.select(twist)), traced(rows.select(acceleration))
        return [ArmReference(pose, twist, acceleration, traced(rows.select(wrench))) for wrench in squeeze]
