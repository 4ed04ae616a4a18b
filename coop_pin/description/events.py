"""Events during a run: a change of the payload's mass, and a wrench pulse on the payload."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from coop_pin.description.payload import Payload
from coop_pin.errors import FieldError
from coop_pin.schema.base import Description, NotNegative, Positive, Vector6


class PayloadEvent(Description):
    """Event on the payload: it may change the payload at its time, and push it until its end.

    Attributes:
        kind: name of the event's kind in scenario files.
        time: time of the event, s.
    """

    title: ClassVar[str]
    """Name of the event, in a few words."""
    heading: ClassVar[str]
    """Name of what it brings."""

    kind: str
    time: NotNegative

    @property
    def end(self) -> float:
        """Time at which the event is over, s; its own time if it is over at once."""
        return self.time

    @property
    def instants(self) -> tuple[float, ...]:
        """Times at which it changes what acts on the payload, s."""
        return self.time, self.end

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return what is wrong with the event's time, given the fields of the run."""
        if self.end <= (duration := run.get("duration", math.inf)):
            return []
        detail = f"the run ends at {duration:g} s: lengthen it or move the event"
        return [FieldError(f"ends at t = {self.end:g} s; {detail}", "time")]

    def push_at(self, time: float) -> Vector6 | None:
        """Return the wrench on the payload about P in world axes from a time on, N and N m; None if none."""
        return None

    def apply(self, payload: Payload) -> Payload:
        """Return the payload after the event: the same object if it does not change."""
        return payload

    def text(self, payload: Payload) -> str:
        """Return what happens to a payload, for people to read."""
        return self.title


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
    heading = "new mass"

    def apply(self, payload: Payload) -> Payload:
        """Return the payload after the event."""
        return payload.with_mass(self.mass)

    def text(self, payload: Payload) -> str:
        """Return both masses."""
        return f"mass {payload.mass:g} → {self.mass:g} kg"


class WrenchPulse(PayloadEvent):
    """Constant wrench on the payload for a limited time.

    Attributes:
        time: start, s.
        duration: s.
        wrench: force and moment on the payload about P in world axes, N and N m.
    """

    kind: Literal["wrench-pulse"] = "wrench-pulse"
    duration: Positive
    wrench: Vector6
    title = heading = "push"

    @property
    def end(self) -> float:
        """End of the pulse, s."""
        return self.time + self.duration

    def push_at(self, time: float) -> Vector6 | None:
        """Return the wrench during the pulse."""
        return self.wrench if self.time <= time < self.end else None

    def text(self, payload: Payload) -> str:
        """Return force, moment and duration."""
        parts = [
            f"({', '.join(f'{part:g}' for part in vector)}) {unit}"
            for vector, unit in ((self.wrench[:3], "N"), (self.wrench[3:], "N m"))
            if any(vector)
        ]
        return f"{self.title} {' and '.join(parts)} for {self.duration:g} s"


Event = Annotated[PayloadChange | WrenchPulse, Field(discriminator="kind")]
