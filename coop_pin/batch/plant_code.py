"""Code of a cell's plant: its kernels, one Runge-Kutta step, and an observation."""

from __future__ import annotations

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


class PlantNumbers(NamedTuple):
    """Numbers of a plant, most of which fold into its code.

    Attributes:
        cell: its dynamics.
        friction: of each arm.
        external: wrench on the payload about P in world axes, shape (6,).
    """

    cell: CellModel
    friction: tuple[Friction, ...]
    external: Numbers


class PlantState(NamedTuple):
    """State of a plant, and the forces that its drives hold.

    Attributes:
        q: joint positions of all arms, shape (N,).
        v: joint rates of all arms, shape (N,).
        force: of the drives, N m, shape (N,).
    """

    q: Numbers
    v: Numbers
    force: Numbers


def plant_motion(
    functions: SharedFunctions, plant: PlantNumbers, state: PlantState
) -> tuple[CellMotion, Numbers]:
    """Return the motion under the held forces and friction, and the friction of all joints."""
    sizes = [len(arm.bodies) for arm in plant.cell.arms]
    q, v, forces = (parts(values, sizes) for values in state)
    friction = [own.force(rates) for own, rates in zip(plant.friction, v, strict=True)]
    tau = [force + own for force, own in zip(forces, friction, strict=True)]
    held = CellState(q, v, tau, plant.external)
    return cell_motion(functions, state.v[0].tape, plant.cell, held), traced(np.concatenate(friction))


def write_step(kernel: Kernel, functions: SharedFunctions, plant: PlantNumbers) -> None:
    """Write one plant step of h by Runge-Kutta 4, with the work of the forces.

    Args:
        kernel: reads q, v, work, force and h; q, v and work are written.
        functions: has the rates, which are called at each stage.
        plant: its numbers as the kernel reads them.
    """

    def rates(plant: PlantNumbers, state: PlantState) -> tuple[Numbers, list[Number]]:
        motion, friction = plant_motion(functions, plant, state)
        powers = [state.force @ state.v, friction @ state.v, plant.external @ motion.V_WP]
        return np.concatenate(motion.accelerations), powers

    q, v, force, h = kernel.read("q"), kernel.read("v"), kernel.read("force"), kernel.uniform("h")
    q_end, v_end, work = q, v, kernel.read("work")
    q_rate, v_rate = np.zeros(len(q)), np.zeros(len(v))
    for node, weight in STAGES:
        state = PlantState(q + node * h * q_rate, v + node * h * v_rate, force)
        v_rate, powers = functions.call(kernel.tape, rates, plant, state)
        q_rate = state.v
        q_end, v_end = q_end + weight * h * q_rate, v_end + weight * h * v_rate
        work = work + weight * h * traced(powers)
    for name, values in (("q", q_end), ("v", v_end), ("work", work)):
        kernel.write(name, values)


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
        state = PlantState(*map(kernel.read, PlantState._fields))
        motion, _ = plant_motion(self._functions, self._plant(kernel), state)
        for name in OBSERVED:
            kernel.write(name, getattr(motion, name))
        return kernel

    def _step(self) -> Kernel:
        kernel = Kernel("step", self.lanes, self._uniforms)
        write_step(kernel, self._functions, self._plant(kernel))
        return kernel

    def _plant(self, kernel: Kernel) -> PlantNumbers:
        """Return the numbers of the plant with its present payload and push."""
        cell = self._numbers.cell
        cell = cell._replace(payload=rebuilt(cell.payload, iter(kernel.read("payload"))))
        return self._numbers._replace(cell=cell, external=kernel.read("external"))
