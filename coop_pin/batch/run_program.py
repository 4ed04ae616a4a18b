"""Program of the runs of a batch: kernels, the order of their calls, and what each run begins with."""

from __future__ import annotations

from typing import Any

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.batch.kernel import LOAD, RECORD, Instruction, Program
from coop_pin.batch.preparation import Prepared
from coop_pin.batch.run_block import References, RunBlock, RunShape
from coop_pin.batch.run_code import RunCode
from coop_pin.batch.tree import leaves
from coop_pin.description.controller import NoForcePath
from coop_pin.description.events import PayloadChange
from coop_pin.simulation.timeline import Timeline


class RunProgram:
    """Program of runs that differ from a first one in chosen numbers.

    Attributes:
        program: what a machine runs.
        uniforms: numbers that all runs share, shape (rows, uniforms).
    """

    def __init__(self, first: Prepared, differs: Mask, is_loaded: Mask) -> None:
        """Trace and order the kernels.

        Args:
            first: a batch whose first run has the numbers that fold.
            differs: leaves of the constants that are inputs.
            is_loaded: entries of the references that are inputs.
        """
        scenario, desired = first.scenarios[0], first.references[0]
        path = scenario.controller.force_path
        shape = RunShape(
            rows=scenario.cell.task_rows,
            delay=None if isinstance(path, NoForcePath) else path.delay,
            changes_payload=any(isinstance(event, PayloadChange) for event in scenario.events),
            pushes=any(not isinstance(event, PayloadChange) for event in scenario.events),
        )
        is_uniform = ~is_loaded & (desired != desired[:1]).any(axis=0)
        references = References(desired[0], is_uniform, is_loaded)
        self._block, self._differs = RunBlock(shape, first.constants[0], differs, references), differs
        kernels = RunCode(self._block).kernels()
        instructions, self.uniforms = _schedule(
            first.runs[0].timeline, self._block, desired[:, is_uniform], scenario.clock.record_every
        )
        block = self._block
        self.program = Program(kernels, block.lanes, block.recorded, block.loaded, instructions)

    def begin(self, prepared: Prepared) -> tuple[Array, Array]:
        """Return the initial block, shape (slots, runs), and the loads, shape (ticks + 1, loaded, runs)."""
        lanes, is_loaded = self.program.lanes, self._block.references.is_loaded
        block = np.zeros((lanes.size, len(prepared.starts)))
        for name, given in (
            ("q", [start.q for start in prepared.starts]),
            ("holding", [start.holding for start in prepared.starts]),
            ("constants", prepared.values[:, self._differs]),
            ("payload", [leaves(constants.cell.payload) for constants in prepared.constants]),
            ("is_valid", np.ones((len(prepared.starts), 1))),
        ):
            block[lanes.slots(name).ravel()] = np.array(given, dtype=np.float64).T
        if not is_loaded.any():
            return block, np.zeros((1, 0, len(prepared.starts)))
        return block, np.ascontiguousarray(np.moveaxis(prepared.references[:, :, is_loaded], 0, 2))


def _schedule(
    timeline: Timeline, block: RunBlock, desired: Array, every: int
) -> tuple[list[Instruction], Array]:
    """Return the instructions of a run and the uniforms that they refer to."""
    start_code, law, observe, step, sense, event = range(6)
    delay = block.shape.delay
    rows: list[Array] = []
    steps: dict[float, int] = {}
    made: list[Instruction] = []

    def row(**fields: Any) -> int:
        values = np.zeros(block.uniforms.size)
        for name, value in fields.items():
            values[block.uniforms.slots(name)] = value
        rows.append(values)
        return len(rows) - 1

    def happen(time: float) -> None:
        nonlocal event
        if timeline.happens_at(time):
            made.append(Instruction(event, 0))
            event += 1

    for tick in range(timeline.ticks + 1):
        time, arrived = timeline.time(tick), delay is not None and tick - delay >= 1
        age = float(delay) if delay is not None and arrived else np.inf
        now = row(time=time, age=age, arrived=float(arrived), references=desired[tick])
        if block.loaded:
            made.append(Instruction(LOAD, tick))
        if tick == 0 or delay is not None:
            made.append(Instruction(sense if tick else start_code, now))
        happen(time)
        made += [Instruction(law, now), Instruction(observe, now)]
        if tick % every == 0 or tick == timeline.ticks:
            made.append(Instruction(RECORD, -(-tick // every)))
        for index, (begin, length) in enumerate(timeline.steps(tick) if tick < timeline.ticks else ()):
            if index > 0:
                happen(begin)
            if length not in steps:
                steps[length] = row(h=length)
            made.append(Instruction(step, steps[length]))
    return made, np.array(rows)
