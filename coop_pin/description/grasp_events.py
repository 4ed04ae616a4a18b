"""Events at grasps: release, hand-over, taking hold again, and putting down on a table."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import Field

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import NotNegative, Positive, unknown_arms
from coop_pin.description.arm_events import LoseArm, UserEvent
from coop_pin.description.cell.cell import Cell
from coop_pin.description.events import (
    MISSED,
    AnyEvent,
    GravityTurn,
    LastingEvent,
    Partner,
    PayloadChange,
    PayloadEvent,
    Surroundings,
    WrenchPulse,
    of_kind,
)
from coop_pin.reference.quintic import quintic


class GraspEvent(PayloadEvent):
    """Event at the grasp of one arm.

    Attributes:
        time: time of the event, s.
        arm: Name of the arm.
    """

    holds: ClassVar[bool]
    """Whether the arm holds the payload afterwards."""
    requires = "grasps that open and close"

    arm: str

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return what is wrong with time and arm, given the fields of the run."""
        problems, cell = super().timing_problems(run), run.get("cell")
        if cell is None:
            return problems
        if self.arm in cell.tools:
            problems.append(FieldError(f"is {self.arm!r}, whose tip is a tool: it holds nothing", "arm"))
        return [*problems, *(FieldError(one.detail, "arm") for one in unknown_arms([self.arm], cell.arms))]

    def needs_pinocchio(self, cell: Any) -> bool:
        """Return whether the grasp is not compliant: the traced plant opens and closes those alone."""
        return self.arm not in cell.compliant

    @property
    def heading(self) -> str:
        """Name and arm."""
        return f"{self.title}: {self.arm}"

    @property
    def named(self) -> str:
        """Name, arm and time."""
        return f"{self.title} by {self.arm!r} at {self.time:g} s"

    def load(self, time: float) -> float:
        """Return the part of its load share that the arm bears at a time after the event began."""
        return float(self.holds)


class Release(GraspEvent):
    """Opening of a grasp: from then on it has no wrench.

    Load shares and squeeze change in the same instant for all arms. The arm may then retreat along the
    negative z axis of its grasp frame; a patch, which opens by that alone, along the normal of its face.

    Attributes:
        time: time of the release, s.
        arm: Name of the arm.
        retreat: Distance of the retreat, m.
        retreat_time: Duration of the retreat, s.
    """

    kind: Literal["release"] = "release"
    retreat: NotNegative = 0.0
    retreat_time: Positive = 1.0
    holds = False
    title = "release"

    @property
    def outcome(self) -> str:
        """The arm, and when it lets go."""
        return f"arm {self.arm!r} lets go at {self.instant:g} s"

    def act(self, plant: Any, arms: Sequence[str]) -> None:
        """Open the grasp."""
        plant.release(arms.index(self.arm))

    def text(self, surroundings: Surroundings) -> str:
        """Return the arm."""
        return f"{self.title} of {self.arm}"


class HandOver(Release):
    """Release after load share and squeeze of the arm have gone over to the others.

    Attributes:
        time: time at which the shares begin to move, s.
        arm: Name of the arm that leaves.
        duration: Time over which they move, s; then the grasp opens.
        retreat: Distance of the retreat, m.
        retreat_time: Duration of the retreat, s.
    """

    kind: Literal["hand-over"] = "hand-over"  # type: ignore[assignment]
    duration: Positive = 1.0
    title = "hand-over"

    @property
    def end(self) -> float:
        """Time of the release, s."""
        return self.time + self.duration

    @property
    def instant(self) -> float:
        """Time of the release, s."""
        return self.end

    def load(self, time: float) -> float:
        """Return one minus the quintic of the time."""
        return 1.0 - quintic(time, self.time, self.duration).value


class Regrasp(GraspEvent):
    """Closing of a grasp that was released; it does not happen if the tip is too far away.

    A patch comes back to the face, and the squeeze that moves to it presses it on. A rigid grasp holds the
    tip where it is found, and the velocities meet by an impulse. Before it, the arm returns from its retreat,
    if that is over; after it, load share and squeeze move to it. An arm that has failed takes no hold.

    Attributes:
        time: time at which the grasp closes, s.
        arm: Name of the arm.
        rest: Pose of the tip on the payload at which the grasp rests: as "found", without any force; or, if
            compliant, "nominal", that of the cell, which puts the energy of the deflection into the spring.
        tolerance: Largest distance of the tip from its nominal grasp, m.
        angle_tolerance: Largest angle between them, rad.
        approach_time: Duration of the return, s.
        wait: Time that the arm waits at its grasp before it closes, s.
        duration: Time over which load share and squeeze move, s.
    """

    kind: Literal["grasp"] = "grasp"
    rest: Literal["found", "nominal"] = "found"
    tolerance: Positive = 5e-3
    angle_tolerance: Positive = 0.05
    approach_time: Positive = 1.0
    wait: NotNegative = 0.5
    duration: Positive = 1.0
    holds = True
    title = "grasp"

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return what is wrong with time, arm and rest pose, given the fields of the run."""
        problems, cell = super().timing_problems(run), run.get("cell")
        if self.rest == "nominal" and cell is not None and self.arm not in cell.unclosed:
            detail = f"is {self.rest!r}, but the grasp of {self.arm!r} is rigid: its tip would jump"
            problems.append(FieldError(f"{detail}; take 'found'", "rest"))
        return problems

    def problem(self, earlier: Any) -> FieldError | None:
        """Return that the arm has failed, given the scenario with the events before it alone."""
        lost = earlier.actuators_of(self.arm).lost_at if self.arm in earlier.cell.arms else None
        problem = FieldError(f"is {self.arm!r}, which fails at {lost} s: it cannot take hold", "arm")
        return None if lost is None or lost > self.time else problem

    @property
    def end(self) -> float:
        """Time at which the arm bears its share again, s."""
        return self.time + self.duration

    def load(self, time: float) -> float:
        """Return the quintic of the time."""
        return quintic(time, self.time, self.duration).value

    @property
    def outcome(self) -> str:
        """The arm, and when it takes hold."""
        return f"arm {self.arm!r} takes hold at {self.time:g} s"

    def is_named(self, remark: str) -> bool:
        """Return whether a remark of a run says that the grasp did not happen."""
        return remark.startswith(f"{self.named} {MISSED}")

    def act(self, plant: Any, arms: Sequence[str]) -> MissedGrasp | None:
        """Close the grasp, if the tip is there; return the grasp if it did not happen."""
        arm = arms.index(self.arm)
        missed = MissedGrasp(self, *plant.gap(arm))
        if missed.distance > self.tolerance or missed.angle > self.angle_tolerance:
            return missed
        plant.grasp(arm, is_nominal=self.rest == "nominal")
        return None

    def text(self, surroundings: Surroundings) -> str:
        """Return the arm, and where its spring rests."""
        return f"{self.title} by {self.arm}, {self.rest} rest pose"


class MissedGrasp(NamedTuple):
    """Grasp that did not happen, because its tip was too far away.

    Attributes:
        event: the event.
        distance: distance of the tip from the grasp, m.
        angle: angle between them, rad.
    """

    event: Regrasp
    distance: float
    angle: float

    def __str__(self) -> str:
        """Return it as one sentence."""
        event, distance, angle = self
        return (
            f"{event.named} {MISSED}: its tip was {1e3 * distance:.3g} mm and {angle:.3g} rad from the grasp,"
            f" allowed are {1e3 * event.tolerance:g} mm and {event.angle_tolerance:g} rad"
        )


class PutDown(LastingEvent):
    """Hand-over of the load to a table, by all arms.

    From then on no part of the measured wrenches is load: the law keeps each arm's whole wrench at its
    squeeze, so that the table gets the weight, and no error of the pose can press on it. Nothing feels the
    table: the plan says when the payload lies on it. Only then may the last arm let go.

    Attributes:
        time: time from which the load goes over, s.
        duration: Time over which it does, s.
    """

    kind: Literal["put-down"] = "put-down"
    duration: Positive = 0.5
    title = "put down"

    @property
    def outcome(self) -> str:
        """When the table takes the load."""
        return f"a table bears the load from {self.end:g} s on"

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return what is wrong with the time, or that there is no table."""
        problems, cell = super().timing_problems(run), run.get("cell")
        if cell is not None and not cell.tables:
            problems.append(FieldError("puts the payload down, but the cell has no tables: give it one"))
        return problems

    def borne(self, time: float) -> float:
        """Return one minus the quintic of the time."""
        return 1.0 - quintic(time, self.time, self.duration).value


_AtArms = LoseArm | Release | HandOver | Regrasp
_AtPayload = PayloadChange | WrenchPulse | GravityTurn | Partner | PutDown | UserEvent
Event = Annotated[_AtPayload | _AtArms, Field(discriminator="kind")]


def sequence_problems(cell: Cell, events: Sequence[Any]) -> list[FieldError]:
    """Return what is wrong with the order of grasp events among the events of a run."""
    detail = "is {:g} s, but the partner before it holds until {:g} s"
    problems = [
        FieldError(detail.format(after.time, before.end), f"{path}.time")
        for (before, _), (after, path) in itertools.pairwise(_in_order(events, Partner))
        if after.time < before.end
    ]
    holding, since = {arm: arm not in cell.tools for arm in cell.arms}, dict[str, float]()
    retreated = dict[str, float]()
    laid = min((event.end for event in of_kind(events, PutDown)), default=math.inf)
    at_grasps = _in_order(events, GraspEvent)
    for (event, _), (other, path) in itertools.pairwise(at_grasps):
        if other.time == event.time:
            detail = f"is {other.time:g} s, as that of another grasp event; let one come a tick later"
            problems.append(FieldError(detail, f"{path}.time"))
    for event, path in at_grasps:
        if event.time < since.get(event.arm, 0.0):
            detail = f"is {event.time:g} s, but the event before it at {event.arm!r} ends at"
            problems.append(FieldError(f"{detail} {since[event.arm]:g} s", f"{path}.time"))
        begins = event.time - event.wait - event.approach_time if isinstance(event, Regrasp) else math.inf
        if round(begins - (back := retreated.get(event.arm, -math.inf)), 9) < 0.0:
            detail = f"is {event.time:g} s: its approach begins at {begins:g} s, before the retreat ends at"
            problems.append(FieldError(f"{detail} {back:g} s", f"{path}.time"))
        if isinstance(event, Release) and event.retreat:
            retreated[event.arm] = event.instant + event.retreat_time
        if holding[event.arm] == event.holds:
            state = "holds the payload already" if event.holds else "is free already"
            detail = f"is {event.arm!r}, which {state} at {event.time:g} s"
            problems.append(FieldError(detail, f"{path}.arm"))
        holding[event.arm], since[event.arm] = event.holds, event.end
        if cell.jointed and any(holding.values()):
            try:
                cell.require_payload_held(list(holding.values()), f"{path}.arm")
            except FieldError as problem:
                problems.append(problem)
        if not any(holding.values()) and event.time < laid:
            detail = f"is {event.arm!r}, the last arm that holds the payload"
            problems.append(FieldError(f"{detail}: one must hold it until it is put down", f"{path}.arm"))
        if (left := [arm for arm in holding if holding[arm]]) and not sum(map(cell.share, left)):
            detail = f"is {event.arm!r}, after which the load share of {', '.join(left)} is 0: give one"
            problems.append(FieldError(detail, f"{path}.arm"))
    return problems


def _in_order(events: Sequence[Any], kind: type[AnyEvent]) -> list[tuple[AnyEvent, str]]:
    """Return the events of a kind in the order of their times, each with its number among all."""
    numbered = [(event, str(index)) for index, each in enumerate(events) for event in of_kind([each], kind)]
    return sorted(numbered, key=lambda pair: pair[0].time)
