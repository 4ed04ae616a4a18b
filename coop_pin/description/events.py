"""Events during a run: a change of the payload's mass, and a wrench pulse on the payload."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from coop_pin.description.payload import Payload
from coop_pin.schema.base import Description, NotNegative, Positive, Vector6


class PayloadChange(Description):
    """Sudden change of the payload's mass.

    Shape and centre of mass stay as they are; the inertia scales with the mass.

    Attributes:
        time: time of the change, s.
        mass: the new mass, kg.
    """

    kind: Literal["payload-change"] = "payload-change"
    time: NotNegative
    mass: Positive

    @property
    def end(self) -> float:
        """Time of the change, s: it is over at once."""
        return self.time

    def apply(self, payload: Payload) -> Payload:
        """Return the payload after the event."""
        return payload.with_mass(self.mass)


class WrenchPulse(Description):
    """Constant wrench on the payload for a limited time.

    Attributes:
        time: start, s.
        duration: s.
        wrench: force and moment on the payload about P in world axes, N and N m.
    """

    kind: Literal["wrench-pulse"] = "wrench-pulse"
    time: NotNegative
    duration: Positive
    wrench: Vector6

    @property
    def end(self) -> float:
        """End of the pulse, s."""
        return self.time + self.duration


Event = Annotated[PayloadChange | WrenchPulse, Field(discriminator="kind")]
