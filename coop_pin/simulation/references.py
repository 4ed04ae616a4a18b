"""References of the arms of a run: motion and squeeze, by the plan of the grasps and by own clocks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeAlias

from coop_pin.base.arrays import Array, frozen
from coop_pin.base.spatial.task_rows import TaskRows
from coop_pin.control import ArmReference
from coop_pin.description.cell.grasp_plan import GraspPlan
from coop_pin.description.grasp_events import MissedGrasp
from coop_pin.description.scenario import Scenario
from coop_pin.reference.pose_reference import PoseReference, PoseTarget, retreated
from coop_pin.reference.squeeze import SqueezeReference
from coop_pin.simulation.timeline import Timeline

Wanted: TypeAlias = tuple[list[ArmReference], PoseTarget, Array, GraspPlan | None]
"""Reference of each arm, desired motion of the payload, desired internal wrench of each arm about P in
payload axes, N and N m, shape (m, 6), and the plan of the grasps, if they have events."""


class References:
    """References of the arms of a run at any time.

    Attributes:
        clocks: clocks of arms that are off, by the index of the arm.
    """

    def __init__(self, scenario: Scenario, timeline: Timeline) -> None:
        """Take clocks, grasps and their events from a scenario and its timeline."""
        self._scenario, self._timeline, self._rows = scenario, timeline, scenario.cell.task_rows
        self.clocks, self._has_plan = scenario.clocks, scenario.has_grasp_plan

    def at(
        self, time: float, motion: PoseReference, squeeze: SqueezeReference, missed: Sequence[MissedGrasp]
    ) -> Wanted:
        """Return what the cell is to do at a time, s; arms whose clocks are off follow what these show.

        Args:
            time: Time, s.
            motion: Desired motion.
            squeeze: Desired internal wrenches.
            missed: Grasps that did not happen.
        """
        desired = self._exact(time, motion, squeeze, missed)
        for index, clock in self.clocks.items():
            shown, *_ = self._exact(clock.reading(time), motion, squeeze, missed)
            desired[0][index] = shown[index]
        return desired

    def _exact(
        self, time: float, motion: PoseReference, squeeze: SqueezeReference, missed: Sequence[MissedGrasp]
    ) -> Wanted:
        """Return what the cell is to do if all clocks show the time."""
        cell, target = self._scenario.cell, motion.at(time)
        wrenches, references = squeeze.at(time, cell.grasps), list[ArmReference]()
        if not self._has_plan:
            return arm_references(self._rows, target, wrenches), target, wrenches, None
        just_after, events = self._timeline.just_after(time), [each.event for each in missed]
        plan = self._scenario.grasp_plan_at(just_after, events)
        wrenches = plan.squeeze(wrenches)
        arms = zip(cell.grasps, plan.carried.tolist(), plan.retreats, strict=True)
        for index, (name, share, retreat) in enumerate(arms):
            moved = retreated(target, cell.way_out(name), retreat)
            (reference,) = arm_references(self._rows, moved, wrenches[index : index + 1])
            references.append(reference._replace(load_share=share))
        return references, target, wrenches, plan


def arm_references(rows: TaskRows, target: PoseTarget, squeeze: Iterable[Array]) -> list[ArmReference]:
    """Return the reference of each arm.

    Args:
        rows: Task rows of the cell.
        target: Desired motion of the payload.
        squeeze: Desired internal wrench of each arm about P in payload axes, shape (6,) each.
    """
    X, V, A = target
    pose, twist, acceleration = frozen(X), frozen(rows.select(V)), frozen(rows.select(A))
    return [ArmReference(pose, twist, acceleration, frozen(rows.select(wrench))) for wrench in squeeze]
