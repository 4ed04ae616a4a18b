"""Code of a cell's plant: its kernels, one Runge-Kutta step, and an observation."""

from __future__ import annotations

from coop_pin.batch.cell_dynamics import CellNumbers, CellState, cell_motion
from coop_pin.batch.serial_arm import Numbers
from coop_pin.chain.integrators import RK4
from coop_pin.results.quantities import WORK
from coop_pin.tracing.kernel import Instruction, Kernel, Layout, Program
from coop_pin.tracing.traced_array import traced
from coop_pin.tracing.tree import SharedFunctions, leaves, rebuilt

_STAGES = tuple(zip(RK4.c, RK4.b.tolist(), strict=True))
"""Nodes and weights; a stage starts from the one before alone, whose coefficient is the node."""

STEPS_AT_ONCE = 64
"""Plant steps of one call."""


def observed(arms: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the fields of CellMotion that an observation writes, by name."""
    tables = {"R_WP": (3, 3), "tips": (arms, 3), "wrenches": (arms, 6), "closure_errors": (arms, 2)}
    return tables | {"p_WP": (3,), "V_WP": (6,), "payload_wrench": (6,), "kinetic": (), "potential": ()}


def write_step(kernel: Kernel, functions: SharedFunctions, cell: CellNumbers) -> None:
    """Write q, v and work after one plant step of h by Runge-Kutta 4.

    Args:
        kernel: reads q, v, force, work, h and the rates at the start of the step.
        functions: has the rates of the other stages.
        cell: Constants of the cell as the kernel reads them.
    """

    def rates_at(cell: CellNumbers, state: CellState) -> Numbers:
        return cell_motion(functions, cell, state).rates

    q, v, force = state = CellState.of(kernel)
    h, rates, work, N = kernel.uniform("h"), kernel.read("rates"), kernel.read("work"), len(q)
    q_end, v_end = q, v
    for node, weight in _STAGES:
        if node > 0.0:
            state = CellState(q + node * h * state.v, v + node * h * rates[:N], force)
            rates = traced(functions.call(kernel.tape, rates_at, cell, state))
        q_end, v_end = q_end + weight * h * state.v, v_end + weight * h * rates[:N]
        work = work + weight * h * rates[N:]
    for name, values in (("q", q_end), ("v", v_end), ("work", work)):
        kernel.write(name, values)


class PlantCode:
    """Kernels of a cell, and the slots that they read and write.

    Attributes:
        lanes: the slots.
        program: observes first, and then makes steps, each of two instructions, by a row of the uniforms
            that has its length.
    """

    def __init__(self, cell: CellNumbers) -> None:
        self._constants, functions = cell, SharedFunctions()
        m, N = len(cell.arms), sum(len(arm.bodies) for arm in cell.arms)
        self.lanes, self._uniforms = Layout(), Layout()
        self.lanes.add(q=(N,), v=(N,), work=(len(WORK),), force=(N,), rates=(N + len(WORK),), **observed(m))
        self.lanes.add(surroundings=(len(leaves(cell.surroundings)),))
        self._uniforms.add(h=())
        steps = [Instruction(code, row) for row in range(STEPS_AT_ONCE) for code in (1, 2)]
        observe, step = (Kernel(name, self.lanes, self._uniforms) for name in ("observe", "step"))
        motion = cell_motion(functions, self._cell(observe), CellState.of(observe))
        for name in observed(m):
            observe.write(name, getattr(motion, name))
        rates = observe.beside("rates")
        rates.write("rates", motion.rates)
        write_step(step, functions, self._cell(step))
        self.program = Program([observe, rates, step], self.lanes, 0, 0, [Instruction(0, 0), *steps])

    def _cell(self, kernel: Kernel) -> CellNumbers:
        """Return the constants of the cell in its present surroundings."""
        present = rebuilt(self._constants.surroundings, iter(kernel.read("surroundings")))
        return self._constants._replace(surroundings=present)
