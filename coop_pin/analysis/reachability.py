"""Before a run: can the arms follow the whole reference, and how close do they come to what they must not reach?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coop_pin.analysis.arm_reach import ArmReach
from coop_pin.analysis.path_following import ArmWalk, Route, route_of
from coop_pin.arrays import frozen
from coop_pin.chain.inverse_kinematics import solve_ik
from coop_pin.description.scenario import Scenario
from coop_pin.errors import ArgumentError, UnreachablePoseError
from coop_pin.model.arm_model import ArmModel


@dataclass(frozen=True, eq=False)
class Reachability:
    """Whether the arms of a scenario can follow its reference.

    Attributes:
        scenario: its name.
        duration: s.
        poses: how many poses of the reference were looked at.
        arms: what is known of every arm.
    """

    scenario: str
    duration: float
    poses: int
    arms: tuple[ArmReach, ...]

    @property
    def ok(self) -> bool:
        """Whether every arm can follow within its position and velocity limits and away from singular poses."""
        return all(arm.ok for arm in self.arms)

    def text(self) -> str:
        """Return the findings for people, some lines for each arm."""
        verdict = "every arm can follow" if self.ok else "not every arm can follow"
        lines = [
            f"{self.scenario}: {verdict} ({self.poses} poses of the reference, 0 to {self.duration:g} s)"
        ]
        for arm in self.arms:
            lines.append(f"  {arm.arm}: {'ok' if arm.ok else 'not ok'}")
            lines += [f"    ! {problem}" for problem in arm.problems()]
            lines += [f"    {number}" for number in arm.numbers()]
        return "\n".join(lines)


def reachability(scenario: Scenario, poses: int = 401) -> Reachability:
    """Follow the reference of a scenario with the arms' kinematics alone, from the start on the branches a run would take.

    The path leads from the scenario's start straight to where the reference begins, and then along the
    reference. Gains, friction, torques and collisions play no part.

    Args:
        scenario: what would be run.
        poses: how many poses of the reference to look at, evenly spaced in time; what is shorter than the
            spacing is not seen.

    Raises:
        ArgumentError: fewer than two poses.
        UrdfError, NameNotFoundError, FileReadError: an arm or the motion cannot be
            built.
    """
    if poses < 2:
        raise ArgumentError(f"poses is {poses}; it must be at least 2")
    route = route_of(scenario, poses)
    arms = tuple(_arm_reach(scenario, name, route) for name in scenario.cell.arms)
    return Reachability(scenario.name, scenario.duration, poses, arms)


def _arm_reach(scenario: Scenario, name: str, route: Route) -> ArmReach:
    """Return what is known of one arm."""
    arm = scenario.cell.arms[name]
    model = ArmModel(arm, scenario.cell.grasps[name].matrix)
    try:
        q = solve_ik(name, model, route.poses[0], arm.posture)
    except UnreachablePoseError as error:
        nothing = frozen(np.zeros(0))
        return ArmReach(name, nothing, frozen(np.zeros((0, model.nq))), nothing, nothing, refusal=error)
    walk = ArmWalk(scenario, name, model, route, q)
    return ArmReach(
        name,
        route.times,
        walk.q,
        walk.sigma_min,
        walk.condition,
        loss=walk.loss(),
        singular=walk.singular(),
        crossing=walk.crossing(),
        closest=walk.closest(),
        fastest=walk.fastest(),
    )
