"""Law of one arm as C99 for a real controller: kinematics, Jacobian and law from the traced code.

A self-test is written beside it: ticks of a simulation of the scenario, with the commands of the Python law.
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coop_pin import __version__
from coop_pin.base.arrays import as_count, require_path, typed
from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import (
    ArgumentError,
    FileWriteError,
    NameNotFoundError,
    OutOfRangeError,
    TracingError,
)
from coop_pin.compiled.constants import arm_constants
from coop_pin.compiled.laws.c_messages import meanings, message_texts
from coop_pin.compiled.laws.law_code import (
    LawCode,
    LawTick,
    RecordedLaw,
    Values,
    fields,
    flops,
    require_agreement,
    tolerance,
    trace_law,
    trace_messages,
    traced_call,
)
from coop_pin.control import DecentralisedController
from coop_pin.control.controller import COMMANDS
from coop_pin.control.measurement import DESIRED, MEASURED
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.tracing.c_emitter import CEmitter, c_number


class CLaw(NamedTuple):
    """Files and cost of an exported law.

    Attributes:
        header: File of the interface.
        source: File of the code.
        self_test: File of a program that returns 0 if the code agrees with the recorded ticks.
        flops: Floating-point operations of a step, by kind: "add", "sub", "mul", "div", "sqrt".
    """

    header: Path
    source: Path
    self_test: Path
    flops: Mapping[str, int]

    def summary(self) -> str:
        """Return the files and the number of operations, for people to read."""
        parts = ", ".join(f"{count} {name}" for name, count in self.flops.items())
        files = "\n".join(map(str, (self.header, self.source, self.self_test)))
        return f"{files}\n{sum(self.flops.values())} floating-point operations a step: {parts}"


@typed
def export_c(scenario: Scenario, arm: str, folder: Path | str, *, ticks: int = 20) -> CLaw:
    """Write the law of one arm as C99: a header, a source and a self-test.

    The code allocates nothing and has no loops; its state goes in and out.

    Args:
        scenario: Scenario with the controller.
        arm: Name of the arm.
        folder: Folder of the files, which is made if it is not there.
        ticks: Number of ticks of the self-test, from the start of the scenario.

    Raises:
        NameNotFoundError: There is no such arm.
        ArgumentError: The controller is one of the whole cell or needs the plan of the grasps, there is a
            feed-forward, a grasp is a joint, or ticks is no number from 1 to that of the scenario's ticks.
        FileWriteError: The folder cannot be made, or a file in it cannot be written.
        TracingError: The law branches on values, computes with what cannot be traced, or has hidden state.
        CoopPinError: The scenario cannot be simulated for these ticks.
    """
    ticks = as_count("ticks", ticks, 1)
    require_path("folder", folder)
    if arm not in scenario.cell.arms:
        raise NameNotFoundError("arm", arm, list(scenario.cell.arms), "the scenario's cell")
    if scenario.feed_forward is not None or scenario.cell.driven:
        detail = "the scenario has feed-forward torques or shared joints, which exported laws are not given"
        raise ArgumentError(f"{detail}: export without them, and add such torques to what the law returns")
    if scenario.cell.payload.links is not None:
        raise ArgumentError("the payload has several links, which exported laws do not know")
    if jointed := list(scenario.cell.jointed):
        raise ArgumentError(f"grasps of {jointed} are joints, whose rows exported laws do not know")
    has_plan = scenario.has_grasp_plan or scenario.cell.tools
    if has_plan and (scenario.network or "own wrench" in scenario.controller.needs):
        raise ArgumentError(
            f"the law {scenario.controller.kind!r} takes its load share from the plan of the grasps, which"
            " exported laws are not given: export it without events at grasps, or with a force_path"
        )
    controller = build_controller(scenario)
    if not isinstance(controller, DecentralisedController):
        raise ArgumentError("the scenario's controller sees all arms; only laws of one arm can be exported")
    recorded, index = RecordedLaw(controller), list(scenario.cell.arms).index(arm)
    run = Simulation(scenario, recorded)
    if ticks > (most := run.timeline.ticks + 1):
        raise OutOfRangeError("ticks", min(ticks, sys.maxsize), f"at most {most}, those of the scenario")
    for _ in range(ticks):
        run.tick()
    arm_ticks, law = [tick[index] for tick in recorded.ticks], controller.controllers[arm]
    constants, rows = arm_constants(run.chain.arms[index]), scenario.cell.task_rows
    exact = bool(scenario.controller.user_code)
    try:
        alone = DecentralisedController({arm: law})
        trace = partial(traced_call, [constants], rows, arm_ticks[:1], exact)
        start, step = trace_law(alone, trace)
        require_agreement(start, step, [[tick] for tick in arm_ticks])
        code: tuple[LawCode, ...] = start, step
        if arm_ticks[0].message is None or len(arm_ticks[0].message):
            code += trace_messages(law, trace)
    except TracingError as error:
        raise TracingError(f"the law of arm {arm!r} cannot be exported: it {error}") from None
    name = _identifier(arm, list(scenario.cell.arms))
    header, source, test = (Path(folder) / f"{name}{ending}" for ending in (".h", ".c", "_self_test.c"))
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileWriteError(str(folder), error.strerror or str(error)) from error
    messages = message_texts(
        name, arm_ticks, recorded.first_messages[index] if len(code) > 2 else np.zeros(0)
    )
    texts = _texts(name, scenario, law.command_kind, arm_ticks, code, messages | {"arm": arm})
    for file, text in zip((header, source, test), texts, strict=True):
        write_atomically(file, partial(Path.write_text, data=text, encoding="utf-8"))
    return CLaw(header, source, test, flops(code[1]))


def _identifier(arm: str, arms: Sequence[str]) -> str:
    """Return the name of an arm's files and functions, with a digest where arms differ in signs alone."""
    names = [re.sub(r"\W", "_", each, flags=re.ASCII) for each in arms]
    name = names[arms.index(arm)]
    if [each.lower() for each in names].count(name.lower()) > 1:
        name = f"{name}_{hashlib.sha256(arm.encode()).hexdigest()[:8]}"
    return name if name[:1].isalpha() else f"arm_{name}"


# ---------------------------------------------------------------- C

_HEADER = """/* Law of arm {arm!r} of the scenario {scenario!r}, exported by coop-pin {version}.

   {joints} drives, {rows} task rows ({kind}), period {period} s.
   Call {name}_start at the first tick, and {name}_step at every tick, the first included. Both return 1, or 0
   if the payload Jacobian is singular: the {output} then means nothing. The {output} is not limited.
   A step takes {flops} floating-point operations.
{exchange}   Compile without contracted operations: -std=c99, or -ffp-contract=off. */
#ifndef COOP_PIN_{upper}_H
#define COOP_PIN_{upper}_H

typedef struct {{
{measurement}
}} {name}_measurement;

typedef struct {{
{reference}
}} {name}_reference;

typedef struct {{
    double value[{states}];
}} {name}_state;

{messages}/* Set the state at the first tick. */
int {name}_start(
    const {name}_measurement *measurement, const {name}_reference *reference, {name}_state *state);

/* Set the {output} of the {joints} drives, {unit}, and change the state to that of the next tick. */
int {name}_step(
    const {name}_measurement *measurement, const {name}_reference *reference, {name}_state *state,
    double *{output});

#endif
"""

_SELF_TEST = """#include "{name}.h"
#include <math.h>
#include <stdio.h>

static const {name}_measurement measured[] = {{
{measured}
}};

static const {name}_reference desired[] = {{
{desired}
}};

static const double expected[][{joints}] = {{
{expected}
}};
{sent}
int main(void)
{{
    {name}_state state;
    double {output}[{joints}], worst = 0.0;
    int good = {name}_start(&measured[0], &desired[0], &state);{before}
    for (int tick = 0; tick < {ticks}; ++tick) {{{at_tick}
        good &= {name}_step(&measured[tick], &desired[tick], &state, {output});
        for (int joint = 0; joint < {joints}; ++joint) {{
            const double error = fabs({output}[joint] - expected[tick][joint]);
            good &= error <= {tolerance}; /* also catches NaN */
            worst = fmax(worst, error);
        }}
    }}
    printf("{ticks} ticks, largest difference %.3g {unit}: %s\\n", worst, good ? "passed" : "FAILED");
    return !good;
}}
"""


def _texts(
    name: str,
    scenario: Scenario,
    output: str,
    ticks: Sequence[LawTick],
    code: tuple[LawCode, ...],
    others: Mapping[str, str],
) -> tuple[str, str, str]:
    """Return header, source and self-test."""
    step, (measured, desired) = code[1], fields(ticks[0])
    tables = zip(*([_initialiser(values) for values in fields(tick)] for tick in ticks), strict=True)
    texts = {
        "scenario": scenario.name,
        "version": __version__,
        "name": name,
        "upper": name.upper(),
        "joints": len(ticks[0].torque),
        "output": output,
        "unit": COMMANDS[output],
        "rows": scenario.cell.task_rows.size,
        "kind": scenario.cell.rows,
        "period": scenario.clock.period,
        "flops": sum(flops(step).values()),
        "measurement": _struct(measured, MEASURED | meanings(ticks[0].measurement)),
        "reference": _struct(desired, DESIRED),
        "states": max(len(step.state), 1),
        "ticks": len(ticks),
        **dict(zip(("measured", "desired"), map(",\n".join, tables), strict=True)),
        "expected": ",\n".join(_list(tick.torque) for tick in ticks),
        "tolerance": c_number(tolerance([ticks])),
        **others,
    }
    source = _source(name, measured, desired, code, output)
    return _HEADER.format(**texts), source, _SELF_TEST.format(**texts)


def _source(name: str, measured: Values, desired: Values, codes: tuple[LawCode, ...], output: str) -> str:
    """Return the file of start, step and messages."""
    emitter, inputs = CEmitter(), f"const {name}_measurement *measurement, const {name}_reference *reference"
    read = [f"measurement->{entry}" for entry in _entries(measured)]
    read += [f"reference->{entry}" for entry in _entries(desired)]
    read += [f"state->value[{index}]" for index in range(len(codes[0].state))]
    state = f"{name}_state *state"
    for what, code, arguments in zip(
        ("start", "step", "first_message", "message"),
        codes,
        (state, f"{state}, double *{output}", "double *message", f"const {state}, double *message"),
        strict=False,
    ):
        target = "message" if "message" in what else output
        stores = [(f"state->value[{index}]", number) for index, number in enumerate(code.state)]
        stores += [(f"{target}[{index}]", number) for index, number in enumerate(code.torque)]
        stores.append(("const double is_regular", code.is_regular))
        read_of = [text for text in ("measurement", "reference", "state") if f"*{text}" in inputs + arguments]
        unread = f"{', '.join(f'(void){text}' for text in read_of)}; /* a law need not read them */"
        head = f"int {name}_{what}({inputs}, {arguments})"
        last = "return is_regular != 0.0;"
        emitter.define(head, code.tape, stores, read.__getitem__, first=unread, last=last)
    return f'#include "{name}.h"\n{emitter.text()}'


def _struct(values: Values, comments: Mapping[str, str]) -> str:
    """Return the fields of a struct."""
    sizes = {name: f"[{np.size(value)}]" if np.ndim(value) else "" for name, value in values.items()}
    return "\n".join(f"    double {name}{size}; /* {comments[name]} */" for name, size in sizes.items())


def _entries(values: Values) -> Iterator[str]:
    """Return the expressions of all numbers of a struct."""
    for name, value in values.items():
        yield from [f"{name}[{index}]" for index in range(np.size(value))] if np.ndim(value) else [name]


def _initialiser(values: Values) -> str:
    parts = [_list(value) if np.ndim(value) else c_number(float(value)) for value in values.values()]
    return f"    {{{', '.join(parts)}}}"


def _list(values: Any) -> str:
    return f"{{{', '.join(c_number(float(value)) for value in np.ravel(values))}}}"
