"""Things that happen to the payload during a run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from coop_pin.description.payload import Payload
from coop_pin.schema.base import Description, NotNegative, Positive, Vector6


class PayloadChange(Description):
    """The payload's mass changes at once; its shape and centre of mass stay, its inertia scales with the mass.

    Attributes:
        time: s.
        mass: the new mass, kg.
    """

    kind: Literal["payload-change"] = "payload-change"
    time: NotNegative
    mass: Positive

    def apply(self, payload: Payload) -> Payload:
        """Return the payload after the event."""
        return payload.with_mass(self.mass)


class WrenchPulse(Description):
    """A constant wrench pushes the payload for a while.

    Attributes:
        time: when it starts, s.
        duration: how long it lasts, s.
        wrench: force and moment on the payload about P in world axes, N and N m.
    """

    kind: Literal["wrench-pulse"] = "wrench-pulse"
    time: NotNegative
    duration: Positive
    wrench: Vector6

    @property
    def end(self) -> float:
        """When it ends, s."""
        return self.time + self.duration


Event = Annotated[PayloadChange | WrenchPulse, Field(discriminator="kind")]
