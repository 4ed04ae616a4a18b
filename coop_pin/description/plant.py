"""How time runs: the control rate, the plant's steps, and how the plant is solved."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from coop_pin.schema.base import Description, NotNegative, Positive


class Clock(Description):
    """Control rate and plant steps.

    Attributes:
        rate_hz: control rate, Hz; torques are held over a tick of T = 1 / rate_hz.
        steps_per_tick: plant steps in a tick.
    """

    rate_hz: Positive = 80.0
    steps_per_tick: int = Field(default=5, ge=1)

    @property
    def period(self) -> float:
        """T, s."""
        return 1.0 / self.rate_hz


class Stabilisation(Description):
    """Baumgarte stabilisation: a closure error e obeys e'' + 2 zeta omega e' + omega^2 e = 0.

    Attributes:
        frequency: omega, how fast a gap between tip and grasp is closed again, rad/s.
        damping_ratio: zeta; 1 closes it fastest without overshoot.
    """

    frequency: NotNegative = 10.0
    damping_ratio: NotNegative = 1.0

    @property
    def position_gain(self) -> float:
        """omega^2, 1/s^2."""
        return self.frequency**2

    @property
    def velocity_gain(self) -> float:
        """2 zeta omega, 1/s."""
        return 2.0 * self.damping_ratio * self.frequency


Formulation = Literal["auto", "proximal", "kkt"]


class PlantOptions(Description):
    """How the plant is formulated and integrated.

    Attributes:
        payload: "welded" at the first arm's tip (m - 1 closures, faster) or "free" (a floating body, m
            closures).
        formulation: "proximal" (pinocchio.constraintDynamics), "kkt" (an independent solver, slower, to
            check the other by), or "auto", which is "proximal" for the rows of grasps.
        integrator: "rk4" or "semi-implicit-euler".
        stabilisation: of the closures.
        project: when angles and speeds are moved onto the closed chain exactly: at the "start" only, or after
            every "step".
    """

    payload: Literal["welded", "free"] = "welded"
    formulation: Formulation = "auto"
    integrator: Literal["rk4", "semi-implicit-euler"] = "rk4"
    stabilisation: Stabilisation = Stabilisation()
    project: Literal["start", "step"] = "start"
