"""Internal wrench of an arm, formed from the wrist wrenches that all arms tell each other."""

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
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm
from coop_pin.control.told_law import MemorylessTellingLaw, further, heard


@dataclass(frozen=True, eq=False)
class ExchangedWrench(MemorylessTellingLaw):
    """A law that measures the internal wrench by messages: ``f_i = F_i - c_i sum_j F_j``.

    Every arm says its wrist wrench about P in world axes and the age of that sample, k_0 + 1 numbers, then
    what its law says. All F_j, its own among them, are those that were sent: equal sets at all arms make f_i
    that sum to zero and do not move the payload. f_i is as old as the oldest of them, and f_d before all are
    there. Where one is lost, sets differ by what the wrenches changed since.

    The network's delay adds to that of the wrists: the anchor gain is stable below ``anchor_gain_bound`` of
    both, 2 sin(pi / (4 D + 2)) without a filter.

    Attributes:
        law: Law of this arm.
        arm: Numbers of the arm; c_i is its load share where references name none.
    """

    needs: ClassVar[tuple[str, ...]] = ("messages", "wrenches of all arms")

    arm: ControlledArm

    def said(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> Array:
        """Return F_i and the age of its sample, shape (k_0 + 1,)."""
        return np.append(own_wrench(measurement, self.arm), measurement.interaction_wrench_age)

    def seen(self, measurement: ArmMeasurement, reference: ArmReference) -> ArmMeasurement:
        """Return the measurement with the internal wrench, and the messages of the law."""
        k_0, messages = len(measurement.payload_twist), heard(measurement)
        wrenches = [message.numbers[:k_0] for message in messages.values()]
        ages = [message.age + message.numbers[k_0] for message in messages.values()]
        f = messages[self.arm.name].numbers[:k_0] - reference.share(self.arm) * reduce(add, wrenches)
        f_d = self.arm.rows.turn(measurement.payload_pose, reference.internal_wrench)
        age = reduce(np.maximum, ages)
        return measurement._replace(
            internal_wrench=np.where(age < np.inf, f, f_d),
            internal_wrench_age=age,
            messages=further(measurement, k_0 + 1),
        )


def own_wrench(measurement: ArmMeasurement, arm: ControlledArm) -> Array:
    """Return F_i.

    Raises:
        InvalidStateError: the arm has no wrist sensor.
    """
    if measurement.interaction_wrench is None:
        raise InvalidStateError(f"arm {arm.name!r} has no wrist sensor; give it one: sensors.wrist")
    return measurement.interaction_wrench


def less_load(
    measurement: ArmMeasurement, reference: ArmReference, arm: ControlledArm, load: Array, size: int
) -> ArmMeasurement:
    """Return a measurement with F_i - c_i load for the internal wrench, f_d before the wrist's first sample.

    Args:
        measurement: Measurement of the arm.
        reference: Reference of the arm.
        arm: Numbers of the arm.
        load: Wrench of the payload on all arms, shape (k_0,).
        size: Number of numbers of a message that are not the law's.
    """
    age, F = measurement.interaction_wrench_age, own_wrench(measurement, arm)
    f_d = arm.rows.turn(measurement.payload_pose, reference.internal_wrench)
    return measurement._replace(
        internal_wrench=np.where(age < np.inf, F - reference.share(arm) * load, f_d),
        internal_wrench_age=age,
        messages=further(measurement, size),
    )


class MessageForcePath(PlainForcePath):
    """Internal wrench that each arm forms from the wrist wrenches of all, by messages: ExchangedWrench."""

    hears_all: ClassVar[bool] = True

    kind: Literal["messages"] = "messages"

    def law_told(self, law: ArmController, arm: ControlledArm, scenario: Any) -> ArmController:
        """Return the law of an arm, told by ExchangedWrench."""
        return ExchangedWrench(law, arm)
