"""Code of a cell's plant: its kernels, one Runge-Kutta step, and an observation."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from coop_pin.batch.cell_dynamics import CellModel, CellMotion, CellState, cell_motion
from coop_pin.batch.kernel import Instruction, Kernel, Layout, Program
from coop_pin.batch.serial_arm import Numbers
from coop_pin.batch.tape import Number
from coop_pin.batch.traced_array import parts, traced
from coop_pin.batch.tree import SharedFunctions, rebuilt
from coop_pin.simulation.plant import CHANNELS
from coop_pin.simulation.transmission import Friction

STAGES = ((0.0, 1.0 / 6.0), (0.5, 1.0 / 3.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 6.0))
"""Of the classical Runge-Kutta method: nodes, also the coefficients of the stage before, and weights."""

STEPS_AT_ONCE = 64
"""Plant steps of one call."""
OBSERVED = ("R_WP", "p_WP", "V_WP", "tips", "wrenches", "closure_errors", "kinetic", "potential")
"""Fields of CellMotion that an observation writes."""


def write_step(
    kernel: Kernel, motion: Callable[[Numbers, Numbers], tuple[CellMotion, Numbers, Number]]
) -> None:
    """Write one plant step of h by Runge-Kutta 4, with the work of the forces.

    Args:
        kernel: reads q, v, work, force and h; q, v and work are written.
        motion: at (q, v), with the friction of all joints and the power of the push.
    """
    q, v, h, force = kernel.read("q"), kernel.read("v"), kernel.uniform("h"), kernel.read("force")
    q_end, v_end, work = q, v, kernel.read("work")
    q_rate, v_rate = np.zeros(len(q)), np.zeros(len(v))
    for node, weight in STAGES:
        q_i, v_i = q + node * h * q_rate, v + node * h * v_rate
        found, friction, external = motion(q_i, v_i)
        q_rate, v_rate = v_i, traced(np.concatenate(found.accelerations))
        power = traced([force @ v_i, friction @ v_i, external])
        q_end, v_end = q_end + weight * h * q_rate, v_end + weight * h * v_rate
        work = work + weight * h * power
    for name, values in (("q", q_end), ("v", v_end), ("work", work)):
        kernel.write(name, values)


class PlantNumbers(NamedTuple):
    """Numbers that fold into the code of a plant.

    Attributes:
        cell: its dynamics; the payload is an input.
        friction: of each arm.
    """

    cell: CellModel
    friction: tuple[Friction, ...]


class PlantCode:
    """Kernels "observe" and "step" of a cell, and the slots that they read and write.

    Attributes:
        lanes: the slots.
        program: observes first, and then makes steps, each by a row of the uniforms that has its length.
    """

    def __init__(self, numbers: PlantNumbers) -> None:
        self._numbers, self._functions = numbers, SharedFunctions()
        self._sizes = [len(arm.bodies) for arm in numbers.cell.arms]
        m, N = len(self._sizes), sum(self._sizes)
        self.lanes, self._uniforms = Layout(), Layout()
        for name, *sizes in (
            *(("q", N), ("v", N), ("work", len(CHANNELS)), ("force", N), ("external", 6), ("payload", 13)),
            *(("R_WP", 3, 3), ("p_WP", 3), ("V_WP", 6), ("tips", m, 3), ("wrenches", m, 6)),
            *(("closure_errors", m, 2), ("kinetic",), ("potential",)),
        ):
            self.lanes.add(str(name), *sizes)
        self._uniforms.add("h")
        steps = [Instruction(1, row) for row in range(STEPS_AT_ONCE)]
        kernels = [self._observe(), self._step()]
        self.program = Program(kernels, self.lanes, 0, 0, [Instruction(0, 0), *steps])

    def _observe(self) -> Kernel:
        kernel = Kernel("observe", self.lanes, self._uniforms)
        motion, _ = self._motion(kernel, kernel.read("q"), kernel.read("v"))
        for name in OBSERVED:
            kernel.write(name, getattr(motion, name))
        return kernel

    def _step(self) -> Kernel:
        kernel = Kernel("step", self.lanes, self._uniforms)

        def motion(q: Numbers, v: Numbers) -> tuple[CellMotion, Numbers, Number]:
            motion, resistance = self._motion(kernel, q, v)
            return motion, resistance, kernel.read("external") @ motion.V_WP

        write_step(kernel, motion)
        return kernel

    def _motion(self, kernel: Kernel, q: Numbers, v: Numbers) -> tuple[CellMotion, Numbers]:
        """Return the motion under the held forces, and the friction of all joints."""
        cell = self._numbers.cell
        cell = cell._replace(payload=rebuilt(cell.payload, iter(kernel.read("payload"))))
        rates, forces = parts(v, self._sizes), parts(kernel.read("force"), self._sizes)
        resistance = [own.force(rate) for own, rate in zip(self._numbers.friction, rates, strict=True)]
        tau = [force + own for force, own in zip(forces, resistance, strict=True)]
        state = CellState(parts(q, self._sizes), rates, tau, kernel.read("external"))
        return cell_motion(self._functions, kernel.tape, cell, state), traced(np.concatenate(resistance))
