"""Events of arms: their failure, and changes of the plant by a function of the user's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from pydantic import Field

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import unknown_arms
from coop_pin.base.schema.user_code import FunctionName, load_function
from coop_pin.description.actuators import Actuators
from coop_pin.description.events import PayloadEvent, Surroundings


class LoseArm(PayloadEvent):
    """Failure of an arm: its drives follow no command from then on, and no law has a message of it.

    It is ``torque_lost_at`` or ``commands_lost_at`` of the arm's actuators, as an event.

    Attributes:
        time: time of the failure, s.
        arm: Name of the arm.
        form: "limp": the joints turn freely; "braked": brakes hold the joints where they are, after an
            impulse; "own weight": the robot goes on with its gravity compensation, which the arm's actuators
            must have, from the next tick on.
    """

    kind: Literal["lose-arm"] = "lose-arm"
    arm: str
    form: Literal["limp", "braked", "own weight"] = "limp"
    title = "loss of an arm"
    is_foreseen = True

    def text(self, surroundings: Surroundings) -> str:
        """Return the arm, and what is left of it."""
        return f"{self.arm} fails, {self.form}"

    def actuated(self, arm: str, actuators: Actuators) -> Actuators:
        """Return the actuators of an arm, of its own with the failure."""
        field = "commands_lost_at" if self.form == "own weight" else "torque_lost_at"
        return actuators.replace(**{field: self.time}) if arm == self.arm else actuators

    @property
    def outcome(self) -> str:
        """The arm, and what is left of it."""
        return f"arm {self.arm!r} fails at {self.time:g} s ({self.form})"

    @property
    def requires(self) -> str:  # type: ignore[override]
        """Closures for the brakes."""
        return "closures that come and go" if self.form == "braked" else ""

    def act(self, plant: Any, arms: Sequence[str]) -> None:
        """Close the brakes."""
        if self.form == "braked":
            plant.brake(arms.index(self.arm))

    def problem(self, earlier: Any) -> FieldError | None:
        """Return what is wrong with the arm, given the scenario with the events before it alone."""
        if unknown := unknown_arms([self.arm], earlier.cell.arms):
            return FieldError(unknown[0].detail, "arm")
        actuators = earlier.actuators_of(self.arm)
        if actuators.lost_at is not None:
            detail = f"fails at {actuators.lost_at:g} s already, by its actuators or another event"
            return FieldError(f"is {self.arm!r}, which {detail}", "arm")
        if self.form == "own weight" and actuators.gravity_compensation is None:
            detail = f"is {self.form!r}, but the robot of {self.arm!r} has no gravity compensation"
            return FieldError(f"{detail}; give its actuators gravity_compensation", "form")
        return None


class UserEvent(PayloadEvent):
    """Event of the user's own: a function that changes the plant.

    It is called as ``function(plant, arms, **options)``, with the plant of the run and the names of its arms,
    and may call ``release``, ``brake`` and other methods of the plant, which book the energy. No law is told.

    Attributes:
        time: time of the event, s.
        target: "module:function", or the function.
        options: Keyword arguments handed to it.
    """

    kind: Literal["user"] = "user"
    target: FunctionName
    options: dict[str, Any] = Field(default_factory=dict)
    title = "own event"
    requires = "a plant that code of the user's own may change"

    def act(self, plant: Any, arms: Sequence[str]) -> None:
        """Call the function.

        Raises:
            NameNotFoundError: there is no such module or function.
        """
        load_function(self.target, self.options)(plant, arms)

    def text(self, surroundings: Surroundings) -> str:
        """Return the function's name."""
        return self.target
