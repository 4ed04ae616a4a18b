"""Events during a run: what acts on the payload from outside, and what changes it.

``Surroundings`` is the one value that plants hold and that events make: a new event changes fields of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import AfterValidator, field_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import (
    Description,
    NotNegative,
    Positive,
    Vector3,
    Vector6,
    not_negative,
)
from coop_pin.base.schema.pose import Pose
from coop_pin.description.actuators import Actuators
from coop_pin.reference.motions import Motion

MISSED = "did not happen"
"""Words in the remark of a run on an event that did not happen."""


class Surroundings(NamedTuple):
    """Payload and what acts on it from outside, from an instant on.

    Plants read it; sensors, laws and the robots' own gravity compensation keep what they believe.

    Attributes:
        mass: Mass of the payload, kg.
        inertia: Inertia of the payload about P in the axes of P, kg m^2, shape (3, 3).
        gravity: Gravitational acceleration in world axes, m/s^2, shape (3,).
        push: Wrench on the payload about P in world axes, N and N m, shape (6,).
        partners: Partners that hold the payload.
    """

    mass: float
    inertia: Array
    gravity: Array
    push: Array
    partners: tuple[Partner, ...] = ()

    @property
    def acts(self) -> bool:
        """Whether a wrench other than gravity may act on the payload; plants skip it otherwise."""
        return bool(self.push.any() or self.partners)


class PayloadEvent(Description):
    """Event that changes the payload or what acts on it.

    Attributes:
        kind: name of the event's kind in scenario files.
        time: time of the event, s.
    """

    title: ClassVar[str]
    """Name of the event, in a few words."""
    is_foreseen: ClassVar[bool] = False
    """Whether it is of the scenario from the start on, and cannot be added to a run that goes on."""
    requires: ClassVar[str] = ""
    """What it needs of a plant beyond torques, payload, push and gravity; empty for nothing."""

    kind: str
    time: NotNegative

    @property
    def heading(self) -> str:
        """Name of its button on a page."""
        return self.title

    @property
    def end(self) -> float:
        """Time at which the event is over, s; its own time if it is over at once."""
        return self.time

    @property
    def instant(self) -> float:
        """Time at which the event acts on the plant, s."""
        return self.time

    @property
    def outcome(self) -> str:
        """Clause on what happens to arms and grasps; empty for other events."""
        return ""

    def is_named(self, remark: str) -> bool:
        """Return whether a remark of a run says that the event did not happen."""
        return False

    def needs_pinocchio(self, cell: Any) -> bool:
        """Return whether a compiled plant under an interpreted law does not have what it requires, either."""
        return bool(self.requires)

    def act(self, plant: Any, arms: Sequence[str]) -> Any:
        """Change the plant itself at the event's instant, grasps and brakes; return what was missed, or None.

        Args:
            plant: Plant of the run (``coop_pin.simulation.plant.Plant``).
            arms: Names of the arms, in the plant's order.
        """

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return what is wrong with the event's time, given the fields of the run."""
        if self.end <= (duration := run.get("duration", math.inf)):
            return []
        detail = f"the run ends at {duration:g} s: lengthen it or move the event"
        return [FieldError(f"ends at t = {self.end:g} s; {detail}", "time")]

    def problem(self, earlier: Any) -> FieldError | None:
        """Return what is wrong with the event, given the scenario with the events before it alone."""
        return None

    def actuated(self, arm: str, actuators: Actuators) -> Actuators:
        """Return the actuators of an arm with what the event does to them."""
        return actuators

    def borne(self, time: float) -> float:
        """Return the part of the load that the arms bear at a time: all, unless a table takes it."""
        return 1.0

    def apply(self, surroundings: Surroundings, time: float) -> Surroundings:
        """Return the surroundings at a time; fields that the event leaves alone stay the same objects.

        Args:
            surroundings: Surroundings without this event.
            time: Time, s, not before the event's own.
        """
        return surroundings

    def text(self, surroundings: Surroundings) -> str:
        """Return what happens, for people to read.

        Args:
            surroundings: Surroundings before the event.
        """
        return self.title


AnyEvent = TypeVar("AnyEvent", bound=PayloadEvent)


def of_kind(events: Iterable[PayloadEvent], kind: type[AnyEvent]) -> tuple[AnyEvent, ...]:
    """Return the events of a kind, in their order."""
    return tuple(event for event in events if isinstance(event, kind))


class PayloadChange(PayloadEvent):
    """Sudden change of the payload's mass.

    Shape and centre of mass stay as they are; the inertia scales with the mass.

    Attributes:
        time: time of the change, s.
        mass: the new mass, kg.
    """

    kind: Literal["payload-change"] = "payload-change"
    mass: Positive
    title = "change of mass"

    @property
    def heading(self) -> str:
        """Name of what it brings."""
        return "new mass"

    def apply(self, surroundings: Surroundings, time: float) -> Surroundings:
        """Return the surroundings with the new mass."""
        scale = self.mass / surroundings.mass
        return surroundings._replace(mass=self.mass, inertia=scale * surroundings.inertia)

    def text(self, surroundings: Surroundings) -> str:
        """Return both masses."""
        return f"mass {surroundings.mass:g} → {self.mass:g} kg"


class LastingEvent(PayloadEvent):
    """Event that takes a time.

    Attributes:
        duration: time that it takes, s.
    """

    duration: Positive

    @property
    def end(self) -> float:
        """Time at which it is over, s."""
        return self.time + self.duration


class WrenchPulse(LastingEvent):
    """Constant wrench on the payload for a limited time.

    Attributes:
        time: start, s.
        duration: s.
        wrench: force and moment on the payload about P in world axes, N and N m.
    """

    kind: Literal["wrench-pulse"] = "wrench-pulse"
    wrench: Vector6
    title = "push"

    def apply(self, surroundings: Surroundings, time: float) -> Surroundings:
        """Return the surroundings, with the wrench during the pulse."""
        push = surroundings.push
        return surroundings._replace(push=push + np.array(self.wrench) if time < self.end else push)

    def text(self, surroundings: Surroundings) -> str:
        """Return force, moment and duration."""
        parts = [
            f"({', '.join(f'{part:g}' for part in vector)}) {unit}"
            for vector, unit in ((self.wrench[:3], "N"), (self.wrench[3:], "N m"))
            if any(vector)
        ]
        return f"{self.title} {' and '.join(parts)} for {self.duration:g} s"


class GravityTurn(PayloadEvent):
    """Sudden change of gravity in world axes, as for a cell on a base that tilts.

    Laws and the robots' own gravity compensation go on with the gravity of the cell.

    Attributes:
        time: time of the change, s.
        gravity: the new gravitational acceleration in world axes, m/s^2.
    """

    kind: Literal["gravity-turn"] = "gravity-turn"
    gravity: Vector3
    title = "turn of gravity"

    @property
    def heading(self) -> str:
        """Name of what it brings."""
        return "new gravity"

    def apply(self, surroundings: Surroundings, time: float) -> Surroundings:
        """Return the surroundings with the new gravity."""
        return surroundings._replace(gravity=np.array(self.gravity))


class Partner(LastingEvent):
    """Person or machine at a handle: spring and damper between the handle and a point that the partner moves.

    In axes of the point's frame, with the handle's displacement p and rotation R from it and its relative
    twist V, the wrench on the payload about the handle is F = -K [p, r] - D V, as of CompliantGrasp. The
    point is where the handle would be if the payload moved as the partner wants it to. No law is told.

    Attributes:
        time: time at which the partner takes hold, s.
        duration: time for which the partner holds, s.
        motion: Motion of the payload that the partner wants.
        handle: Pose of the handle in the payload frame.
        stiffness: Diagonal of K, N/m and N m/rad; 0 where the partner does not hold against a motion.
        damping: Diagonal of D, N s/m and N m s/rad.
    """

    kind: Literal["partner"] = "partner"
    motion: Motion
    handle: Pose = Pose()
    stiffness: Annotated[Vector6, AfterValidator(not_negative)]
    damping: Annotated[Vector6, AfterValidator(not_negative)] = (0.0,) * 6
    title = "partner"
    requires = "force elements"

    @field_validator("stiffness")
    @classmethod
    def _holds(cls, stiffness: tuple[float, ...]) -> tuple[float, ...]:
        if not any(stiffness):
            raise FieldError("is zero in every direction; a partner holds in at least one")
        return stiffness

    @field_validator("motion")
    @classmethod
    def _of_poses(cls, motion: Motion) -> Motion:
        if motion.kind == "joints":
            raise FieldError("is of joint angles, which a partner does not have; give a motion of poses")
        return motion

    def apply(self, surroundings: Surroundings, time: float) -> Surroundings:
        """Return the surroundings, with the partner while it holds."""
        return surroundings._replace(partners=surroundings.partners + (self,) * (time < self.end))

    @property
    def outcome(self) -> str:
        """Time of the hold."""
        return f"a partner holds the payload from {self.time:g} to {self.end:g} s"

    def text(self, surroundings: Surroundings) -> str:
        """Return stiffness and duration."""
        return f"{self.title} with {max(self.stiffness[:3]):g} N/m at the handle for {self.duration:g} s"


def surroundings_at(surroundings: Surroundings, events: Iterable[PayloadEvent], time: float) -> Surroundings:
    """Return the surroundings that events leave from a time on, s."""
    for event in sorted(events, key=lambda event: event.time):
        if event.time <= time:
            surroundings = event.apply(surroundings, time)
    return surroundings


def event_differences(
    events: Sequence[PayloadEvent], base: Sequence[PayloadEvent], surroundings: Surroundings
) -> Iterator[str]:
    """Yield events with their times as text if they differ from those of a base; surroundings at t = 0."""
    if events != base:
        texts = [f"{event.text(surroundings)} at {event.time:g} s" for event in events]
        yield f"events: {', '.join(texts)}" if texts else "no events"
