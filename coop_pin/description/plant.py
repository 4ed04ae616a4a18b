"""Plant options: control rate, integration steps, formulation of the constrained dynamics, stabilisation."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, NotNegative, Positive

_SLACK = 1e-9
"""Part by which two rates may differ from whole multiples."""


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

    def ticks_between(self, rate_hz: float | None) -> int:
        """Return the number of ticks from one sample at a rate, Hz, to the next; one without a rate."""
        return 1 if rate_hz is None else round(self.rate_hz / rate_hz)

    def late(self, delay: int, duration: float, path: str) -> list[FieldError]:
        """Return the problem of a delay, ticks, that no sample of a run of a duration, s, survives."""
        if delay < (ticks := self.ticks(duration)):
            return []
        return [FieldError(f"is {delay} ticks, but the run has {ticks}; it must be less", path)]

    def uneven(self, rate_hz: float | None, path: str) -> list[FieldError]:
        """Return the problem of a rate, Hz, that is not the control rate over a whole number."""
        ratio = self.rate_hz / (rate_hz or self.rate_hz)
        if round(ratio) >= 1 and abs(ratio - round(ratio)) <= _SLACK * ratio:
            return []
        near = sorted({max(1, math.floor(ratio)), max(1, math.ceil(ratio))})
        examples = " or ".join(f"{self.rate_hz / whole:.12g}" for whole in near)
        detail = (
            f"is {rate_hz:g} Hz, but the control rate is {self.rate_hz:g} Hz; it must be the control rate"
        )
        return [FieldError(f"{detail} over a whole number, for example {examples}", path)]

    def ticks(self, duration: float) -> int:
        """Return the number of control periods of a run of a duration, s; at least one."""
        return max(1, round(duration * self.rate_hz))


class Stabilisation(Description):
    """Baumgarte stabilisation: a closure error e obeys e'' + 2 zeta omega e' + omega^2 e = 0.

    The Baumgarte terms 2 zeta omega e' + omega^2 e are added to the closures' acceleration constraint
    J a + gamma = 0, with e in m and rad (Baumgarte 1972; Featherstone 2008, chapter 8).

    Attributes:
        frequency: omega, the rate at which a closure error decays, rad/s; 0 switches the stabilisation off.
        damping_ratio: zeta; 1 is the fastest decay without overshoot.
    """

    frequency: NotNegative = 10.0
    damping_ratio: NotNegative = 1.0

    @property
    def position_gain(self) -> float:
        """Factor omega^2 of the closure error, 1/s^2."""
        return self.frequency**2

    @property
    def velocity_gain(self) -> float:
        """Factor 2 zeta omega of the closure error's rate, 1/s."""
        return 2.0 * self.damping_ratio * self.frequency

    def stabilised(self, acceleration: Array, velocity: Array, position: Array) -> Array:
        """Return e'' + 2 zeta omega e' + omega^2 e, shape (r,), which the constrained dynamics make zero.

        Args:
            acceleration: e'', or the part of it that is known, m/s^2 and rad/s^2, shape (r,).
            velocity: e', m/s and rad/s, shape (r,).
            position: e, m and rad, shape (r,).
        """
        return acceleration + self.velocity_gain * velocity + self.position_gain * position


Formulation = Literal["auto", "proximal", "kkt"]


class MujocoOptions(Description):
    """Welds and connects of the engine "mujoco", which are soft.

    A weld that is to bear f lets accelerations differ by (1 - impedance) / impedance of about what f alone
    would cause, until the gap that this opens bears it. Its rows of rotation are half an angle times the
    scale: at 1, MuJoCo's default, they are the softest. The two connects of a hinge stand 2 cm times the
    scale from its grasp, on the axis.

    Attributes:
        time_constant: time in which the gap of a weld closes (``solref``), in integration steps.
        impedance: part of the force that a weld bears at once (``solimp``); MuJoCo allows 0.9999.
        torque_scale: factor of the rows of rotation (``torquescale``).
    """

    time_constant: float = Field(default=2.0, ge=2.0, le=1000.0)
    impedance: float = Field(default=0.9999, gt=0.0, le=0.9999)
    torque_scale: float = Field(default=10.0, gt=0.0, le=1000.0)


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
        mujoco: options that the engine "mujoco" takes in place of formulation and stabilisation.
    """

    payload: Literal["welded", "free"] = "welded"
    formulation: Formulation = "auto"
    integrator: Literal["rk4", "semi-implicit-euler"] = "rk4"
    stabilisation: Stabilisation = Stabilisation()
    project: Literal["start", "step"] = "start"
    mujoco: MujocoOptions = MujocoOptions()
