"""Plan of the grasps that all arms know: who bears which part of the load, and how far tips have retreated.

Grasp events move the part of its load share that an arm bears, and the distance of the arm's tip from its
grasp; a table takes the load of all. All are functions of time alone: the agreed plan, whatever becomes of
it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.spatial import internal_wrenches
from coop_pin.base.spatial.internal_wrench import linkage_loads
from coop_pin.control.force_paths.force_path import Split
from coop_pin.description.cell.cell import Cell
from coop_pin.description.events import of_kind
from coop_pin.description.grasp_events import GraspEvent
from coop_pin.reference.quintic import quintic


class GraspPlan(NamedTuple):
    """Agreed plan of the grasps at a time.

    Attributes:
        holds: arms that hold the payload, shape (m,).
        loads: part of its load share that each arm bears, shape (m,).
        shares: load shares c_i, which sum to one while an arm holds, shape (m,).
        retreats: distance of each tip from its grasp along the axis on which it retreats, m, and its two time
            derivatives, shape (m, 3).
        borne: part of the load that the arms bear; tables bear the rest.
        linkage: L_i of ``linkage_loads``, or of ``transmitted_loads`` beside joints, in payload axes, of the
            arms that bear a load, shape (m, 6, 6); None where load shares split it.
    """

    holds: Mask
    loads: Array
    shares: Array
    retreats: Array
    borne: float = 1.0
    linkage: Array | None = None

    def squeeze(self, wrenches: Array) -> Array:
        """Return the internal wrenches that are left of desired ones in payload axes, shape (m, 6).

        With the loads l_i they are l_i f_i - c_i sum_j l_j f_j, or with L_i in place of c_i.
        """
        left = self.loads[:, None] * wrenches
        if self.linkage is None:
            return internal_wrenches(left, self.shares)
        return left - self.linkage.dot(left.sum(axis=0))

    @property
    def carried(self) -> Array:
        """Parts c_i of the load that the arms bear, shape (m,)."""
        return self.borne * self.shares

    @property
    def carried_linkage(self) -> Array | None:
        """Parts L_i likewise, shape (m, 6, 6); None where load shares split it."""
        return None if self.linkage is None else self.borne * self.linkage


def grasp_plan(
    cell: Cell, events: Sequence[Any], time: float, missed: Sequence[GraspEvent] = (), split: Split = "shares"
) -> GraspPlan:
    """Return the plan of events at a time, s; before all of them every arm without a tool holds.

    Args:
        cell: Cell, whose arms bear their load shares at first.
        events: Events of a run; of each arm releases and grasps take turns.
        time: Time, s.
        missed: Those that did not happen. The tip has come back for them, but bears nothing.
        split: Split of the load.
    """
    m = len(cell.arms)
    holds, retreats = np.array([name not in cell.tools for name in cell.arms]), np.zeros((m, 3))
    loads = holds.astype(float)
    at_grasps = of_kind(events, GraspEvent)
    for index, name in enumerate(cell.arms):
        mine = sorted((event for event in at_grasps if event.arm == name), key=lambda event: event.time)
        for event, before in zip(mine, [None, *mine], strict=False):
            if event.time <= time and event not in missed and before not in missed:
                loads[index] = event.load(time)
                holds[index] = event.holds == (event.instant <= time)
        for away, back in itertools.zip_longest(mine[::2], mine[1::2]):
            retreats[index] += _retreat(away, back, time)
    shares = loads * cell.shares
    if shares.any():
        shares = shares / shares.sum()
    borne = min((event.borne(time) for event in events), default=1.0)
    linkage = _linkage(cell, loads) if cell.splits_load or split == "virtual-linkage" else None
    return GraspPlan(holds, loads, shares, retreats, borne, linkage)


def _retreat(away: Any, back: Any, time: float) -> Array:
    """Return s = d a (1 - b) and its rates; quintics a of the retreat, b of the return."""
    a, a1, a2 = quintic(time, away.instant, away.retreat_time)
    if back is None:
        return away.retreat * np.array((a, a1, a2))
    b, b1, b2 = quintic(time, back.time - back.wait - back.approach_time, back.approach_time)
    stays = 1.0 - b
    return away.retreat * np.array((a * stays, a1 * stays - a * b1, a2 * stays - 2.0 * a1 * b1 - a * b2))


def _linkage(cell: Cell, loads: Array) -> Array:
    """Return L_i where each arm bears a part l_i of its load, shape (m, 6, 6).

    ::

        L = sum over sets S of arms  prod_{i in S} l_i  prod_{i not in S} (1 - l_i)  L^S

    with the L^S of the virtual linkage of S alone, or beside joints of what the grasps of S transmit: the L_i
    sum to one, change smoothly with the loads, and are those of the arms that hold where each l_i is 0 or 1.
    Without any load they are zero.
    """
    tips = tuple(grasp.xyz for grasp in cell.grasps.values())
    moving, whole = np.flatnonzero((loads > 0.0) & (loads < 1.0)).tolist(), np.flatnonzero(loads == 1.0)
    L, total = np.zeros((len(tips), 6, 6)), 0.0
    for chosen in itertools.product((False, True), repeat=len(moving)):
        part = np.prod(
            [loads[i] if bears else 1.0 - loads[i] for i, bears in zip(moving, chosen, strict=True)]
        )
        bearing = sorted([*whole.tolist(), *itertools.compress(moving, chosen)])
        if bearing:
            bear = [i in bearing for i in range(len(tips))]
            of_all = (
                cell.loads_within(bear) if cell.splits_load else _linkage_of(tuple(tips[i] for i in bearing))
            )
            L[bearing] += part * of_all
            total += float(part)
    return L / total if total else L


@cache
def _linkage_of(tips: tuple[tuple[float, ...], ...]) -> Array:
    """Return L_i of the virtual linkage of tips on the payload, shape (m, 6, 6); not written to."""
    return linkage_loads(np.array(tips))
