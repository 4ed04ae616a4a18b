"""Events at grasps: release, hand-over and taking hold again; the plan that all arms know.

An event moves the part of its load share that an arm bears, and the distance of the arm's tip from its grasp.
Both are functions of time alone: the agreed plan, whatever becomes of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from coop_pin.arrays import Array, Mask
from coop_pin.description.cell import Cell
from coop_pin.description.events import (
    MISSED,
    GravityTurn,
    LoseArm,
    Partner,
    PayloadChange,
    PayloadEvent,
    Surroundings,
    UserEvent,
    WrenchPulse,
)
from coop_pin.errors import FieldError
from coop_pin.reference.quintic import quintic
from coop_pin.schema.base import NotNegative, Positive, unknown_arms
from coop_pin.spatial import internal_wrenches


class GraspEvent(PayloadEvent):
    """Event at the grasp of one arm.

    Attributes:
        time: time of the event, s.
        arm: Name of the arm.
    """

    holds: ClassVar[bool]
    """Whether the arm holds the payload afterwards."""

    arm: str

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return what is wrong with time and arm, given the fields of the run."""
        problems, cell = super().timing_problems(run), run.get("cell")
        if cell is None:
            return problems
        if unknown := unknown_arms([self.arm], cell.arms):
            return [*problems, *(FieldError(one.detail, "arm") for one in unknown)]
        if self.arm in cell.patches:
            detail = f"is {self.arm!r}, which holds by friction: it lets go by less squeeze, or moves away"
            problems.append(FieldError(detail, "arm"))
        return problems

    def load(self, time: float) -> float:
        """Return the part of its load share that the arm bears at a time after the event began."""
        return float(self.holds)


class Release(GraspEvent):
    """Opening of a grasp: from then on it has no wrench.

    Load shares and squeeze change in the same instant for all arms. The arm may then retreat along the
    negative z axis of its grasp frame.

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
    title = heading = "release"

    @property
    def told(self) -> str:
        """The arm, and when it lets go."""
        over = "hands over and " * (self.instant > self.time)
        return f"{self.arm} {over}lets go at {self.instant:g} s"

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
    title = heading = "hand-over"

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

    A rigid grasp holds the tip where it is found, and the velocities meet by an impulse. Before it, the arm
    returns from its retreat; after it, load share and squeeze move to it.

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
    title = heading = "grasp"

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return what is wrong with time, arm and rest pose, given the fields of the run."""
        problems, cell = super().timing_problems(run), run.get("cell")
        if self.rest == "nominal" and cell is not None and self.arm not in cell.unclosed:
            detail = f"is {self.rest!r}, but the grasp of {self.arm!r} is rigid: its tip would jump"
            problems.append(FieldError(f"{detail}; take 'found'", "rest"))
        return problems

    @property
    def end(self) -> float:
        """Time at which the arm bears its share again, s."""
        return self.time + self.duration

    def load(self, time: float) -> float:
        """Return the quintic of the time."""
        return quintic(time, self.time, self.duration).value

    @property
    def told(self) -> str:
        """The arm, and when it takes hold."""
        return f"{self.arm} takes hold at {self.time:g} s"

    @property
    def named(self) -> str:
        """Name, arm and time."""
        return f"{self.title} by {self.arm!r} at {self.time:g} s"

    def is_named(self, remark: str) -> bool:
        """Return whether a remark of a run says that the grasp did not happen."""
        return remark.startswith(f"{self.named} {MISSED}")

    def act(self, plant: Any, arms: Sequence[str]) -> None:
        """Close the grasp, if the tip is there."""
        plant.grasp(arms.index(self.arm), self)

    def text(self, surroundings: Surroundings) -> str:
        """Return the arm, and where its spring rests."""
        return f"{self.title} by {self.arm}, {self.rest} rest pose"


Event = Annotated[
    PayloadChange | WrenchPulse | GravityTurn | Partner | LoseArm | Release | HandOver | Regrasp | UserEvent,
    Field(discriminator="kind"),
]


class GraspPlan(NamedTuple):
    """Agreed plan of the grasps at a time.

    Attributes:
        holds: arms that hold the payload, shape (m,).
        loads: part of its load share that each arm bears, shape (m,).
        shares: load shares c_i, which sum to one, shape (m,).
        retreats: distance of each tip from its grasp along the negative z axis of the grasp frame, m, and its
            two time derivatives, shape (m, 3).
    """

    holds: Mask
    loads: Array
    shares: Array
    retreats: Array

    def squeeze(self, wrenches: Array) -> Array:
        """Return the internal wrenches that are left of desired ones, shape (m, 6).

        With the loads l_i they are l_i f_i - c_i sum_j l_j f_j.
        """
        return internal_wrenches(self.loads[:, None] * wrenches, self.shares)


def grasp_plan(
    cell: Cell, events: Sequence[GraspEvent], time: float, missed: Sequence[GraspEvent] = ()
) -> GraspPlan:
    """Return the plan of grasp events at a time, s; before all of them every arm holds.

    Args:
        cell: Cell, whose arms bear their load shares at first.
        events: The events; of each arm releases and grasps take turns.
        time: Time, s.
        missed: Those that did not happen. The tip has come back for them, but bears nothing.
    """
    m = len(cell.arms)
    holds, loads, retreats = np.ones(m, dtype=bool), np.ones(m), np.zeros((m, 3))
    for index, name in enumerate(cell.arms):
        mine = sorted((event for event in events if event.arm == name), key=lambda event: event.time)
        for event, before in zip(mine, [None, *mine], strict=False):
            if event.time <= time and event not in missed and before not in missed:
                loads[index] = event.load(time)
                holds[index] = event.holds == (event.instant <= time)
        for away, back in itertools.zip_longest(mine[::2], mine[1::2]):
            retreats[index] += _retreat(away, back, time)
    shares = loads * cell.shares
    return GraspPlan(holds, loads, shares / shares.sum(), retreats)


def _retreat(away: Any, back: Any, time: float) -> Array:
    """Return s = d a (1 - b) and its rates; quintics a of the retreat, b of the return."""
    a, a1, a2 = quintic(time, away.instant, away.retreat_time)
    if back is None:
        return away.retreat * np.array((a, a1, a2))
    b, b1, b2 = quintic(time, back.time - back.wait - back.approach_time, back.approach_time)
    stays = 1.0 - b
    return away.retreat * np.array((a * stays, a1 * stays - a * b1, a2 * stays - 2.0 * a1 * b1 - a * b2))


def sequence_problems(cell: Cell, events: Sequence[Any]) -> list[FieldError]:
    """Return what is wrong with the order of grasp events among the events of a run."""
    problems, holding, since = partner_problems(events), dict.fromkeys(cell.arms, True), dict[str, float]()
    numbered = [(event, str(index)) for index, event in enumerate(events) if isinstance(event, GraspEvent)]
    numbered.sort(key=lambda pair: pair[0].time)
    for (event, _), (other, path) in itertools.pairwise(numbered):
        if other.time == event.time:
            detail = f"is {other.time:g} s, as that of another grasp event; let one come a tick later"
            problems.append(FieldError(detail, f"{path}.time"))
    for event, path in numbered:
        if event.arm not in holding:
            continue
        if event.time < since.get(event.arm, 0.0):
            detail = f"is {event.time:g} s, but the event before it at {event.arm!r} ends at"
            problems.append(FieldError(f"{detail} {since[event.arm]:g} s", f"{path}.time"))
        if holding[event.arm] == event.holds:
            state = "holds the payload already" if event.holds else "is free already"
            detail = f"is {event.arm!r}, which {state} at {event.time:g} s"
            problems.append(FieldError(detail, f"{path}.arm"))
        holding[event.arm], since[event.arm] = event.holds, event.end
        if not any(holding.values()):
            detail = f"is {event.arm!r}, the last arm that holds the payload"
            problems.append(FieldError(f"{detail}: one must hold it", f"{path}.arm"))
    return problems


def partner_problems(events: Sequence[Any]) -> list[FieldError]:
    """Return which partners among the events of a run take hold before the one before has let go."""
    numbered = [(event, str(index)) for index, event in enumerate(events) if isinstance(event, Partner)]
    numbered.sort(key=lambda pair: pair[0].time)
    detail = "is {:g} s, but the partner before it holds until {:g} s"
    return [
        FieldError(detail.format(after.time, before.end), f"{path}.time")
        for (before, _), (after, path) in itertools.pairwise(numbered)
        if after.time < before.end
    ]
