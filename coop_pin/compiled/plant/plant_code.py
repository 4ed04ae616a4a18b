"""Code of a cell's plant: its kernels, one Runge-Kutta step, and an observation."""

from __future__ import annotations

from typing import Any

import numpy as np

from coop_pin.chain.integrators import RK4
from coop_pin.compiled.plant.cell_dynamics import CellMotion, CellState, cell_motion
from coop_pin.compiled.plant.cell_numbers import CellNumbers
from coop_pin.compiled.plant.serial_arm import Numbers
from coop_pin.grasps.spring_damper import SpringState
from coop_pin.tracing.kernel import Kernel, Layout, Program
from coop_pin.tracing.traced_array import traced
from coop_pin.tracing.tree import SharedFunctions, leaves, rebuilt

_STAGES = tuple(zip(RK4.c, RK4.b.tolist(), strict=True))
"""Nodes and weights; a stage starts from the one before alone, whose coefficient is the node."""

STEPS_AT_ONCE = 64
"""Plant steps of one call."""


def observed(cell: CellNumbers) -> dict[str, tuple[int, ...]]:
    """Return the shapes of what an observation writes, by name."""
    m, n = len(cell.arms), len(cell.compliant)
    of_grasps = {
        "grasp_wrench": (n, 6),
        "grasp_position": (n, 3),
        "grasp_rotation": (n, 3, 3),
        "elastic": (),
    }
    return {
        "R_WP": (3, 3),
        "tips": (m, 3),
        "wrenches": (m, 6),
        "closure_errors": (m, 2),
        "p_WP": (3,),
        "V_WP": (6,),
        "payload_wrench": (6,),
        "kinetic": (),
        "potential": (),
        **(of_grasps if n else {}),
    }


def write_observed(kernel: Kernel, cell: CellNumbers, motion: CellMotion) -> None:
    """Write what is observed of a motion."""
    values = motion._asdict()
    values |= {
        f"grasp_{field}": column
        for field, column in zip(SpringState._fields, zip(*motion.springs, strict=True), strict=False)
    }
    for name in observed(cell):
        kernel.write(name, values[name])


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
        observed: names of those that an observation writes.
        program: observes first, and then makes steps, each of two instructions, by a row of the uniforms
            that has its length.
    """

    def __init__(self, cell: CellNumbers) -> None:
        self._constants, functions, self.observed = cell, SharedFunctions(), list(observed(cell))
        nq, nv, works = cell.sizes
        self.lanes, self._uniforms = Layout(), Layout()
        self.lanes.add(
            q=(nq,),
            v=(nv,),
            work=(works,),
            force=(cell.joints,),
            rates=(nv + works,),
            **observed(cell),
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
