"""Actuators of an arm: servo, lag, rate limit, missed ticks, gravity compensation, loss of torque."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pydantic import Field

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, NotNegative
from coop_pin.description.servo import Limit, NamedServo


class GravityCompensation(Description):
    """Gravity compensation by the robot itself, from a model of its own arm without the payload.

    Attributes:
        mass_error: relative error of the masses in that model: 0.1 compensates 1.1 times the arm's weight.
    """

    mass_error: float = Field(default=0.0, ge=-1.0)


class Actuators(Description):
    """What the drives of an arm make of its commands; without values they deliver them at once.

    With the command tau_c[k] of the controller at tick k, the arm's transmission T and the torque limits of
    the cell, the drive torques tau(t) on t_k <= t < t_k+1 are

        c[k] = tau_c[k], or c[k-1] with probability missed_ticks
        u[k] = clip(c[k] + (1 + mass_error) T^-T g(q(t_k)), -torque_limits, torque_limits)
        tau = u[k], or with lag or rate limit: d tau/dt = clip((u[k] - tau) / lag, -rate_limit, rate_limit)
        tau = 0 from torque_lost_at on, or tau_c = 0 from commands_lost_at on

    With a servo, the command is a velocity or a position, tau_c is what the servo makes of it at each of its
    samples, and it is not heard after missed ticks or commands_lost_at.

    The compensation, with g(q) the true weight of the arm alone, is held over the tick; a missed tick does
    not stop it. Lag and rate limit are solved exactly between ticks, whatever the control rate; each
    integration step of the plant applies the mean of tau over it, which has the exact impulse. Before the
    first tick the drives hold the cell at rest: tau and c start from what that takes.

    Attributes:
        servo: inner loop of a robot that takes velocities or positions, or the name of one of SERVOS; None
            for a robot that takes torques.
        lag: time constant of a first-order lag, s; 0 for none.
        rate_limit: largest rate of the torque, N m/s, one value for all drives or one for each.
        missed_ticks: probability that the command of a tick is lost, each tick by itself; the drives go on
            with the last one.
        gravity_compensation: torque that the robot adds to the commands.
        torque_lost_at: time from which the arm gives no torque, s; its joints then turn freely.
        commands_lost_at: time from the next tick of which no command reaches the drives, s; the robot goes on
            with zero in their place, and with its own gravity compensation.
    """

    servo: NamedServo | None = None
    lag: NotNegative = 0.0
    rate_limit: Limit | None = None
    missed_ticks: float = Field(default=0.0, ge=0.0, le=1.0)
    gravity_compensation: GravityCompensation | None = None
    torque_lost_at: NotNegative | None = None
    commands_lost_at: NotNegative | None = None

    @property
    def lost_at(self) -> float | None:
        """Time at which the arm loses its torque or its commands, s; None for never."""
        return self.torque_lost_at if self.commands_lost_at is None else self.commands_lost_at

    @property
    def takes(self) -> str:
        """What the arm takes as commands: "torque", "velocity" or "position"."""
        return "torque" if self.servo is None else self.servo.command

    def command_problem(self, commands: str) -> FieldError | None:
        """Return the problem of a law that commands "torque", "velocity" or "position" to the arm."""
        if commands == self.takes:
            return None
        remedy = "remove it" if commands == "torque" else f"give it a servo with command = {commands!r}"
        return FieldError(
            f"makes the arm take {self.takes!r}, but the controller commands {commands!r}; {remedy}, or"
            f" choose a controller that commands {self.takes!r}",
            "servo",
        )

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return what is wrong with a loss's time or the servo's rate, given the fields of the run."""
        lost, duration = self.lost_at, run.get("duration", math.inf)
        field = "torque_lost_at" if self.commands_lost_at is None else "commands_lost_at"
        if field == "commands_lost_at" and self.torque_lost_at is not None:
            return [FieldError("is stated beside torque_lost_at, which leaves nothing: state one", field)]
        servo = [] if self.servo is None else self.servo.timing_problems(run)
        if lost is None or lost <= duration:
            return [problem.below("servo") for problem in servo]
        detail = f"the run ends at {duration:g} s: lengthen it, or lose the arm earlier"
        return [FieldError(f"is {lost:g} s; {detail}", field)]
