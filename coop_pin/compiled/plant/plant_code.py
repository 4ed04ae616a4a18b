"""Code of a cell's plant: its kernels, one Runge-Kutta step, and an observation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import log3
from coop_pin.chain.integrators import RK4
from coop_pin.compiled.plant.cell_dynamics import CellMotion, CellState, cell_motion
from coop_pin.compiled.plant.cell_numbers import CellNumbers
from coop_pin.compiled.plant.serial_arm import Numbers
from coop_pin.grasps.observation import Observation
from coop_pin.results.quantities import QUANTITIES
from coop_pin.tracing.kernel import Kernel, Layout, Program
from coop_pin.tracing.traced_array import traced
from coop_pin.tracing.tree import SharedFunctions, leaves, rebuilt

_STAGES = tuple(zip(RK4.c, RK4.b.tolist(), strict=True))
"""Nodes and weights; a stage starts from the one before alone, whose coefficient is the node."""

STEPS_AT_ONCE = 64
"""Plant steps of one call."""


def observed(cell: CellNumbers) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the fields of an Observation that a cell has, by name."""
    m, n = len(cell.arms), len(cell.compliant)
    groups = ("", "grasps", "elements") if n else ("",)
    if any(stops is not None for stops in cell.stops):
        groups = (*groups, "stops", "stopped")
    k = max(len(arm.bodies) for arm in cell.arms)
    fields = [each for each in QUANTITIES if each.name in Observation._fields and each.group in groups]
    forms = {"payload_pose": (3, 4), "grasp_deflection": (n, 3, 4), "grasp_wrench": (n, 6)}
    return {each.name: forms.get(each.name) or each.shape({"arm": m, "joint": k}) for each in fields}


def write_observed(kernel: Kernel, cell: CellNumbers, motion: CellMotion) -> None:
    """Write what is observed of a motion, and its closure errors."""
    kernel.write("closure_errors", motion.closure_errors)
    for name in observed(cell):
        kernel.write(name, getattr(motion.observation, name))


def observation_field(name: str, values: Array, of_arms: Callable[[Array], Array]) -> Array:
    """Return a field of Observation from what was written, shape (..., entries of ``observed``).

    Args:
        name: Name of the field.
        values: Numbers that were written.
        of_arms: Function of GraspSprings.
    """
    if name == "payload_pose":
        X_WP = np.zeros((*values.shape[:-2], 4, 4))
        X_WP[..., :3, :], X_WP[..., 3, 3] = values, 1.0
        return X_WP
    if name == "grasp_deflection":
        values = np.concatenate((values[..., 3], log3(values[..., :3])), axis=-1)
    return of_arms(values) if name.startswith("grasp_") else values


def write_step(kernel: Kernel, functions: SharedFunctions, cell: CellNumbers) -> None:
    """Write q, v and work after one plant step of h by Runge-Kutta 4.

    Args:
        kernel: reads q, v, force, work, h and the rates at the start of the step.
        functions: has the rates of the other stages.
        cell: Constants of the cell as the kernel reads them.
    """

    def rates_at(cell: CellNumbers, state: CellState) -> Numbers:
        return cell_motion(functions, cell, state).rates

    q, v, force = CellState.of(kernel)
    h, rates, work, nv = kernel.uniform("h"), kernel.read("rates"), kernel.read("work"), len(v)
    v_end, moved, slope = v, list[Numbers](), v
    for node, weight in _STAGES:
        if node > 0.0:
            u, v_stage = node * h * slope, v + node * h * rates[:nv]
            state = CellState(cell.displaced(q, [u]), v_stage, force)
            rates = traced(functions.call(kernel.tape, rates_at, cell, state))
            slope = cell.increment_rate(u, v_stage)
        moved.append(weight * h * slope)
        v_end, work = v_end + weight * h * rates[:nv], work + weight * h * rates[nv:]
    for name, values in (("q", cell.displaced(q, moved)), ("v", v_end), ("work", work)):
        kernel.write(name, values)


def varying(cell: CellNumbers) -> dict[str, Any]:
    """Return the constants of a plant that events change, by name."""
    return {"surroundings": cell.surroundings, "grasps": cell.grasps}


class PlantCode:
    """Kernels of a cell, and the slots that they read and write.

    Attributes:
        lanes: the slots.
        fields: names of those of an Observation.
        program: observes first, and then makes steps, each of two instructions, by a row of the uniforms
            that has its length.
    """

    def __init__(self, cell: CellNumbers) -> None:
        self._constants, functions, self.fields = cell, SharedFunctions(), observed(cell)
        nq, nv, works = cell.sizes
        self.lanes, self._uniforms = Layout(), Layout()
        self.lanes.add(
            q=(nq,),
            v=(nv,),
            work=(works,),
            force=(cell.joints,),
            rates=(nv + works,),
            closure_errors=(len(cell.arms), 2),
            **self.fields,
            **{name: (len(leaves(part)),) for name, part in varying(cell).items()},
        )
        self._uniforms.add(h=())
        steps = [(code, row) for row in range(STEPS_AT_ONCE) for code in (1, 2)]
        observe, step = (Kernel(name, self.lanes, self._uniforms) for name in ("observe", "step"))
        motion = cell_motion(functions, self._cell(observe), CellState.of(observe))
        write_observed(observe, cell, motion)
        rates = observe.on_same_tape("rates")
        rates.write("rates", motion.rates)
        write_step(step, functions, self._cell(step))
        self.program = Program([observe, rates, step], self.lanes, 0, 0, np.array([(0, 0), *steps]))

    def _cell(self, kernel: Kernel) -> CellNumbers:
        """Return the constants of the cell in its present surroundings."""
        parts = varying(self._constants)
        present = {name: rebuilt(part, iter(kernel.read(name))) for name, part in parts.items()}
        return self._constants._replace(**present)
