"""Simulation of many runs at once: scenarios that differ in numbers, in one program."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask, require_type, typed
from coop_pin.base.disk_cache import DiskCache
from coop_pin.base.errors import ArgumentError, CoopPinError, NotEnoughMemoryError, WrongTypeError
from coop_pin.base.memory import require_memory
from coop_pin.base.schema.parts import Filled
from coop_pin.compiled.batch_result import BatchResult
from coop_pin.compiled.kind import Cover, plant_fields
from coop_pin.compiled.laws.support import checked, require_single_run, require_traceable
from coop_pin.compiled.preparation import Prepared
from coop_pin.compiled.prepared_plant import PreparedPlant
from coop_pin.compiled.schedule import RunProgram, Schedule, varying
from coop_pin.description.scenario import Scenario
from coop_pin.tracing.kernel import Machine
from coop_pin.tracing.llvm_machine import LlvmMachine, native_width

LARGEST_BLOCK = 256
"""Runs that advance together, between two looks at Ctrl-C."""

_COPIES = 3
"""Of the samples: as recorded, by names, and those of single results."""
_KEPT = 8
"""Plants, and families with their code, that are kept, those used last; the tapes of one may take 60 MB.
Of a family, so many orders of its kernels."""


class Family(NamedTuple):
    """Code for runs: numbers in which they differed so far are inputs, all others fold.

    Attributes:
        first: first run, whose numbers fold.
        code: program of the runs.
        machine: machine that runs the program.
        orders: first run with some times, its machine and the order of its kernels, by these times.
    """

    first: Prepared
    code: RunProgram
    machine: Machine
    orders: Mapping[Hashable, tuple[Prepared, Machine, Schedule]]

    def serves(self, differs: Mask, is_loaded: Mask, runs: Sequence[Prepared]) -> bool:
        """Return whether the code has these inputs, and no other signal varies over runs with own times."""
        block = self.code.block
        is_input = block.is_uniform | block.is_loaded
        same = (differs == block.differs).all() and (is_loaded == block.is_loaded).all()
        return bool(same and not (varying([self.first, *runs]) & ~is_input).any())

    def order(self, run: Prepared) -> tuple[Prepared, Machine, Schedule]:
        """Return the order of runs with the times of one; see the attribute."""
        order = self.code.order(run)
        return run, self.machine.in_order(order.instructions), order


class BatchSimulator:
    """Simulates batches one after the other, of any families; plants and code are kept for the next ones.

    Attributes:
        is_alone: whether users' laws are checked more closely, as no single run is compared.
    """

    is_alone = False

    def __init__(
        self,
        *,
        machine: type[Machine] | None = None,
        width: int | None = None,
        is_brief: bool = False,
    ) -> None:
        """Begin without code.

        Args:
            machine: Class of the machine of a program of kernels; None for compiled code, kept on disk.
            width: Number of lanes of compiled code; that of this processor when omitted.
            is_brief: Whether to compile for few ticks; see LlvmMachine.
        """
        if machine is not None and not (isinstance(machine, type) and issubclass(machine, Machine)):
            raise WrongTypeError("machine", type(machine).__name__, "type, derived from Machine")
        compiled = partial(LlvmMachine, width=width, cache=DiskCache(), is_brief=is_brief)
        self._new_machine = compiled if machine is None else machine
        self._takes_kernels, self._width = machine is not None, width
        self._plants, self._families = list[tuple[tuple[object, ...], PreparedPlant]](), list[Family]()
        self._free = list[Array]()

    def run(self, scenarios: Sequence[Scenario]) -> BatchResult:
        """Return the results of scenarios; see simulate_batch. Those of other calls may be of other kinds.

        Of a user's law, some of the runs are repeated singly.
        """
        require_type("scenarios", scenarios, Sequence)
        if not scenarios:
            raise ArgumentError("scenarios is empty; give at least one")
        for index, scenario in enumerate(scenarios):
            require_type(f"scenarios[{index}]", scenario, Scenario)
        batch = self.run_prepared([self.prepare(scenario) for scenario in scenarios])
        valid = np.flatnonzero(batch.is_valid).tolist()
        if scenarios[0].controller.user_code and valid:
            for index in checked(valid, lambda index: vars(scenarios[index].controller)):
                samples = {name: batch.samples[name][index] for name in batch.samples}
                require_single_run(scenarios[index], samples)
        return batch

    def prepare(self, scenario: Scenario, cover: Cover | None = None) -> Prepared:
        """Return a run before it runs; raises as Plant and Prepared.of_run.

        Args:
            scenario: scenario to run.
            cover: Provisions of the code, for runs of which only some need them; those of this one when None.
        """
        fields = cover, *plant_fields(scenario)
        index = next((i for i, (other, _) in enumerate(self._plants) if other == fields), None)
        like = self._plants[0][1] if self._plants else None
        if index is not None:
            plant = self._plants.pop(index)[1]
        else:
            varied = like and like.carrying(scenario, cover)
            plant = varied or PreparedPlant(scenario, cover=cover, like=like)
        self._plants.insert(0, (fields, plant))  # the next scenario shares more objects with this one
        return Prepared.of_run(scenario, plant)

    def prepare_alike(self, scenarios: Filled, cover: Cover | None = None) -> Prepared | None:
        """Return runs that differ in numbers of a law of the package, before they run.

        The first and the last are prepared by themselves, and the others must agree with them.

        Args:
            scenarios: Scenarios of the runs, alike but for numbers of the law.
            cover: Provisions of the code, as of prepare.

        Returns:
            The runs; None where each must be prepared by itself.
        """
        try:
            ends = [self.prepare(scenarios[end], cover) for end in (0, -1)]
        except CoopPinError:
            return None
        if ends[0].plants != ends[1].plants or ends[0].kind != ends[1].kind:
            return None
        runs = ends[0].alike(scenarios)
        if runs is None:
            return None
        pairs = zip(ends, runs.values[[0, -1]], strict=True)
        return runs if all(end.values.tobytes() == values.tobytes() for end, values in pairs) else None

    def run_prepared(
        self,
        runs: Sequence[Prepared],
        begin: Callable[[], Callable[[], None] | None] = lambda: None,
        memory_limit: int = 0,
    ) -> BatchResult:
        """Return the results of runs; raises as simulate_batch.

        Args:
            runs: Runs of one family with the same times.
            begin: Function that is called before compiled code runs, from where on this simulator is not
                used; it returns what the code's parts call in between.
            memory_limit: Largest memory of the samples, bytes; 0 for what is free.
        """
        prepared = Prepared.joined(runs)
        del self._plants[_KEPT:]
        family, count = self.family([prepared]), len(prepared.plants)
        _, machine, order = family.orders[prepared.kind.times]
        if machine.record_size(count) > sum(memory.size for memory in self._free):
            require_sample_memory(machine, count, memory_limit)
        (block, loads), lanes = family.code.begin(prepared), family.code.program.lanes
        parts = [slice(first, first + LARGEST_BLOCK) for first in range(0, count, LARGEST_BLOCK)]
        memories = [self._memory(machine.record_size(block[:, part].shape[1])) for part in parts]
        between = begin()
        records = [
            machine.run(block[:, part], order.uniforms, loads[:, :, part], memory, between)
            for part, memory in zip(parts, memories, strict=True)
        ]
        is_valid = block[lanes.slots("is_valid")] == 1.0
        return BatchResult(prepared, lanes, records, is_valid, partial(self._give_back, memories))

    def _memory(self, size: int) -> Array:
        """Return memory for ``size`` numbers or more.

        That of a released record if there is one: to get and clear new memory takes the time of the runs.
        """
        memory = self._free.pop() if self._free else np.empty(size)
        return memory if memory.size >= size else np.empty(size)

    def _give_back(self, parts: list[Array]) -> None:
        """Take the parts out of a list, for later records; a second time there are none in it."""
        self._free += parts
        parts.clear()

    def family(self, batches: Sequence[Prepared]) -> Family:
        """Return code for batches that share it; it is compiled anew only when further numbers differ.

        Args:
            batches: Batches, the runs of each of which share their times.

        Raises:
            TracingError: the runs cannot be traced.
        """
        kinds, kind = [each.first.kind.code for each in self._families], batches[0].kind.code
        family = self._families.pop(kinds.index(kind)) if kind in kinds else None
        first = batches[0].part(slice(1)) if family is None else family.first
        known = {} if family is None else {times: order[0] for times, order in family.orders.items()}
        firsts = {
            each.kind.times: known.get(each.kind.times) or each.part(slice(1)) for each in reversed(batches)
        }
        differs = np.any([self._inputs(first, each) for each in batches], axis=0)
        is_loaded = np.any([each.loaded(firsts[each.kind.times]) for each in batches], axis=0)
        if family is None:
            require_traceable(first.scenarios[0], first.constants, alone=self.is_alone)
        else:
            block = family.code.block
            differs, is_loaded = differs | block.differs, is_loaded | block.is_loaded
        if family is None or not family.serves(differs, is_loaded, [*firsts.values()]):
            first.require_surroundings()
            width = None if self._takes_kernels else self._width or native_width()
            code = RunProgram(first, differs, is_loaded, width, [*firsts.values()])
            family = Family(first, code, self._new_machine(code.program), {})
        orders = {times: family.orders.get(times) or family.order(run) for times, run in firsts.items()}
        others = [(times, order) for times, order in family.orders.items() if times not in orders]
        family = family._replace(orders=dict(others[-_KEPT:]) | orders)
        self._families = [*self._families, family][-_KEPT:]
        return family

    def _inputs(self, first: Prepared, prepared: Prepared) -> Mask:
        """Return the mask of the constants that are inputs: those in which runs differ from the first."""
        same = (prepared.values == first.values) | (np.isnan(prepared.values) & np.isnan(first.values))
        return ~same.all(axis=0)


def require_sample_memory(machine: Machine, runs: int, limit: int = 0) -> None:
    """Refuse samples that do not fit, or are above a limit other than 0; raises NotEnoughMemoryError."""
    size = _COPIES * 8 * machine.record_size(runs)
    if 0 < limit < size:
        raise NotEnoughMemoryError(f"samples of {runs} runs", size, limit, "raise memory_limit_gb")
    require_memory(f"samples of {runs} runs", size, "give fewer at once")


@typed
def simulate_batch(scenarios: Sequence[Scenario], *, machine: type[Machine] | None = None) -> BatchResult:
    """Return the results of scenarios that differ in numbers only.

    Numbers in which they differ become inputs of the traced code, all others fold into it. Of a user's law,
    two of the runs are repeated singly.

    Args:
        scenarios: scenarios with equal kinds of everything and equal times of ticks and events.
        machine: class of the machine of a program of kernels; None for compiled code, kept on disk.

    Raises:
        ArgumentError: there are none.
        TracingError: one cannot run in a batch, or they differ in more than numbers; or the first run or a
            random one, which are repeated singly if the law is a user's, differ from single runs.
        MissingExtraError: llvmlite is not installed.
        NotEnoughMemoryError: the samples do not fit.
        CoopPinError: a run cannot start.
    """
    return BatchSimulator(machine=machine).run(scenarios)
