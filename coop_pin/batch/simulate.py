"""Simulation of many runs at once: scenarios that differ in numbers, in one program."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from coop_pin.arrays import Array, Mask, require_memory, require_type
from coop_pin.batch.kernel import LOAD, RECORD, Instruction, Layout, Machine, Program
from coop_pin.batch.llvm_machine import LlvmMachine
from coop_pin.batch.preparation import Prepared, prepare
from coop_pin.batch.run_block import References, RunBlock, RunShape
from coop_pin.batch.run_code import RunCode
from coop_pin.batch.run_samples import jacobian_conditions, samples
from coop_pin.batch.tree import differing, leaves
from coop_pin.description.controller import NoForcePath
from coop_pin.description.events import PayloadChange
from coop_pin.description.scenario import Scenario
from coop_pin.errors import ArgumentError
from coop_pin.results import RunResult
from coop_pin.results.dataset import dataset
from coop_pin.simulation.timeline import Timeline

LARGEST_BLOCK = 64
"""Runs that advance together; the samples of more leave the processor's caches."""

_COPIES = 3
"""Of the samples: as recorded, joined, and by names."""


class BatchResult:
    """Results of a batch.

    Attributes:
        scenarios: that were run.
        is_valid: which runs kept to the guards of a single run (finite and closed motion, regular Jacobians);
            the samples of the others mean nothing, shape (runs,).
        samples: as a single run has them, with a leading axis of runs.
    """

    def __init__(self, prepared: Prepared, layout: Layout, record: Array, is_valid: Mask) -> None:
        """Name the samples.

        Args:
            prepared: the batch.
            layout: of the record's slots.
            record: shape (samples, slots, runs).
            is_valid: see above.
        """
        self.scenarios, self.is_valid = prepared.scenarios, is_valid
        self._prepared = prepared
        self.samples = samples(prepared, layout, record)

    def result(self, index: int) -> RunResult:
        """Return the result of one run, as coop_pin.run returns it."""
        prepared, scenario = self._prepared, self.scenarios[index]
        recorder = prepared.runs[index].recorder
        mine = {name: values[index] for name, values in self.samples.items()}
        mine["jacobian_condition"] = jacobian_conditions(prepared, index, mine["joint_position"])
        names = [joints for _, joints in recorder.joints]
        return RunResult(scenario, dataset(scenario, mine, names, recorder.limit_table()))


def simulate_batch(
    scenarios: Sequence[Scenario], *, machine: Callable[[Program], Machine] = LlvmMachine
) -> BatchResult:
    """Return the results of scenarios that differ in numbers only.

    Numbers in which they differ become inputs of the traced code, all others fold into it.

    Args:
        scenarios: with equal kinds of everything, equal times of ticks and events.
        machine: what runs the program.

    Raises:
        ArgumentError: there are none, one cannot run in a batch, or they differ in more than numbers.
        MissingExtraError: llvmlite is not installed.
        NotEnoughMemoryError: the samples do not fit.
        CoopPinError: a run cannot start.
    """
    if not scenarios:
        raise ArgumentError("scenarios is empty; give at least one")
    for index, scenario in enumerate(scenarios):
        require_type(f"scenarios[{index}]", scenario, Scenario)
    prepared = prepare(scenarios)
    program, uniforms, block, loads = assemble(prepared)
    needed = _COPIES * 8 * program.rows(RECORD) * program.recorded * len(scenarios)
    require_memory(f"samples of {len(scenarios)} runs", needed, "give fewer at a time, or keep fewer samples")
    runner, records = machine(program), []
    valid = program.lanes.slots("is_valid")
    for first in range(0, len(scenarios), LARGEST_BLOCK):
        part = slice(first, first + LARGEST_BLOCK)
        records.append(runner.run(block[:, part], uniforms, loads[:, :, part]))
    return BatchResult(prepared, program.lanes, np.concatenate(records, axis=2), block[valid] == 1.0)


def assemble(prepared: Prepared) -> tuple[Program, Array, Array, Array]:
    """Return the program, its uniforms, initial block and loads."""
    first, run = prepared.scenarios[0], prepared.runs[0]
    path = first.controller.force_path
    shape = RunShape(
        rows=first.cell.task_rows,
        delay=None if isinstance(path, NoForcePath) else path.delay,
        changes_payload=any(isinstance(event, PayloadChange) for event in first.events),
        pushes=any(not isinstance(event, PayloadChange) for event in first.events),
    )
    differs, values = differing(prepared.constants)
    desired = prepared.references
    is_loaded = (desired != desired[:1]).any(axis=(0, 1))
    is_uniform = ~is_loaded & (desired[0] != desired[0, :1]).any(axis=0)
    layout = RunBlock(shape, prepared.constants[0], differs, References(desired[0, 0], is_uniform, is_loaded))
    kernels = RunCode(layout).kernels()
    instructions, uniforms = _schedule(
        run.timeline, layout, desired[0][:, is_uniform], first.clock.record_every
    )
    if is_loaded.any():
        loads = np.ascontiguousarray(np.moveaxis(desired[:, :, is_loaded], 0, 2))
    else:
        loads = np.zeros((1, 0, len(values)))
    program = Program(kernels, layout.lanes, layout.recorded, layout.loaded, instructions)
    block = np.zeros((layout.lanes.size, len(values)))
    for name, given in (
        ("q", np.array([begin.q for begin in prepared.starts])),
        ("holding", np.array([begin.holding for begin in prepared.starts])),
        ("constants", values[:, differs]),
        ("payload", np.array([leaves(constants.cell.payload) for constants in prepared.constants])),
        ("is_valid", np.ones((len(values), 1))),
    ):
        block[layout.lanes.slots(name).ravel()] = np.asarray(given, dtype=np.float64).T
    return program, uniforms, block, loads


def _schedule(
    timeline: Timeline, layout: RunBlock, desired: Array, every: int
) -> tuple[list[Instruction], Array]:
    """Return the instructions of a run and the uniforms that they refer to."""
    start_code, law, observe, step, sense, event = range(6)
    delay = layout.shape.delay
    rows: list[Array] = []
    steps: dict[float, int] = {}
    made: list[Instruction] = []

    def row(**fields: Any) -> int:
        values = np.zeros(layout.uniforms.size)
        for name, value in fields.items():
            values[layout.uniforms.slots(name)] = value
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
        if layout.loaded:
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
