"""Workspaces that arms have in common: heights and distances at which all of them can hold a payload."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.description.cell.payload import Payload
from coop_pin.design.placing.contacts import Shoulders
from coop_pin.design.placing.placement import ArmPlacement, Place

_HEIGHTS = (0.2, 0.3, 0.4, 0.55)
"""Heights of the payload that are tried, over the least reach of the arms."""
_SHOULDER_HEIGHTS = (-0.6, -0.4, -0.2, 0.0)
"""Heights of the payload over their shoulders that are tried, over the least reach of the arms."""
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
    shoulders, at heights about theirs.

    Args:
        arms: the searches.
        payload: the payload.
        distance: distance of the bases from the payload's centre, m; by the arms' reach when omitted.

    Raises:
        InfeasibleMotionError: cause "reach": the bases are too far away, or there is no common workspace.
    """
    shortest = min(arms, key=lambda arm: arm.farthest)
    if distance and distance > shortest.farthest:
        raise InfeasibleMotionError(
            "reach",
            f"the bases are {distance:g} m from the payload's centre; {shortest.name} reaches"
            f" {shortest.reach:.2f} m, to a contact {shortest.farthest - shortest.reach:.2f} m from it: state"
            f" less than {shortest.farthest:.2f} m, or leave the distance out",
        )
    least = min(arm.reach for arm in arms)
    ground = payload.size[2] / 2.0 + _OFF_GROUND
    stroke, shoulders = round(_STROKE * least, 2), arms[0].shoulders
    origins = [None] if shoulders is None else [shoulders.root, shoulders]
    tried, has_one = list[_Tried](), False
    for origin in origins:
        above = 0.0 if origin is None else origin.middle[2] - origin.floor
        parts = _SHOULDER_HEIGHTS if origin is shoulders and above else _HEIGHTS
        heights = sorted({round(max(ground, above + part * least), 2) for part in parts})
        if all(arm.is_planar for arm in arms):
            heights = [arms[0].plane]
        sets = [[distance]] if distance else [[]] if origin is None else [[one] for one in shortest.distances]
        common = list[Workspace]()
        for height, some in itertools.product(heights, sets):
            tried.append((height, places := _places(arms, height, stroke, some, origin)))
            if None not in places:
                common.append(Workspace(height, stroke, [arm for arm in places if arm is not None]))
        has_one = has_one or bool(common)
        yield from sorted(common, key=lambda workspace: -workspace.margin)
    if not has_one:
        raise InfeasibleMotionError("reach", _no_workspace(arms, tried))


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
