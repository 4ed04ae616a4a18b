"""Controllers with the kinematics of their arms as traced code, checked against ticks of their own."""

from __future__ import annotations

import contextlib
import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import TracingError
from coop_pin.base.spatial.task_rows import TaskRows
from coop_pin.compiled.constants import ArmConstants
from coop_pin.control import ArmController, ArmMeasurement, ArmReference, CellCommand, CellController, Message
from coop_pin.control.measurement import DESIRED, MEASURED, Outgoing, SentIf
from coop_pin.simulation.devices.sensors import measured_motion
from coop_pin.tracing.evaluation import evaluate
from coop_pin.tracing.tape import Number, Operand, Tape, UntraceableError, operands
from coop_pin.tracing.traced_array import inputs, masks, plain
from coop_pin.tracing.tree import leaves, rebuilt, structure

AGREEMENT = 1e-12
"""Largest difference of torques from those of the Python law, relative to the largest torque of the ticks."""

Values: TypeAlias = Mapping[str, Any]
"""Values of fields of a measurement or a reference by name."""
Trace: TypeAlias = Callable[..., "tuple[LawCode, Any]"]
"""The function ``traced_call`` with all but its last two arguments."""


_FLOPS = ("add", "sub", "mul", "div", "sqrt")
"""Operations that count as floating-point operations; comparisons, choices and signs do not."""
_NOTHING = np.zeros(0)


class LawTick(NamedTuple):
    """One recorded tick of the law of an arm.

    Attributes:
        measurement: Measurement of the arm, with the holding torques of the first tick.
        reference: Reference of the arm.
        torque: Torque by the law, N m, shape (k,), or the velocity or position that it commands.
        message: Message by the law, shape (w,); none of laws that say nothing.
    """

    measurement: ArmMeasurement
    reference: ArmReference
    torque: Array
    message: Any = _NOTHING


class RecordedLaw(CellController):
    """Law whose ticks are recorded.

    Attributes:
        ticks: Ticks so far, of each arm.
        first_messages: Messages of the arms before the first tick; none of a law that says nothing.
    """

    def __init__(self, law: CellController) -> None:
        self._law, self.ticks = law, list[list[LawTick]]()
        self.first_messages = self._latest = list[Any]()
        self._first: Sequence[ArmMeasurement] = ()

    def commands_of(self, arm: str) -> str:
        """Return what the law commands to an arm."""
        return self._law.commands_of(arm)

    def messages(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> list[Outgoing]:
        """Return the law's messages."""
        self._latest = self._law.messages(measurements, references, state)
        if state is None:
            self.first_messages = self._latest
        return self._latest

    def init(self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]) -> Any:
        """Return the law's state at the first tick."""
        self._first = measurements
        return self._law.init(measurements, references)

    def step(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> CellCommand:
        """Return the law's command."""
        command = self._law.step(measurements, references, state)
        measured = [
            measurement._replace(holding_torque=first.holding_torque)
            for measurement, first in zip(measurements, self._first, strict=True)
        ]
        torques, messages = map(np.asarray, command.values), self._latest or [_NOTHING] * len(measured)
        self.ticks.append(list(map(LawTick, measured, references, torques, messages)))
        return command


class LawCode(NamedTuple):
    """Traced code of one function of the interface.

    Attributes:
        tape: Operations; the inputs are the fields of measurement and reference, then the state.
        state: State after it, operands of the tape.
        torque: Torques, operands of the tape, none of the start.
        is_regular: Mask, whether the law's conditions hold.
    """

    tape: Tape
    state: list[Operand]
    torque: list[Operand]
    is_regular: Operand

    @classmethod
    def of(cls, tape: Tape, state: Any, torque: Sequence[Number]) -> LawCode:
        """Return the code of a tape after which a law has a state and a torque."""
        (is_regular,) = operands(tape, [math.prod(tape.guards, start=1.0)])
        return cls(tape, operands(tape, leaves(state)), operands(tape, torque), is_regular)

    @property
    def outputs(self) -> list[Operand]:
        """Operands that the function returns."""
        return [*self.torque, *self.state, self.is_regular]


def fields(tick: LawTick) -> tuple[Values, Values]:
    """Return the values of measurement and reference that are inputs of the code, by name."""
    measurement, reference = tick.measurement._asdict(), tick.reference._asdict()
    measured = {name: measurement[name] for name in MEASURED}
    absent = {name for name, value in measured.items() if value is None}
    absent |= {f"{name}_age" for name in absent}
    present = {name: value for name, value in measured.items() if name not in absent}
    messages = tick.measurement.messages or {}
    for name, sender in heard_fields(tick.measurement).items():
        present |= {name: messages[sender].numbers, f"{name}_age": messages[sender].age}
    return present, {name: reference[name] for name in DESIRED}


def heard_fields(measurement: ArmMeasurement) -> dict[str, str]:
    """Return the names of the fields with messages, and from whom they come."""
    heard = measurement.messages or {}
    return {f"heard_{index}_{re.sub(r'[^A-Za-z0-9]', '_', name)}": name for index, name in enumerate(heard)}


def trace_law(controller: CellController, trace: Trace) -> tuple[LawCode, LawCode]:
    """Return the traced start and step of a controller, with the kinematics of its arms.

    Args:
        controller: Controller of the arms.
        trace: Tracer of functions of their laws.

    Raises:
        TracingError: The controller cannot be traced.
    """

    def step(
        measured: list[ArmMeasurement], desired: list[ArmReference], state: Any
    ) -> tuple[Any, list[Number]]:
        measured = [each._replace(holding_torque=None) for each in measured]
        values, state = controller.step(measured, desired, state)
        return state, [entry for arm in values for entry in plain(arm).flat]

    start, first_state = trace(lambda measured, desired, _: (controller.init(measured, desired), []))
    code, state = trace(step, first_state)
    if structure(state) != structure(first_state):
        raise TracingError("returns another kind of state from step than from init")
    return start, code


def trace_messages(law: ArmController, trace: Trace) -> tuple[LawCode, LawCode]:
    """Return the traced messages of an arm before its first tick and at a tick, which stand for the torque.

    Args:
        law: Law of the arm.
        trace: Tracer of functions of its law.

    Raises:
        TracingError: The law cannot be traced.
    """

    def say(
        measured: list[ArmMeasurement], desired: list[ArmReference], state: Any
    ) -> tuple[Any, list[Number]]:
        (silent,) = [each._replace(messages=None, holding_torque=None) for each in measured]
        message = law.message(silent, desired[0], state)
        if message is None or isinstance(message, SentIf):
            raise TracingError("may have nothing to say, for which exported code has no form")
        return (), list(plain(message).flat)

    _, first_state = trace(lambda measured, desired, _: (law.init(measured[0], desired[0]), []))
    return trace(say)[0], trace(say, first_state)[0]


def traced_call(
    arms: Sequence[ArmConstants],
    rows: TaskRows,
    first: Sequence[LawTick],
    exact: bool,
    function: Callable[[list[ArmMeasurement], list[ArmReference], Any], tuple[Any, list[Number]]],
    state: Any = None,
) -> tuple[LawCode, Any]:
    """Return the traced code of a function of a law, and the state that it returned.

    Args:
        arms: Numbers of each arm.
        rows: Task rows of the cell.
        first: Tick of each arm, whose fields that are not None become inputs.
        exact: Mode of tracing, as of law_code.
        function: Function of measurements, references and a state; returns a state and numbers.
        state: State like that which it is given.
    """
    tape, measurements, references = _inputs_of(arms, rows, first)
    with law_code(tape, exact=exact):
        state = rebuilt(state, (inputs(tape) for _ in itertools.count()))
        state, numbers = function(measurements, references, state)
        return LawCode.of(tape, state, numbers), state


def _inputs_of(
    arms: Sequence[ArmConstants], rows: TaskRows, first: Sequence[LawTick]
) -> tuple[Tape, list[ArmMeasurement], list[ArmReference]]:
    """Return a tape with the fields of ticks as inputs, and the measurements and references they make."""
    tape, measurements, references = Tape(), list[ArmMeasurement](), list[ArmReference]()
    for arm, tick in zip(arms, first, strict=True):
        measured, desired = (
            {name: inputs(tape, *np.shape(value)) for name, value in values.items()}
            for values in fields(tick)
        )
        messages = {
            name: Message(measured.pop(field), measured.pop(f"{field}_age"))
            for field, name in heard_fields(tick.measurement).items()
        }
        q, v = measured.pop("q"), measured.pop("v")
        motion = measured_motion(arm.view(rows, arm.to_joints.dot(q)), q, v)
        others = {"internal_wrench": None, **measured, "saturated": masks(measured["saturated"])}
        time = others.pop("time")
        measurements.append(ArmMeasurement(time, *motion, **others, messages=messages or None))
        references.append(ArmReference(**desired))
    return tape, measurements, references


@contextlib.contextmanager
def as_tracing_errors() -> Iterator[None]:
    """Raise a TracingError of what the compiler refuses."""
    try:
        yield
    except UntraceableError as error:
        raise TracingError(str(error)) from error


@contextlib.contextmanager
def law_code(tape: Tape, *, exact: bool) -> Iterator[None]:
    """Record a law on a tape.

    Args:
        tape: Tape.
        exact: Whether NaN and inf must pass as in numpy; of the package's laws, tests show that they do not.

    Raises:
        TracingError: The law raises anything, or it caught what refused to be traced.
    """
    try:
        with as_tracing_errors(), tape.exact(exact):
            yield
            if tape.refusals:
                raise tape.refusals[0]
    except TracingError:
        raise
    except Exception as error:  # of libraries, and of users
        raise TracingError(f"computes with what cannot be traced: {type(error).__name__}: {error}") from error


def _flat(ticks: Sequence[LawTick]) -> list[float]:
    """Return the inputs of a tick of all arms in the order of the tape."""
    values = (value for tick in ticks for values in fields(tick) for value in values.values())
    return [float(x) for value in values for x in np.ravel(value)]


def tolerance(ticks: Sequence[Sequence[LawTick]]) -> float:
    """Return the allowed difference of torques, N m."""
    return AGREEMENT * max(float(np.abs(arm.torque).max()) for tick in ticks for arm in tick)


def require_agreement(start: LawCode, step: LawCode, ticks: Sequence[Sequence[LawTick]]) -> None:
    """Refuse traced code whose torques at the recorded ticks of all arms are not those of the law.

    Raises:
        TracingError: They are not.
    """
    allowed, state = tolerance(ticks), evaluate(start.tape, start.state, _flat(ticks[0]))
    for tick in ticks:
        values = evaluate(step.tape, [*step.torque, *step.state], [*_flat(tick), *state])
        torque, state = values[: len(step.torque)], values[len(step.torque) :]
        expected = np.concatenate([arm.torque for arm in tick])
        error = float(np.abs(np.array(torque) - expected).max())
        if not error <= allowed:
            raise TracingError(
                f"differs from its traced code by {error:.3g} N m at t = {tick[0].measurement.time:g} s:"
                " it keeps state besides that of init and step, or depends on more than its arguments"
            )


def flops(code: LawCode) -> dict[str, int]:
    """Return the number of floating-point operations of traced code, by kind."""
    return {name: sum(name == other for other in _names(code.tape, code.outputs)) for name in _FLOPS}


def _names(tape: Tape, outputs: Sequence[Operand]) -> Iterator[str]:
    """Return the operations that outputs need, those of functions as often as they are called."""
    for index in tape.live(outputs):
        name, _, called = tape.operations[index]
        yield name
        if called is not None:
            yield from _names(called.tape, called.outputs)
