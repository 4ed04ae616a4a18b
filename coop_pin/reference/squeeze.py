"""Desired internal wrenches f_d, the squeeze of the payload: about P or at the tips, a ramp, a function."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from coop_pin.base.arrays import Array, as_array, frozen, require_type
from coop_pin.base.errors import FieldError, InfeasibleMotionError, ScenarioError, one_or_all
from coop_pin.base.schema.base import Description, Positive, Vector6, check_arm_names
from coop_pin.base.schema.pose import Pose
from coop_pin.base.schema.user_code import FunctionName, load_function
from coop_pin.base.spatial import shift_wrench
from coop_pin.reference.quintic import quintic

_ALLOWED_SUM = 1e-9
_SUM_RULE = "internal wrenches must sum to zero: for two arms, one is minus the other"


def _balanced(wrenches: dict[str, Any]) -> dict[str, Any]:
    total = np.sum(list(wrenches.values()), axis=0) if wrenches else np.zeros(6)
    if np.abs(total).max() > _ALLOWED_SUM:
        raise FieldError(f"entries sum to {total.tolist()}; {_SUM_RULE}")
    return wrenches


WrenchTable = Annotated[dict[str, Vector6], AfterValidator(_balanced)]
"""A wrench on each arm about P in *payload* axes, N and N m; they sum to zero. No entries: all are zero."""


class SqueezeReference(Description):
    """Desired internal wrench f_d_i of each arm, Gueaieb et al. (2007), eq. (23).

    The wrench acts on the arm by the payload, about P, in *payload* axes, linear first. The wrenches sum to
    zero over the arms.
    """

    @abstractmethod
    def at(self, time: float, grasps: Mapping[str, Pose]) -> Array:
        """Return f_d, N and N m, read-only, shape (m, 6).

        Args:
            time: s.
            grasps: pose X_PE of each arm's tip in the payload frame, in the order of the rows.
        """

    def tables(self) -> Mapping[str, Mapping[str, Any]]:
        """Return the tables that must name every arm, by field; "" is the squeeze as a whole."""
        return {}

    def check_arms(self, grasps: Mapping[str, Pose]) -> None:
        """Refuse tables that have entries but miss an arm or name an unknown one.

        Args:
            grasps: pose X_PE of each arm's tip in the payload frame.

        Raises:
            FieldError: with the table's field as its path.
        """
        for field, table in self.tables().items():
            if table:
                check_arm_names(table, grasps, field)

    def scaled(self, part: float) -> Self:
        """Return the squeeze with all wrenches times a part.

        Raises:
            InfeasibleMotionError: it is a function, which cannot be scaled.
        """
        if not self.tables():
            cause, who = ("torque", "the drives can hold") if part < 1.0 else ("friction", "the patches need")
            raise InfeasibleMotionError(cause, f"{who} {part:.3g} of the squeeze; scale its function")
        return self.replace(
            **{
                field or "wrenches": {arm: tuple(part * np.array(wrench)) for arm, wrench in table.items()}
                for field, table in self.tables().items()
            }
        )


class ConstantSqueeze(SqueezeReference):
    """f_d = wrenches at all times.

    Attributes:
        wrenches: wrench on each arm; zero when omitted.
    """

    kind: Literal["constant"] = "constant"
    wrenches: WrenchTable = Field(default_factory=dict)

    def tables(self) -> Mapping[str, WrenchTable]:
        """Return the one table."""
        return {"": self.wrenches}

    def at(self, time: float, grasps: Mapping[str, Pose]) -> Array:
        """Return f_d of the arms at a time in s, N and N m, shape (m, 6)."""
        return frozen(_rows(self.wrenches, grasps))


class TipForceSqueeze(SqueezeReference):
    """f_d of forces at the tips, along the lines between them, without moments there.

    Tip i is pressed by ``f_i = -k sum_j u_ij`` with the unit vectors u_ij from tip i to the others: with two
    arms along the line between them. About P that is ``[f_i, r_i x f_i]``, which sums to zero. A force stated
    about P instead loads a grasp that is not on its line with the moment ``-r_i x f_i`` at the wrist.

    Attributes:
        force: mean over the arms of the force at a tip, N; positive squeezes, negative stretches.
    """

    kind: Literal["tip-force"] = "tip-force"
    force: float

    def check_arms(self, grasps: Mapping[str, Pose]) -> None:
        """Refuse a single arm, and tips at one place.

        Raises:
            FieldError: with the tips.
        """
        tips = _tips(grasps)
        for first in range(len(tips)):
            if len(tips) == 1 or any(tips[first] == other for other in tips[first + 1 :]):
                raise FieldError(f"has no line between tips: they are at {tips}", "force")

    def at(self, time: float, grasps: Mapping[str, Pose]) -> Array:
        """Return f_d of the arms at a time in s, N and N m, shape (m, 6)."""
        return _pressed(self.force, _tips(grasps))

    def scaled(self, part: float) -> Self:
        """Return the squeeze with the force times a part."""
        return self.replace(force=part * self.force)


class TipWrenchSqueeze(SqueezeReference):
    """f_d of wrenches stated at the tips: about P they are ``[f_i, n_i + r_i x f_i]``, and sum to zero.

    Attributes:
        wrenches: wrench on each arm by the payload about its own tip E, in payload axes, N and N m.
    """

    kind: Literal["tip-wrench"] = "tip-wrench"
    wrenches: dict[str, Vector6]

    def tables(self) -> Mapping[str, Mapping[str, Any]]:
        """Return the one table."""
        return {"wrenches": self.wrenches}

    def check_arms(self, grasps: Mapping[str, Pose]) -> None:
        """Refuse wrenches of other arms, and such that would move the payload.

        Raises:
            FieldError: with their resultant about P.
        """
        super().check_arms(grasps)
        total = self.at(0.0, grasps).sum(axis=0)
        if np.abs(total).max() > _ALLOWED_SUM:
            raise FieldError(f"sum to {total.tolist()} about P; {_SUM_RULE}", "wrenches")

    def at(self, time: float, grasps: Mapping[str, Pose]) -> Array:
        """Return f_d of the arms at a time in s, N and N m, shape (m, 6)."""
        return frozen(shift_wrench(_rows(self.wrenches, grasps), np.array(_tips(grasps))))


class RampSqueeze(SqueezeReference):
    """f_d = (1 - s) start + s goal, s(t) the quintic from rest to rest.

    Attributes:
        start: wrench on each arm before the ramp; zero when omitted.
        goal: wrench on each arm after it.
        duration: time of the ramp, s.
        start_time: s.
    """

    kind: Literal["ramp"] = "ramp"
    start: WrenchTable = Field(default_factory=dict)
    goal: WrenchTable
    duration: Positive
    start_time: float = 0.0

    def tables(self) -> Mapping[str, WrenchTable]:
        """Return both tables."""
        return {"start": self.start, "goal": self.goal}

    def at(self, time: float, grasps: Mapping[str, Pose]) -> Array:
        """Return f_d of the arms at a time in s, N and N m, shape (m, 6)."""
        s = quintic(time, self.start_time, self.duration).value
        return frozen((1.0 - s) * _rows(self.start, grasps) + s * _rows(self.goal, grasps))


class FunctionSqueeze(SqueezeReference):
    """f_d(t) from a user-written function of time.

    Attributes:
        target: "module:function", called as ``function(time, **options)``. It returns a table {arm: six
            numbers} or an array of shape (m, 6) in the order of the arms, payload axes, N and N m, that sums
            to zero. In Python it may be given as the function itself.
        options: keyword arguments of the function.
    """

    kind: Literal["function"] = "function"
    target: FunctionName
    options: dict[str, Any] = Field(default_factory=dict)

    def at(self, time: float, grasps: Mapping[str, Pose]) -> Array:
        """Return f_d of the arms at a time in s, N and N m, shape (m, 6).

        Raises:
            NameNotFoundError: the module or function does not exist.
            FieldError, ShapeError, OutOfRangeError: the function returned no squeeze of these arms.
        """
        value, called = load_function(self.target, self.options)(time), f"{self.target} at t = {time:g} s"
        if isinstance(value, Mapping):
            check_arm_names(value, grasps, "squeeze.target")
            value = [value[name] for name in grasps]
        rows = as_array(called, value, len(grasps), 6)
        total, largest = rows.sum(axis=0), float(np.abs(rows).max(initial=1.0))
        if np.abs(total).max() > _ALLOWED_SUM * largest:
            raise FieldError(f"{called} sums to {total.tolist()}; {_SUM_RULE}", "squeeze.target")
        return frozen(rows)


def _rows(wrenches: Mapping[str, Any], arms: Collection[str]) -> Array:
    return np.array([wrenches[name] for name in arms]) if wrenches else np.zeros((len(arms), 6))


def _tips(grasps: Mapping[str, Pose]) -> tuple[tuple[float, float, float], ...]:
    """Return the position r_i of each tip in the payload frame, m."""
    require_type("grasps", grasps, Mapping)
    for name, grasp in grasps.items():
        require_type(f"grasp of arm {name!r}", grasp, Pose)
    return tuple(grasp.xyz for grasp in grasps.values())


@lru_cache(maxsize=64)
def _pressed(force: float, tips: tuple[tuple[float, float, float], ...]) -> Array:
    """Return [f_i, r_i x f_i] with f_i = -k sum_j u_ij whose mean norm is the force, shape (m, 6)."""
    r = np.array(tips)
    lines = r[None] - r[:, None]
    lengths = np.linalg.norm(lines, axis=2, keepdims=True)
    pulls = np.divide(lines, lengths, out=np.zeros_like(lines), where=lengths > 0.0).sum(axis=1)
    forces = -force * pulls / np.linalg.norm(pulls, axis=1).mean()
    return frozen(np.concatenate((forces, np.cross(r, forces)), axis=1))


def _plain_table(value: Any) -> Any:
    """Return a table ``{left = [...], right = [...]}`` as constant squeeze; mistakes keep their paths."""
    if not isinstance(value, Mapping) or isinstance(value.get("kind"), str):
        return value
    try:
        return ConstantSqueeze(wrenches=dict(value))
    except ScenarioError as error:
        problems = [
            type(problem)(problem.detail, problem.path.removeprefix("wrenches").lstrip("."))
            for problem in error.problems
        ]
        raise one_or_all(problems, "the squeeze") from None


Squeeze = Annotated[
    Annotated[
        ConstantSqueeze | TipForceSqueeze | TipWrenchSqueeze | RampSqueeze | FunctionSqueeze,
        Field(discriminator="kind"),
    ],
    BeforeValidator(_plain_table),
]
