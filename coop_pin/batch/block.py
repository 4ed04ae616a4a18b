"""Block of the runs of a program: its slots, and how kernels read constants and signals from it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.batch.cell_dynamics import CellNumbers
from coop_pin.batch.constants import RunConstants, Start
from coop_pin.batch.plant_code import observed
from coop_pin.batch.signals import RunSignals
from coop_pin.control import ArmReference
from coop_pin.results.quantities import Quantity, shape_of
from coop_pin.simulation.drives import Applied
from coop_pin.tracing.kernel import Kernel, Layout
from coop_pin.tracing.traced_array import traced
from coop_pin.tracing.tree import leaves, rebuilt


class SignalSplit(NamedTuple):
    """Signals of all runs, split by what must be given to the code.

    Attributes:
        example: signals of a tick, for their names and shapes.
        constants: entries that never change, else anything, shape (entries,).
        is_uniform: mask of the entries that change in time, alike in all runs, shape (entries,).
        is_loaded: mask of the entries that differ between runs, shape (entries,).
    """

    example: RunSignals
    constants: Array
    is_uniform: Mask
    is_loaded: Mask


class RunBlock:
    """Slots of the runs of a family.

    Attributes:
        constants: constants of one of them.
        start: start of that run.
        signals: signals of all runs.
        lanes: slots of a block.
        uniforms: numbers that all runs share at a row.
        recorded: number of slots that are recorded, the first ones.
        loaded: number of slots after them that are loaded at each tick.
        applied: torques before the first tick.
        read: functions that read quantities at a tick, see Quantity, and whether they are of drives, by name.
    """

    def __init__(
        self,
        constants: RunConstants,
        start: Start,
        differs: Mask,
        signals: SignalSplit,
        table: Sequence[Quantity],
    ) -> None:
        """Lay out the block.

        Args:
            constants: Constants of one of them.
            start: Start of that run.
            differs: Leaves of the constants that differ between the runs.
            signals: Signals of all runs.
            table: Quantities of the runs.
        """
        self.constants, self.signals, self._differs = constants, signals, differs
        self.start, self.read = (
            start,
            {each.name: (each.read, each.dims == "arm joint") for each in table if each.read},
        )
        m, N, k_0 = len(constants.arms), constants.cell.joints, constants.sensors.rows.size
        nq, nv, works = constants.cell.sizes
        rest = Applied.at_rest([len(arm.drive) for arm in constants.arms])
        masks: Any = rest.torques
        self.applied = rest._replace(saturated=masks)  # as numbers
        self.lanes, self.uniforms = lanes, uniforms = Layout(), Layout()
        lanes.add(q=(nq,), v=(nv,), work=(works,), is_valid=(), **observed(constants.cell))
        lanes.add(jacobians=(k_0 * N,), condition_bounds=(m,))
        lanes.add(**{each.name: shape_of(each, m, N, k_0) for each in table if each.read})
        self.recorded = lanes.size
        lanes.add(signals=(int(signals.is_loaded.sum()),))
        self.loaded = lanes.size - self.recorded
        lanes.add(force=(N,), rates=(nv + works,), holding=(N,), applied=(len(leaves(self.applied)),))
        lanes.add(drives=(len(leaves(start.drives)),), constants=(int(differs.sum()),))
        lanes.add(surroundings=(len(leaves(constants.changes[0])),))
        uniforms.add(h=(), s=(), gives=(2, m), signals=(int(signals.is_uniform.sum()),))

    def kernel(self, name: str) -> tuple[Kernel, RunConstants]:
        """Return an empty kernel and the constants as it reads them."""
        kernel = Kernel(name, self.lanes, self.uniforms)
        inputs = iter(kernel.read("constants"))
        numbers = leaves(self.constants)
        entries = (
            next(inputs) if differs else number
            for number, differs in zip(numbers, self._differs.tolist(), strict=True)
        )
        return kernel, rebuilt(self.constants, entries)

    def present_cell(self, kernel: Kernel, constants: RunConstants) -> CellNumbers:
        """Return the constants of the cell in its present surroundings."""
        cell, changed = constants.cell, rebuilt(constants.changes[0], iter(kernel.read("surroundings")))
        return cell._replace(surroundings=cell.surroundings._replace(**changed))

    def signals_at(self, kernel: Kernel) -> RunSignals:
        """Return the signals at the kernel's tick."""
        split, entries = self.signals, np.empty(len(self.signals.constants), dtype=object)
        entries[:] = split.constants
        entries[split.is_uniform] = kernel.uniform("signals")
        entries[split.is_loaded] = kernel.read("signals")
        return rebuilt(split.example, iter(entries))

    def references(self, signals: RunSignals) -> list[ArmReference]:
        """Return the reference of each arm at a tick."""
        rows, exact = self.constants.sensors.rows, [signals.desired] * len(self.constants.arms)
        desired = [clocked or each for clocked, each in zip(signals.clocked or exact, exact, strict=True)]
        return [
            ArmReference(
                each.pose,
                traced(rows.select(each.twist)),
                traced(rows.select(each.acceleration)),
                traced(rows.select(each.squeeze[index])),
            )
            for index, each in enumerate(desired)
        ]
