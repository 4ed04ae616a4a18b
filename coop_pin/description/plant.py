"""Plant options: control rate, integration steps, formulation of the constrained dynamics."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from coop_pin.description.baumgarte import Stabilisation
from coop_pin.schema.base import Description, Positive


class Clock(Description):
    """Control rate and integration steps of the plant.

    Attributes:
        rate_hz: control rate, Hz; torques are held over a period T = 1 / rate_hz (zero-order hold).
        steps_per_tick: integration steps of the plant in one control period.
        record_every: ticks from one kept sample to the next; n divides the memory of a long run by n. The
            last tick is always kept. Metrics, verdict and exceeded limits are of all ticks; figures, and
            metrics over other windows, are of the kept ones.
    """

    rate_hz: Positive = Field(default=80.0, le=1e6)
    steps_per_tick: int = Field(default=5, ge=1, le=10_000)
    record_every: int = Field(default=1, ge=1)

    @property
    def period(self) -> float:
        """Control period T, s."""
        return 1.0 / self.rate_hz

    def ticks(self, duration: float) -> int:
        """Return the number of control periods of a run of a duration, s; at least one."""
        return max(1, round(duration * self.rate_hz))


Formulation = Literal["auto", "proximal", "kkt"]


class PlantOptions(Description):
    """Formulation and integration of the plant.

    Attributes:
        payload: "welded" to the first arm's tip (m - 1 loop closures for m arms, faster) or "free" (a
            floating body, m loop closures).
        formulation: "proximal" (pinocchio.constraintDynamics), "kkt" (an independent solver of the KKT
            system, slower, for verification), or "auto", which is "proximal" for rigid grasps.
        integrator: "rk4" or "semi-implicit-euler".
        stabilisation: Baumgarte stabilisation of the loop closures.
        project: times at which positions and velocities are projected onto the closed chain: at the "start"
            only, or after every integration "step".
    """

    payload: Literal["welded", "free"] = "welded"
    formulation: Formulation = "auto"
    integrator: Literal["rk4", "semi-implicit-euler"] = "rk4"
    stabilisation: Stabilisation = Stabilisation()
    project: Literal["start", "step"] = "start"
