"""Signals of a run as one array: all that changes from tick to tick and does not depend on the plant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.description.network import ArmClock
from coop_pin.description.scenario import Scenario
from coop_pin.reference.pose_reference import PoseReference, PoseTarget
from coop_pin.simulation.tick import TickSignals
from coop_pin.simulation.timeline import Timeline


class Desired(NamedTuple):
    """Desired motion and squeeze at n ticks, or without the first axis at one.

    Attributes:
        time: t_k, s, shape (n,).
        target: desired motion, shape (n, 4, 4), (n, 6) and (n, 6).
        squeeze: f_d of each arm in payload axes, shape (n, m, 6).
    """

    time: Array
    target: PoseTarget
    squeeze: Array


class RunSignals(NamedTuple):
    """Signals of a run at n ticks, or without the first axis at one.

    Attributes:
        desired: desired motion and squeeze.
        drawn: signals of sensors, drives and messages.
        clocked: desired motion of each arm by its own clock, empty where that is exact; empty if all are.
    """

    desired: Desired
    drawn: TickSignals
    clocked: tuple[Desired | tuple[()], ...] = ()


class DesiredSource(NamedTuple):
    """Source of the desired motion and squeeze of a run.

    Attributes:
        scenario: scenario of the run.
        motion: the desired motion.
        timeline: timeline of the run.
    """

    scenario: Scenario
    motion: PoseReference
    timeline: Timeline

    def desired(self, ticks: range, clock: ArmClock | None = None) -> Desired:
        """Return desired motion and squeeze at ticks, or at what a clock shows then.

        Targets are copied one by one: thousands that live at once would be searched for garbage.
        """
        times = list(map(self.timeline.time, ticks))
        times = times if clock is None else list(map(clock.reading, times))
        X, V, A = target = PoseTarget(*(np.empty((len(times), *shape)) for shape in ((4, 4), (6,), (6,))))
        for index, time in enumerate(times):
            X[index], V[index], A[index] = self.motion.at(time)
        return self.squeezed(Desired(np.array(times), target, np.empty(0)))

    def squeezed(self, desired: Desired) -> Desired:
        """Return the same desired motion with the squeeze of the run."""
        squeeze, grasps = self.scenario.squeeze, self.scenario.cell.grasps
        return desired._replace(
            squeeze=np.array([squeeze.at(time, grasps) for time in desired.time.tolist()])
        )

    def clocked(self, ticks: range) -> tuple[Desired | tuple[()], ...]:
        """Return what each arm desires by its own clock at ticks, as in RunSignals."""
        clocks = self.scenario.clocks
        if not clocks:
            return ()
        arms = range(len(self.scenario.cell.arms))
        return tuple(self.desired(ticks, clocks[index]) if index in clocks else () for index in arms)


def columns(signals: RunSignals) -> Array:
    """Return signals as one array, in the order of the leaves of those of a tick, shape (n, entries)."""
    parts = list[Array]()
    _mapped(parts.append, signals)
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)


def first_of(signals: RunSignals) -> RunSignals:
    """Return the signals of the first tick."""
    return _mapped(lambda part: part[0], signals)


def _mapped(function: Callable[[Any], Any], tree: Any) -> Any:
    """Return a tree of tuples with a function applied to each of its arrays."""
    if not isinstance(tree, tuple):
        return function(tree)
    parts = [_mapped(function, part) for part in tree]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
