"""Block of the runs of a program: its slots, and how kernels read constants and signals from it."""

from __future__ import annotations

from typing import Any

from coop_pin.base.arrays import Mask
from coop_pin.compiled.constants import Desired, RunConstants, RunSignals
from coop_pin.compiled.plant.cell_numbers import CellNumbers
from coop_pin.compiled.plant.plant_code import observed
from coop_pin.compiled.preparation import Prepared
from coop_pin.control import ArmReference
from coop_pin.results.quantity import Quantity
from coop_pin.simulation.devices.drives import Applied
from coop_pin.simulation.tick import arm_references
from coop_pin.tracing.kernel import Kernel, Layout
from coop_pin.tracing.tree import leaves, rebuilt


class RunBlock:
    """Slots of the runs of a family.

    Attributes:
        constants: constants of one of them.
        drives: memory of the drives at the start of that run.
        differs: mask of the leaves of the constants that are slots, shape (leaves,).
        is_uniform: mask of the signals that change in time, alike in all runs, shape (entries,).
        is_loaded: mask of the signals that differ between runs, shape (entries,).
        lanes: slots of a block.
        uniforms: numbers that all runs share at a row.
        recorded: number of slots that are recorded, the first ones.
        loaded: number of slots after them that are loaded at each tick.
        applied: torques before the first tick.
        read: functions that read quantities at a tick, see Quantity, and whether they are of drives, by name.
    """

    def __init__(self, first: Prepared, differs: Mask, is_uniform: Mask, is_loaded: Mask) -> None:
        """Lay out the block.

        Args:
            first: Batch whose first run has the numbers that fold.
            differs: Mask of the constants, as the attribute.
            is_uniform: Mask of signals, likewise.
            is_loaded: Mask of signals, likewise.
        """
        plant = first.plants[0]
        self.constants, self.drives, self._signals = first.constants, plant.drives, first.signals[0][0]
        self.differs, self.is_uniform, self.is_loaded = differs, is_uniform, is_loaded
        self._example, constants, table = plant.example, self.constants, plant.read
        self.read = {each.name: (each.read, each.dims == "arm joint") for each in table if each.read}
        m, N, k_0 = len(constants.arms), constants.cell.joints, constants.sensors.rows.size
        nq, nv, works = constants.cell.sizes
        rest = Applied.at_rest([len(arm.drive) for arm in constants.sensors.arms])
        masks: Any = rest.torques
        self.applied = rest._replace(saturated=masks)  # as numbers
        self.lanes, self.uniforms = lanes, uniforms = Layout(), Layout()
        lanes.add(
            q=(nq,),
            v=(nv,),
            work=(works,),
            is_valid=(),
            closure_errors=(m, 2),
            **observed(constants.cell),
            jacobians=(k_0 * N,),
            condition_bounds=(m,),
            **{each.name: _tick_shape(each, m, N, k_0) for each in table if each.read},
        )
        self.recorded = lanes.size
        lanes.add(signals=(int(is_loaded.sum()),))
        self.loaded = lanes.size - self.recorded
        lanes.add(
            force=(N,),
            rates=(nv + works,),
            holding=(N,),
            applied=(len(leaves(self.applied)),),
            drives=(len(leaves(self.drives)),),
            constants=(int(differs.sum()),),
            surroundings=(len(leaves(constants.changes[0])),),
        )
        uniforms.add(h=(), s=(), gives=(2, m), signals=(int(is_uniform.sum()),))

    def kernel(self, name: str) -> tuple[Kernel, RunConstants]:
        """Return an empty kernel and the constants as it reads them."""
        kernel = Kernel(name, self.lanes, self.uniforms)
        inputs = iter(kernel.read("constants"))
        numbers = leaves(self.constants)
        entries = (
            next(inputs) if differs else number
            for number, differs in zip(numbers, self.differs.tolist(), strict=True)
        )
        return kernel, rebuilt(self.constants, entries)

    def present_cell(self, kernel: Kernel, constants: RunConstants) -> CellNumbers:
        """Return the constants of the cell in its present surroundings."""
        cell, changed = constants.cell, rebuilt(constants.changes[0], iter(kernel.read("surroundings")))
        return cell._replace(surroundings=cell.surroundings._replace(**changed))

    def signals_at(self, kernel: Kernel) -> RunSignals:
        """Return the signals at the kernel's tick."""
        entries = self._signals.astype(object)
        entries[self.is_uniform] = kernel.uniform("signals")
        entries[self.is_loaded] = kernel.read("signals")
        return rebuilt(self._example, iter(entries))

    def references(self, signals: RunSignals) -> list[ArmReference]:
        """Return the reference of each arm at a tick."""
        rows, desired = self.constants.sensors.rows, signals.desired
        references = arm_references(rows, desired.target, desired.squeeze)
        for index, clocked in enumerate(signals.clocked):
            if isinstance(clocked, Desired):
                references[index] = arm_references(rows, clocked.target, clocked.squeeze)[index]
        return references


def _tick_shape(quantity: Quantity, arms: int, drives: int, rows: int) -> tuple[int, ...]:
    """Return the shape of what ``read`` reads at a tick, with the drives of all arms in one row.

    Args:
        quantity: Quantity that is read at ticks.
        arms: Number of arms, m.
        drives: Number of drives of all arms.
        rows: Number of task rows, k_0.
    """
    per_arm = {"arm joint": (drives,), "arm axis": (arms, rows)}
    return per_arm.get(quantity.dims) or quantity.shape({"arm": arms})
