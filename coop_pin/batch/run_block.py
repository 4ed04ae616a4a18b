"""Block of the runs of a program: its slots, and how kernels read constants and references from it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.batch.kernel import Kernel, Layout
from coop_pin.batch.run_constants import RunConstants
from coop_pin.batch.serial_arm import Numbers
from coop_pin.batch.traced_array import traced
from coop_pin.batch.tree import leaves, rebuilt
from coop_pin.control import ArmReference
from coop_pin.spatial.task_rows import TaskRows


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


class RunBlock:
    """Slots of the runs of a shape.

    Attributes:
        shape: of the runs.
        constants: of one of them.
        references: of all runs.
        lanes: slots of a block.
        uniforms: numbers that all runs share at a row.
        recorded: number of slots that are recorded, the first ones.
        loaded: number of slots after them that are loaded at each tick.
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
        self.shape, self.constants, self.references, self._differs = shape, constants, references, differs
        self._sizes = [len(arm.drive) for arm in constants.arms]
        m, N, k_0 = len(self._sizes), sum(self._sizes), shape.rows.size
        self.lanes, self.uniforms = lanes, uniforms = Layout(), Layout()
        for name, *sizes in (
            *(("q", N), ("v", N), ("work", 3), ("payload_energy",), ("torque", N), ("commanded", N)),
            *(("saturated", N), ("R_WP", 3, 3), ("p_WP", 3), ("V_WP", 6), ("tips", m, 3)),
            *(("wrenches", m, 6), ("closure_errors", m, 2), ("kinetic",), ("potential",), ("is_valid",)),
            *(("external", 6), ("measured", m, k_0), ("seen_poses", m, 4, 4), ("jacobians", k_0 * N)),
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
        return [
            traced(part) for part in np.split(np.asarray(values, dtype=object), np.cumsum(self._sizes)[:-1])
        ]

    def arm_references(self, kernel: Kernel) -> list[ArmReference]:
        """Return the reference of each arm at the kernel's tick."""
        split, entries = self.references, np.empty(len(self.references.constants), dtype=object)
        entries[:] = split.constants
        entries[split.is_uniform] = kernel.uniform("references")
        entries[split.is_loaded] = kernel.read("references")
        pose, twist, acceleration, squeeze = np.split(entries, (16, 22, 28))
        rows = self.shape.rows
        return [
            ArmReference(
                traced(pose.reshape(4, 4)),
                traced(rows.select(twist)),
                traced(rows.select(acceleration)),
                traced(rows.select(wrench)),
            )
            for wrench in squeeze.reshape(-1, 6)
        ]
