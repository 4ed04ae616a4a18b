"""Internal wrench of an arm by the wrist wrenches of all arms, exchanged as messages."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any, ClassVar, Literal

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InvalidStateError
from coop_pin.control.controller import ArmController
from coop_pin.control.force_paths.force_path import PlainForcePath
from coop_pin.control.law_wrapper import LawWrapper, Parts, Received, WrappedState
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm


@dataclass(frozen=True, eq=False)
class ExchangedWrench(LawWrapper):
    """Law that measures the internal wrench by messages: ``f_i = F_i - c_i sum_j F_j``.

    Every arm sends its wrist wrench about P in world axes and the age of that sample, k_0 + 1 numbers. All
    F_j, its own among them, are those that were sent: equal sets at all arms make f_i that sum to zero and do
    not move the payload. f_i is as old as the oldest of them, and f_d before all are there. Where one is
    lost, sets differ by what the wrenches changed since.

    The network's delay adds to that of the wrists: the anchor gain is stable below ``anchor_gain_bound`` of
    both, 2 sin(pi / (4 D + 2)) without a filter.

    With a threshold the arms are silent where nothing changed: what was heard last then counts as new, until
    an arm is silent for longer than it may be.

    Attributes:
        law: Law of this arm.
        arm: Numbers of the arm; c_i is its load share where references name none.
        delay: D, largest age of a message that is not lost, ticks.
        silence: Ticks for which an arm may have nothing to say.
    """

    arm: ControlledArm
    delay: float = 0.0
    silence: float = 0.0

    def sent(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> Parts:
        """Return F_i and the age of its sample."""
        age = np.atleast_1d(measurement.interaction_wrench_age)
        return {"wrench": own_wrench(measurement, self.arm), "wrench_age": age}

    def transformed(
        self,
        measurement: ArmMeasurement,
        reference: ArmReference,
        memory: Any,
        sent: Parts,
        received: Received,
    ) -> tuple[ArmMeasurement, Any]:
        """Return the measurement with the internal wrench."""
        wrenches, ages = received["wrench"], received["wrench_age"]
        total = reduce(add, [F.numbers for F in wrenches.values()])
        age = reduce(np.maximum, [self.lateness(one.age) + one.numbers[0] for one in ages.values()])
        f = wrenches[self.arm.name].numbers - reference.share(self.arm) * total
        f_d = self.arm.rows.turn(measurement.payload_pose, reference.internal_wrench)
        f = np.where(age < np.inf, f, f_d)
        return measurement._replace(internal_wrench=f, internal_wrench_age=age), memory

    def lateness(self, age: float) -> Any:
        """Return the age of the wrench in an arm's last message, ticks, given the age of the message."""
        holds = (age <= self.delay + self.silence) & (age < np.inf)
        return np.where(holds, np.minimum(age, self.delay), age)


def own_wrench(measurement: ArmMeasurement, arm: ControlledArm) -> Array:
    """Return F_i.

    Raises:
        InvalidStateError: the arm has no wrist sensor.
    """
    if measurement.interaction_wrench is None:
        raise InvalidStateError(f"arm {arm.name!r} has no wrist sensor; give it one: sensors.wrist")
    return measurement.interaction_wrench


def less_load(
    measurement: ArmMeasurement, reference: ArmReference, arm: ControlledArm, load: Array
) -> ArmMeasurement:
    """Return a measurement with F_i - c_i load for the internal wrench, f_d before the wrist's first sample.

    Args:
        measurement: Measurement of the arm.
        reference: Reference of the arm.
        arm: Numbers of the arm.
        load: Wrench of the payload on all arms, shape (k_0,).
    """
    age, F = measurement.interaction_wrench_age, own_wrench(measurement, arm)
    f_d = arm.rows.turn(measurement.payload_pose, reference.internal_wrench)
    return measurement._replace(
        internal_wrench=np.where(age < np.inf, F - reference.share(arm) * load, f_d),
        internal_wrench_age=age,
    )


class MessageForcePath(PlainForcePath):
    """Internal wrench that each arm forms from the wrist wrenches of all, by messages: ExchangedWrench."""

    hears_all: ClassVar[bool] = True

    kind: Literal["messages"] = "messages"

    def wrapped(self, law: ArmController, arm: ControlledArm, scenario: Any) -> ArmController:
        """Return the law of an arm in an ExchangedWrench."""
        network, names = scenario.network, list(scenario.cell.arms)
        silence = network.longest_silence_of(names, scenario.clock)
        return ExchangedWrench(law, arm, float(network.slowest_of(names)), silence)
