"""Thresholds of the two verdicts on a run: numerical trust thresholds and task limits."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, NotNegative, Positive


class TrustThresholds(Description):
    """Thresholds beyond which the simulation of a run is not sound.

    Energy errors are compared with the gross work: the amounts of work done between ticks by drives,
    friction, external wrenches, payload changes and gravity, summed without sign. Sound runs stay below 1e-8
    of it (the catalogue's below 2e-11), semi-implicit Euler needs 1e-2, and a motion through a singular pose
    leaves 1e-4. What end stops take and lose adds 0.2 % of it.

    Attributes:
        closure_error: largest distance and angle between a tip and its grasp, m and rad.
        energy_share: largest energy error as a share of the gross work.
        energy_floor: energy error that is accepted without any work, J.
        joint_slack: distance that a joint without end stops may go beyond its position limits, rad or m.
        jacobian_condition: largest condition number of an arm's payload Jacobian; the catalogue's reach 12,
            and at 100 the torques of an arm that passes a singular pose are many times their usual size.
    """

    closure_error: Positive = 1e-6
    energy_share: Positive = 1e-6
    energy_floor: NotNegative = 1e-6
    joint_slack: NotNegative = 1e-6
    jacobian_condition: float = Field(default=100.0, ge=1.0)

    @model_validator(mode="before")
    @classmethod
    def _without_limits_of_the_task(cls, fields: Any) -> Any:
        """Refuse fields that are task limits; files of earlier versions have them at their defaults."""
        if not isinstance(fields, dict):
            return fields
        moved = {name: TaskLimits.model_fields[name].default for name in ("torque_cut", "joint_drift")}
        for name, default in moved.items():
            if fields.get(name, default) != default:
                raise FieldError(f"is a limit of the task: write it as task.{name}", name)
        return {name: value for name, value in fields.items() if name not in moved}


class TaskLimits(Description):
    """Limits within which a run keeps its task, over all its motion and events.

    The errors that a run starts with may decay first: they count from the time at which all of them are
    within their limits, at the latest from the first event. Of force and moment, the larger one of limit and
    share counts. Reasons for the defaults: an assembly with chamfers takes 2 mm and 10 mrad; a squeeze that
    is a tenth off still holds a payload and does not mark it; wrist sensors have noise of 1 N and 0.1 N m.

    Attributes:
        position: largest distance of the payload from its desired position, m.
        orientation: largest angle from its desired orientation, rad; not judged where the task rows do not
            control it.
        force: largest error of an arm's internal force, N.
        force_share: the same as a share of the desired internal force.
        moment: largest error of an arm's internal moment about P, N m. Components that no law controls
            (outside the task rows, or at a patch) count beyond what the share of the weight asks of a grasp.
        moment_share: the same as a share of the desired internal moment.
        recovery: time from the end of an event in which, as during the event, the errors may be beyond these
            limits, s: for shocks that no law keeps small.
        slip: distance that a patch may slide while it bears its load, m.
        torque_cut: time that a drive torque may stay at its limit without a break, s.
        joint_drift: distance that a joint may drift in the last second of a run whose payload and reference
            rest, rad or m: spare joints of redundant arms that nothing holds.
    """

    position: Positive = 2e-3
    orientation: Positive = 1e-2
    force: Positive = 1.0
    force_share: NotNegative = 0.1
    moment: Positive = 0.1
    moment_share: NotNegative = 0.1
    recovery: NotNegative = 0.0
    slip: NotNegative = 1e-3
    torque_cut: NotNegative = 0.1
    joint_drift: NotNegative = 0.01
