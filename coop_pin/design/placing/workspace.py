"""Workspaces that arms have in common: heights and distances at which all of them can hold a payload."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.description.cell.payload import Payload
from coop_pin.design.placing.contacts import Shoulders
from coop_pin.design.placing.placement import ArmPlacement, Place

_HEIGHTS = (0.2, 0.3, 0.4, 0.55)
"""Heights of the payload that are tried, over the least reach of the arms."""
_SHOULDER_HEIGHTS = (-0.6, -0.4, -0.2, 0.0)
"""Heights of the payload over their shoulders that are tried, over the least reach of the arms."""
_PARTS = (0.1, 0.25, 0.4, 0.55, 0.7)
"""Heights of the payload that are tried next, as parts of those that all tips reach."""
_STROKE = 0.1
"""Distance around the start, over the least reach, at which every arm can hold the payload."""
_OFF_GROUND = 0.05
"""Least distance of the payload from the ground, m."""


class Workspace(NamedTuple):
    """Pose of the payload that all arms can hold, and move by a stroke.

    Attributes:
        height: height of the payload's centre, m.
        stroke: distance around it, m.
        places: place of each arm.
    """

    height: float
    stroke: float
    places: list[Place]

    @property
    def margin(self) -> float:
        """The least margin of the arms."""
        return min(arm.margin for arm in self.places)


_Tried: TypeAlias = tuple[float, list[Place | None]]
"""Height of the payload, and the place of each arm up to the first that has none."""


def common_places(
    arms: Sequence[ArmPlacement], payload: Payload, distance: float | None
) -> Iterator[Workspace]:
    """Yield common workspaces, one for each height and each distance of a robot, the largest margins first.

    The payload of one robot is looked for straight before its root, and then before the middle of its
    shoulders, at heights about theirs. Other arms stand on the ground; where they reach none of the usual
    heights so, the payload is looked for where they reach, with the bases of hanging arms raised.

    Args:
        arms: the searches.
        payload: the payload.
        distance: distance of the bases from the payload's centre, m; by the arms' reach when omitted.

    Raises:
        InfeasibleMotionError: cause "reach": the bases are too far away, or there is no common workspace;
            cause "torque": and an arm cannot hold itself.
    """
    shortest = min(arms, key=lambda arm: arm.farthest)
    if distance and distance > shortest.farthest:
        raise InfeasibleMotionError(
            "reach",
            f"the bases are {distance:g} m from the payload's centre; {shortest.name} reaches"
            f" {shortest.reach:.2f} m, to a contact {shortest.farthest - shortest.reach:.2f} m from it: state"
            f" less than {shortest.farthest:.2f} m, or leave the distance out",
        )
    ground, tried = payload.size[2] / 2.0 + _OFF_GROUND, list[_Tried]()
    stroke = round(_STROKE * min(arm.reach for arm in arms), 2)
    for origin, heights in _usual_heights(arms, ground):
        sets = [[distance]] if distance else [[]] if origin is None else [[one] for one in shortest.distances]
        looked = _look(arms, heights, stroke, sets, origin)
        tried += looked
        yield from _common(looked, stroke)
    are_planar = all(arm.is_planar for arm in arms)
    may_raise = not (arms[0].shoulders or are_planar or any(arm.slides for arm in arms))
    if may_raise and not _common(tried, stroke):
        sets = [[distance] if distance else []]
        raised = [_raised(arm, dict(tried), stroke, sets) for arm in arms]
        looked = _look(raised, _reached_heights(raised, ground), stroke, sets, None)
        tried += looked
        yield from _common(looked, stroke)
    if not _common(tried, stroke):
        _require_strength(arms)
        raise InfeasibleMotionError("reach", _no_workspace(arms, tried))


def _require_strength(arms: Sequence[ArmPlacement]) -> None:
    """Raise InfeasibleMotionError if an arm cannot hold its own weight in any posture."""
    for arm in arms:
        part, joint = arm.own_weight()
        if part > 1.0:
            detail = (
                f"{arm.name}: its own weight needs {part:.3g} times the torque limit of {joint} where it is"
                " least; state the effort that its drives have in its file"
            )
            raise InfeasibleMotionError("torque", detail)


def _usual_heights(
    arms: Sequence[ArmPlacement], ground: float
) -> Iterator[tuple[Shoulders | None, list[float]]]:
    """Yield points of a robot from which distances count, None of single arms, and heights of the payload."""
    least, shoulders = min(arm.reach for arm in arms), arms[0].shoulders
    for origin in [None] if shoulders is None else [shoulders.root, shoulders]:
        above = 0.0 if origin is None else origin.middle[2] - origin.floor
        parts = _SHOULDER_HEIGHTS if origin is shoulders and above else _HEIGHTS
        heights = sorted({round(max(ground, above + part * least), 2) for part in parts})
        yield origin, [arms[0].plane] if all(arm.is_planar for arm in arms) else heights


def _raised(
    arm: ArmPlacement, heights: Iterable[float], stroke: float, sets: Sequence[list[float]]
) -> ArmPlacement:
    """Return the search of an arm, with its base raised where it holds the payload at none of the heights."""
    looked = _look([arm], heights, stroke, sets, None)
    return arm if any(places[0] for _, places in looked) else arm.raised()


def _reached_heights(arms: Sequence[ArmPlacement], ground: float) -> list[float]:
    """Return heights of the payload between those that all tips reach."""
    low, high = np.transpose([np.add(arm.stand, arm.tip_heights) for arm in arms])
    bottom, top = low.max(), high.min()
    return sorted({round(max(ground, bottom + part * (top - bottom)), 2) for part in _PARTS})


def _look(
    arms: Sequence[ArmPlacement],
    heights: Iterable[float],
    stroke: float,
    sets: Sequence[list[float]],
    origin: Shoulders | None,
) -> list[_Tried]:
    """Return the places of the arms at each height and each set of distances, by the reach where empty."""
    return [
        (height, _places(arms, height, stroke, some, origin))
        for height, some in itertools.product(heights, sets)
    ]


def _common(looked: Sequence[_Tried], stroke: float) -> list[Workspace]:
    """Return the workspaces of all arms, the largest margins first."""
    workspaces = [
        Workspace(height, stroke, [arm for arm in places if arm is not None])
        for height, places in looked
        if None not in places
    ]
    return sorted(workspaces, key=lambda workspace: -workspace.margin)


def _places(
    arms: Sequence[ArmPlacement],
    height: float,
    stroke: float,
    distances: list[float],
    origin: Shoulders | None,
) -> list[Place | None]:
    """Return the place of each arm up to the first that has none; raises nothing."""
    places = list[Place | None]()
    for arm in arms:
        places.append(arm.best(height, stroke, distances or arm.distances, origin))
        if places[-1] is None:
            break
    return places


def _no_workspace(arms: Sequence[ArmPlacement], tried: Sequence[_Tried]) -> str:
    """Return the heights at which each arm can hold the payload, and what to change."""
    held = []
    for k, arm in enumerate(arms):
        looked = [(height, places[k]) for height, places in tried if len(places) > k]
        heights = dict.fromkeys(f"{height:g}" for height, there in looked if there is not None)
        if looked:
            held.append(f"{arm.name} (reach {arm.reach:.2f} m) at {', '.join(heights) or 'none'}")
    slides = ", ".join(dict.fromkeys(joint for arm in arms for joint in arm.slides))
    platform = f", or lock the joints of a platform (locked), among them {slides}" if slides else ""
    every = ", ".join(dict.fromkeys(f"{height:g}" for height, _ in tried))
    return (
        f"no common workspace; of the payload heights {every} m, and around them, {'; '.join(held)}. Take a"
        " smaller payload, another distance of the bases, arms of like reach, or leave out the grasp's side"
        f"{platform}"
    )
