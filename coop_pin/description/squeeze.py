"""How hard the arms shall squeeze the payload: the desired internal wrenches f_d, constant, ramped, or the user's own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from coop_pin.arrays import Array, as_array
from coop_pin.description.cell import check_arm_names
from coop_pin.description.user_code import FunctionName, load_function
from coop_pin.errors import FieldError, ScenarioError, one_or_all
from coop_pin.reference import ConstantSqueeze, RampedSqueeze, SqueezeFromFunction, SqueezeReference
from coop_pin.schema.base import Description, Positive, Vector6

_ALLOWED_SUM = 1e-9
_SUM_RULE = "internal wrenches must sum to zero: for two arms, one is minus the other"


def _balanced(wrenches: dict[str, Any]) -> dict[str, Any]:
    total = np.sum(list(wrenches.values()), axis=0) if wrenches else np.zeros(6)
    if np.abs(total).max() > _ALLOWED_SUM:
        raise FieldError(f"entries sum to {total.tolist()}; {_SUM_RULE}")
    return wrenches


WrenchTable = Annotated[dict[str, Vector6], AfterValidator(_balanced)]
"""A wrench on each arm about P in *payload* axes, N and N m; they sum to zero. Without entries all are zero."""


class SteadySqueeze(Description):
    """f_d = wrenches at all times.

    Attributes:
        wrenches: for each arm.
    """

    kind: Literal["constant"] = "constant"
    wrenches: WrenchTable = Field(default_factory=dict)

    def tables(self) -> Iterator[tuple[str, Mapping[str, Sequence[float]]]]:
        """Yield the tables that must name every arm, each with its field ("" is the squeeze as a whole)."""
        yield "", self.wrenches

    def build(self, arms: Sequence[str]) -> SqueezeReference:
        """Return the reference for arms in this order."""
        return ConstantSqueeze(_rows(self.wrenches, arms))


class RampSqueeze(Description):
    """From one squeeze to another, smoothly.

    Attributes:
        start: for each arm, before; zero when omitted.
        goal: for each arm, afterwards.
        duration: of the ramp, s.
        start_time: s.
    """

    kind: Literal["ramp"] = "ramp"
    start: WrenchTable = Field(default_factory=dict)
    goal: WrenchTable
    duration: Positive
    start_time: float = 0.0

    def tables(self) -> Iterator[tuple[str, Mapping[str, Sequence[float]]]]:
        """Yield the tables that must name every arm, each with its field."""
        yield "start", self.start
        yield "goal", self.goal

    def build(self, arms: Sequence[str]) -> SqueezeReference:
        """Return the reference for arms in this order."""
        return RampedSqueeze(_rows(self.start, arms), _rows(self.goal, arms), self.duration, self.start_time)


class UserSqueeze(Description):
    """A function of time of the user's own.

    Attributes:
        target: "module:function", called as ``function(time, **options)``. It returns a table {arm: six
            numbers} or an array of shape (m, 6) in the order of the arms, payload axes, N and N m, that sums
            to zero. In Python the function itself will do.
        options: keyword arguments for it.
    """

    kind: Literal["user"] = "user"
    target: FunctionName
    options: dict[str, Any] = Field(default_factory=dict)

    def tables(self) -> Iterator[tuple[str, Mapping[str, Sequence[float]]]]:
        """Yield nothing: what the function returns is checked at every call."""
        yield from ()

    def build(self, arms: Sequence[str]) -> SqueezeReference:
        """Return the reference for arms in this order; ``at`` raises FieldError where the sum is not zero.

        Raises:
            NameNotFoundError: the module or function does not exist.
            FieldError, ShapeError, OutOfRangeError: what it returns at t = 0 is no squeeze of these arms.
        """
        function, names = load_function(self.target, self.options), tuple(arms)
        reference = SqueezeFromFunction(lambda time: _users_rows(function(time), names, time, self.target))
        reference.at(0.0)
        return reference


def _rows(wrenches: Mapping[str, Sequence[float]], arms: Sequence[str]) -> Array:
    """Return the wrenches in the order of the arms, shape (m, 6)."""
    return np.array([wrenches[name] for name in arms]) if wrenches else np.zeros((len(arms), 6))


def _users_rows(value: Any, arms: Sequence[str], time: float, target: str) -> Array:
    """Return what a user's function returned in the order of the arms, checked, shape (m, 6)."""
    called = f"{target} at t = {time:g} s"
    if isinstance(value, Mapping):
        _check_names(value, arms, "squeeze.target")
        rows = as_array(called, [value[name] for name in arms], len(arms), 6)
    else:
        rows = as_array(called, value, len(arms), 6)
    total, largest = rows.sum(axis=0), float(np.abs(rows).max(initial=1.0))
    if np.abs(total).max() > _ALLOWED_SUM * largest:
        raise FieldError(f"{called} sums to {total.tolist()}; {_SUM_RULE}", "squeeze.target")
    return rows


def check_squeeze_arms(squeeze: SteadySqueeze | RampSqueeze | UserSqueeze, arms: Iterable[str]) -> None:
    """Refuse tables that have entries but miss an arm or name one that does not exist.

    Raises:
        FieldError: with the table's field as its path.
    """
    for field, table in squeeze.tables():
        if table:
            _check_names(table, arms, field)


def _check_names(table: Iterable[str], arms: Iterable[str], path: str) -> None:
    try:
        check_arm_names(table, arms, FieldError)
    except FieldError as error:
        raise error.below(path) from None


def _plain_table(value: Any) -> Any:
    """Let a plain table ``{left = [...], right = [...]}`` stand for a constant squeeze; mistakes in it keep the user's paths."""
    if not isinstance(value, Mapping) or isinstance(value.get("kind"), str):
        return value
    try:
        return SteadySqueeze(wrenches=dict(value))
    except ScenarioError as error:
        problems = [
            type(problem)(problem.detail, problem.path.removeprefix("wrenches").lstrip("."))
            for problem in error.problems
        ]
        raise one_or_all(problems, "the squeeze") from None


Squeeze = Annotated[
    Annotated[SteadySqueeze | RampSqueeze | UserSqueeze, Field(discriminator="kind")],
    BeforeValidator(_plain_table),
]
