"""Controllers that a scenario can name: the laws of the package, and users' own classes."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.user_code import FunctionName, load_class
from coop_pin.control import (
    Admittance,
    ArmController,
    CellController,
    ControlledArm,
    DecentralisedController,
    LeaderFollower,
    MeanPose,
    PayloadSpace,
    PrescribedPerformance,
    RedundantSlidingMode,
    SlidingMode,
    Symmetric,
)
from coop_pin.control.law import Law
from coop_pin.description.model_laws import Adaptive, ComputedTorque, ObjectImpedance, TorqueQp


class UserController(Law):
    """A controller class of the user's own.

    Attributes:
        target: "module:Class", or the class; it is called with the scenario, the arm's name and the options.
        options: Keyword arguments handed to it.
    """

    kind: Literal["user"] = "user"
    target: FunctionName
    options: dict[str, Any] = Field(default_factory=dict)

    @field_validator("target")
    @classmethod
    def _is_a_users(cls, target: str) -> str:
        if target.startswith("coop_pin."):
            raise FieldError(f"is {target!r}, of the package; state its law by kind and gains")
        return target

    @property
    def command_kind(self) -> str:
        """Empty: the class says what it commands once it is built."""
        return ""

    @property
    def user_code(self) -> tuple[str, ...]:
        """Name of the class."""
        return (self.target,)

    @property
    def needs(self) -> tuple[str, ...]:
        """What the class says that it needs; the internal wrench only where it is measured."""
        return self.measured(load_class(self.target).needs)

    def build(self, scenario: Any, arms: Iterable[ControlledArm]) -> CellController:
        """Return the controller of the user's class.

        An ArmController is called as ``Class(scenario, arm, **options)`` for each arm, a CellController as
        ``Class(scenario, **options)``.

        Raises:
            FieldError: the class is neither, or it does not take the options.
            NameNotFoundError: there is no such module or class.
        """
        kind: Any = load_class(self.target)
        if not issubclass(kind, CellController | ArmController):
            detail = f"is {self.target!r}, which is neither an ArmController nor a CellController"
            raise FieldError(detail, "controller.target")
        of_cell = issubclass(kind, CellController)
        _require_methods(kind, self.target, "s" if of_cell else "")
        try:
            inspect.signature(kind).bind(scenario, *([] if of_cell else [""]), **self.options)
        except TypeError as error:
            call = "(scenario, **options)" if of_cell else "(scenario, arm, **options)"
            detail = f"do not fit {self.target!r}, which is called as {kind.__name__}{call}: {error}"
            raise FieldError(detail, "controller.options") from None
        if of_cell:
            return kind(scenario, **self.options)
        return DecentralisedController(
            {name: kind(scenario, name, **self.options) for name in scenario.cell.arms}
        )


def _require_methods(kind: type[Any], target: str, s: str) -> None:
    """Refuse a class without the methods of a controller, or whose methods take other arguments.

    Raises:
        FieldError: a method is missing, or cannot be called as the loop calls it.
    """
    arguments = f"measurement{s}", f"reference{s}", "state"
    for name, count in (("init", 2), ("step", 3)):
        call = f"def {name}(self, {', '.join(arguments[:count])})"
        method = getattr(kind, name)
        if getattr(method, "__isabstractmethod__", False):
            raise FieldError(f"is {target!r}, which has no method {name}; write {call}", "controller.target")
        try:
            inspect.signature(method).bind(kind, *arguments[:count])
        except TypeError as error:
            detail = f"is {target!r}, whose {name} takes other arguments ({error}); write {call}"
            raise FieldError(detail, "controller.target") from None


PackageLaw = (
    SlidingMode
    | RedundantSlidingMode
    | PayloadSpace
    | MeanPose
    | Symmetric
    | PrescribedPerformance
    | LeaderFollower
    | Admittance
    | ComputedTorque
    | Adaptive
    | ObjectImpedance
    | TorqueQp
)
"""The laws that come with coop_pin."""


Controller = Annotated[PackageLaw | UserController, Field(discriminator="kind")]
