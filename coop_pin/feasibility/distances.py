"""Least distance between arms, payload and tables along a motion: where, when, and which pairs were left out.

It finds what comes too close; it plans no way round it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.carried_motion import displacement, seen_by_arms, shared_positions
from coop_pin.feasibility.cell_distances import CellDistances, Exemption
from coop_pin.feasibility.reachability import Reachability, reachability
from coop_pin.model.cell_arm import CellArm

_POSES = 101


class Nearest(NamedTuple):
    """Two bodies of a cell where they are nearest.

    Attributes:
        pair: names of the bodies: arm/link, "payload" or table/name.
        distance: distance of their convex hulls, negative where they overlap, m.
        time: time, s.
        points: nearest points in the world, m, shape (2, 3).
    """

    pair: tuple[str, str]
    distance: float
    time: float
    points: Array

    def __str__(self) -> str:
        """Return it as text."""
        middle = ", ".join(f"{entry:.3f}" for entry in self.points.mean(axis=0) + 0.0)
        return (
            f"{self.pair[0]} and {self.pair[1]} {1e3 * self.distance:.1f} mm apart at t = {self.time:.4g} s,"
            f" near ({middle}) m"
        )


@dataclass(frozen=True, eq=False)
class Distances:
    """Least distances of a cell along a motion.

    Attributes:
        scenario: name of the scenario.
        clearance: distance that is asked for, m.
        times: times of the poses, s, shape (n,).
        least: the least distance at each pose, m, shape (n,); infinite without a pair.
        pairs: the pair at each pose.
        points: nearest points of the two in the world, m, shape (n, 2, 3).
        below: pairs that come closer than the clearance, the nearest first, each where it is nearest.
        exempt: pairs of bodies that were not looked at, by rule.
        rules: source, for each robot, of what exempts pairs of it: the name of its SRDF, or adjacency.
        omitted: links without a shape, with the reason.
    """

    scenario: str
    clearance: float
    times: Array
    least: Array
    pairs: tuple[tuple[str, str], ...]
    points: Array
    below: tuple[Nearest, ...]
    exempt: tuple[Exemption, ...]
    rules: dict[str, str]
    omitted: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether all pairs keep the clearance."""
        return not self.below

    @property
    def nearest(self) -> Nearest | None:
        """The pair that comes nearest, where it does; None without a pair."""
        if not np.isfinite(self.least).any():
            return None
        at = int(np.argmin(self.least))
        return Nearest(self.pairs[at], float(self.least[at]), float(self.times[at]), self.points[at])

    def sentence(self) -> str:
        """Return the finding in a sentence."""
        rules = ", ".join(f"{arm} by {rule}" for arm, rule in self.rules.items())
        left_out = f"{len(self.exempt)} pairs exempt ({rules})"
        left_out += f"; without shapes: {', '.join(self.omitted)}" if self.omitted else ""
        if (nearest := self.nearest) is None:
            return f"no two bodies move against each other; {left_out}"
        if self.ok:
            return f"nearest bodies: {nearest}; {left_out}"
        more = f"; {len(self.below) - 1} more pairs" if len(self.below) > 1 else ""
        asked = f"closer than the clearance of {1e3 * self.clearance:g} mm" if self.clearance else "overlap"
        return (
            f"{nearest}: {asked}{more}. The plant lets bodies pass through each other, and no way round is"
            f" planned here: choose another posture, grasp or path; {left_out}"
        )

    def summary(self) -> str:
        """Return the sentence, all pairs below the clearance, and all exempt pairs with their rule."""
        by_rule = dict[str, list[str]]()
        for (one, other), reason in self.exempt:
            by_rule.setdefault(reason, []).append(f"{one} - {other}")
        lines = [f"{self.scenario}: {self.sentence()}", *(f"  ! {each}" for each in self.below)]
        lines += [f"  exempt, {reason}: {', '.join(pairs)}" for reason, pairs in by_rule.items()]
        return "\n".join(lines)


@typed
def distances(
    scenario: Scenario, cell_reach: Reachability | None = None, *, poses: int = _POSES
) -> Distances:
    """Return the least distances between arms, payload and tables along the motion, at some poses of a reach.

    Convex hulls stand for meshes, so that a body may be a little farther away than told. Links of one robot
    count against each other, too. Which pairs are exempt: CellDistances.

    Joints of a payload of several links are where the grasps are stated: its deflections are left out. Shared
    joints are at their references, where they carry the arms of ``seen_by_arms``, and their payload.

    Args:
        scenario: Cell and motion.
        cell_reach: Reachability of the scenario as its arms see it; it is computed when omitted.
        poses: Largest number of poses that are looked at.

    Raises:
        UrdfError, NameNotFoundError, FileReadError: as of ``reachability``.
    """
    seen = seen_by_arms(scenario)
    reach = reachability(seen, poses=poses) if cell_reach is None else cell_reach
    bodies, first = CellDistances(scenario.cell), CellArm(seen.cell, reach.arms[0].arm)
    count = min(len(arm.q) for arm in reach.arms)
    rows = np.unique(np.linspace(0.0, count - 1.0, min(count, poses)).round().astype(int))
    times = reach.arms[0].times[rows]
    configurations = [[arm.q[k] for arm in reach.arms] for k in rows]
    payload, shared = [first.payload_pose(q[0]) for q in configurations], None
    if scenario.cell.carriers:
        shared = [shared_positions(scenario, float(time)) for time in times]
        moved = (displacement(scenario, float(time)) for time in times)
        payload = [D @ X for D, X in zip(moved, payload, strict=True)]
    return measured(scenario, bodies, times, configurations, payload, shared)


def measured(
    scenario: Scenario,
    bodies: CellDistances,
    times: Array,
    arms: Sequence[list[Array]],
    payload: Sequence[Array],
    shared: Sequence[Array] | None = None,
    links: Sequence[Array] | None = None,
) -> Distances:
    """Return the distances of a cell at n instants.

    Args:
        scenario: Scenario, whose cell states the clearance.
        bodies: Distances of its cell.
        times: Times, s, shape (n,).
        arms: Configuration of each arm at each of them.
        payload: X_WP at each of them, shape (4, 4).
        shared: Positions of the shared joints at each of them; their start when omitted.
        links: Positions of the joints of a payload of several links, likewise.
    """
    clearance, closest = scenario.cell.clearance, dict[tuple[str, str], Nearest]()
    least, points = np.full(len(times), np.inf), np.full((len(times), 2, 3), np.nan)
    pairs = [("", "")] * len(times)
    for k, (configurations, X_WP) in enumerate(zip(arms, payload, strict=True)):
        joints = (None if each is None else each[k] for each in (shared, links))
        values = bodies.at(bodies.configuration(configurations, X_WP, *joints))
        if not np.isfinite(values).any():
            continue
        nearest = int(np.argmin(values))
        least[k], pairs[k], points[k] = values[nearest], bodies.pairs[nearest], bodies.points(nearest)
        for number in np.flatnonzero(values <= clearance).tolist():
            pair, value = bodies.pairs[number], float(values[number])
            if pair not in closest or value < closest[pair].distance:
                closest[pair] = Nearest(pair, value, float(times[k]), bodies.points(number))
    below = tuple(sorted(closest.values(), key=lambda each: each.distance))
    exempt, omitted = bodies.exempt, tuple(bodies.omitted)
    return Distances(
        scenario.name, clearance, times, least, tuple(pairs), points, below, exempt, bodies.rules, omitted
    )
