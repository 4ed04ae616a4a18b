"""Code of a cell's plant: its kernels, one Runge-Kutta step, and an observation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.batch.cell_dynamics import CellMotion, CellNumbers, CellState, cell_motion
from coop_pin.batch.serial_arm import Numbers
from coop_pin.chain.integrators import RK4
from coop_pin.description.events import Surroundings
from coop_pin.results.quantities import WORK
from coop_pin.simulation.transmission import Friction
from coop_pin.tracing.kernel import Instruction, Kernel, Layout, Program
from coop_pin.tracing.tape import Number
from coop_pin.tracing.traced_array import parts, traced
from coop_pin.tracing.tree import SharedFunctions, leaves, rebuilt

_STAGES = tuple(zip(RK4.c, RK4.b.tolist(), strict=True))
"""Nodes and weights; a stage starts from the one before alone, whose coefficient is the node."""

STEPS_AT_ONCE = 64
"""Plant steps of one call."""


def observed(arms: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the fields of CellMotion that an observation writes, by name."""
    tables = {"R_WP": (3, 3), "tips": (arms, 3), "wrenches": (arms, 6), "closure_errors": (arms, 2)}
    return tables | {"p_WP": (3,), "V_WP": (6,), "payload_wrench": (6,), "kinetic": (), "potential": ()}


class PlantNumbers(NamedTuple):
    """Numbers of a plant, most of which fold into its code.

    Attributes:
        cell: dynamics of the cell.
        friction: friction of each arm.
        surroundings: payload, and what acts on it from outside.
    """

    cell: CellNumbers
    friction: tuple[Friction, ...]
    surroundings: Surroundings


class PlantState(NamedTuple):
    """State of a plant, and the forces that its drives hold.

    Attributes:
        q: joint positions of all arms, shape (N,).
        v: joint rates of all arms, shape (N,).
        force: generalised force of the drives, N m, shape (N,).
    """

    q: Numbers
    v: Numbers
    force: Numbers

    @classmethod
    def of(cls, kernel: Kernel) -> PlantState:
        """Return the state in a kernel's slots."""
        return cls(*map(kernel.read, cls._fields))


def plant_motion(
    functions: SharedFunctions, plant: PlantNumbers, state: PlantState
) -> tuple[CellMotion, list[Number]]:
    """Return the motion under the held forces and friction, and its rates.

    The rates are the accelerations of all joints, then the powers in the order of WORK, whose last is done at
    instants only. A force on the payload that depends on the state belongs into ``cell_motion``, where the
    pose and twist of P are known, and into ``Plant.payload_wrench``.
    """
    sizes = [len(arm.bodies) for arm in plant.cell.arms]
    q, v, forces = (parts(values, sizes) for values in state)
    friction = [own.force(rates) for own, rates in zip(plant.friction, v, strict=True)]
    tau = [force + own for force, own in zip(forces, friction, strict=True)]
    motion = cell_motion(functions, state.v[0].tape, plant.cell, CellState(q, v, tau, plant.surroundings))
    powers = [state.force @ state.v, traced(np.concatenate(friction)) @ state.v]
    powers += [motion.payload_wrench @ motion.V_WP, 0.0]
    return motion, [*np.concatenate(motion.accelerations), *powers]


def write_step(kernel: Kernel, functions: SharedFunctions, plant: PlantNumbers) -> None:
    """Write q, v and work after one plant step of h by Runge-Kutta 4.

    Args:
        kernel: reads q, v, force, work, h and the rates at the start of the step.
        functions: has the rates of the other stages.
        plant: Numbers of the plant as the kernel reads them.
    """

    def rates_at(plant: PlantNumbers, state: PlantState) -> list[Number]:
        return plant_motion(functions, plant, state)[1]

    q, v, force = state = PlantState.of(kernel)
    h, rates, work, N = kernel.uniform("h"), kernel.read("rates"), kernel.read("work"), len(q)
    q_end, v_end = q, v
    for node, weight in _STAGES:
        if node > 0.0:
            state = PlantState(q + node * h * state.v, v + node * h * rates[:N], force)
            rates = traced(functions.call(kernel.tape, rates_at, plant, state))
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

    def __init__(self, numbers: PlantNumbers) -> None:
        self._numbers, functions = numbers, SharedFunctions()
        m, N = len(numbers.cell.arms), sum(len(arm.bodies) for arm in numbers.cell.arms)
        self.lanes, self._uniforms = Layout(), Layout()
        self.lanes.add(q=(N,), v=(N,), work=(len(WORK),), force=(N,), rates=(N + len(WORK),), **observed(m))
        self.lanes.add(surroundings=(len(leaves(numbers.surroundings)),))
        self._uniforms.add(h=())
        steps = [Instruction(code, row) for row in range(STEPS_AT_ONCE) for code in (1, 2)]
        observe, rates, step = (
            Kernel(name, self.lanes, self._uniforms) for name in ("observe", "rates", "step")
        )
        motion, _ = plant_motion(functions, self._plant(observe), PlantState.of(observe))
        for name in observed(m):
            observe.write(name, getattr(motion, name))
        rates.write("rates", plant_motion(functions, self._plant(rates), PlantState.of(rates))[1])
        write_step(step, functions, self._plant(step))
        self.program = Program([observe, rates, step], self.lanes, 0, 0, [Instruction(0, 0), *steps])

    def _plant(self, kernel: Kernel) -> PlantNumbers:
        """Return the numbers of the plant in its present surroundings."""
        present = rebuilt(self._numbers.surroundings, iter(kernel.read("surroundings")))
        return self._numbers._replace(surroundings=present)
