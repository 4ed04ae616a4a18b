"""Before a run: can the arms follow the whole reference, and how close do they come to what they must not reach?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coop_pin.analysis.arm_reach import ArmReach, FastestJoint, LimitApproach, NearlySingular, ReachLoss
from coop_pin.analysis.arm_walk import follow, step_to
from coop_pin.arrays import Array, frozen
from coop_pin.chain.closing import closing_angles, configuration_near
from coop_pin.chain.landing import Landing
from coop_pin.chain.tip_search import TipSearch
from coop_pin.description.scenario import Scenario
from coop_pin.errors import ArgumentError, UnreachablePoseError
from coop_pin.model.arm_model import ArmModel

_APPROACH = 21
_BISECTIONS = 20


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
        lines = [f"{self.scenario}: {verdict} ({self.poses} poses of the reference, 0 to {self.duration:g} s)"]
        for arm in self.arms:
            lines.append(f"  {arm.arm}: {'ok' if arm.ok else 'not ok'}")
            lines += [f"    ! {problem}" for problem in arm.problems()]
            lines += [f"    {number}" for number in arm.numbers()]
        return "\n".join(lines)


def reachability(scenario: Scenario, poses: int = 401) -> Reachability:
    """Follow the reference of a scenario with the arms' kinematics alone, from the start on the branches a run would take.

    The path leads from the scenario's start straight to where the reference begins, and then along the reference. Gains,
    friction, torques and collisions play no part.

    Args:
        scenario: what would be run.
        poses: how many poses of the reference to look at, evenly spaced in time; what is shorter than the spacing is not seen.

    Raises:
        ArgumentError: fewer than two poses.
        UrdfError, FrameNotFoundError, ReferenceFileError, EntryNotFoundError: an arm or the motion cannot be built.
    """
    if poses < 2:
        raise ArgumentError(f"poses is {poses}; it must be at least 2")
    route = _route(scenario, poses)
    arms = tuple(_arm_reach(scenario, name, route) for name in scenario.cell.arms)
    return Reachability(scenario.name, scenario.duration, poses, arms)


@dataclass(frozen=True, eq=False)
class _Route:
    """Poses X_WP, shape (n, 4, 4), and twists V_WP, shape (n, 6), at times, shape (n,)."""

    times: Array
    poses: Array
    twists: Array


def _route(scenario: Scenario, poses: int) -> _Route:
    reference = scenario.motion.build()
    times = np.linspace(0.0, scenario.duration, poses)
    targets = [reference.at(float(time)) for time in times]
    start, begin = pin.SE3(scenario.start.matrix), pin.SE3(np.array(targets[0].X_WP_d))
    approach = [pin.SE3.Interpolate(start, begin, float(part)).homogeneous for part in np.linspace(0.0, 1.0, _APPROACH)[:-1]]
    return _Route(
        frozen(np.concatenate((np.zeros(len(approach)), times))),
        np.stack((*approach, *(target.X_WP_d for target in targets))),
        np.concatenate((np.zeros((len(approach), 6)), [target.V_WP_d for target in targets])),
    )


def _arm_reach(scenario: Scenario, name: str, route: _Route) -> ArmReach:
    """Return what is known of one arm."""
    arm = scenario.cell.arms[name]
    model = ArmModel(arm, scenario.cell.grasps[name].matrix)
    try:
        q = closing_angles(name, model, route.poses[0], arm.posture)
    except UnreachablePoseError as error:
        nothing = frozen(np.zeros(0))
        return ArmReach(name, nothing, frozen(np.zeros((0, model.nq))), nothing, nothing, refusal=error)
    walk = _Walk(scenario, name, model, route, q)
    return ArmReach(
        name,
        route.times,
        frozen(walk.q),
        frozen(walk.sigma[:, -1]),
        frozen(walk.condition),
        loss=walk.loss(),
        singular=walk.singular(),
        crossing=walk.crossing(),
        closest=walk.closest(),
        fastest=walk.fastest(),
    )


class _Walk:
    """One arm on its way along a route."""

    def __init__(self, scenario: Scenario, name: str, model: ArmModel, route: _Route, q: Array) -> None:
        self.route, self.search = route, TipSearch(model)
        near = q if scenario.cell.arms[name].posture is None else configuration_near(name, model, scenario.cell.arms[name].posture)
        self.landings: list[Landing] = follow(self.search, list(route.poses), q, near)
        self.q = np.stack([landing.q for landing in self.landings])
        self.held = np.array([landing.is_closed for landing in self.landings])
        rows, from_drive = scenario.cell.task_rows, np.linalg.inv(model.drive)
        self.jacobians = np.stack([rows.select(model.payload_jacobian(q)) @ from_drive for q in self.q])
        self.sigma = np.linalg.svd(self.jacobians, compute_uv=False)
        with np.errstate(divide="ignore"):
            self.condition = self.sigma[:, 0] / self.sigma[:, -1]
        twists = np.stack([rows.select(twist) for twist in route.twists])
        drive_rates = np.stack([np.linalg.pinv(J) @ V for J, V in zip(self.jacobians, twists, strict=True)])
        self.rates = drive_rates @ from_drive.T

    def loss(self) -> ReachLoss | None:
        """Return when the arm first cannot follow, to a millionth of the spacing, and its largest gap."""
        if self.held.all():
            return None
        first = int(np.argmin(self.held))
        worst = max(range(len(self.landings)), key=lambda index: (self.landings[index].distance, self.landings[index].angle))
        landing = self.landings[worst]
        return ReachLoss(self._last_held(first), float(self.route.times[worst]), landing.distance, landing.angle)

    def _last_held(self, first: int) -> float:
        """Return the last time before a pose out of reach at which the arm still holds, by bisection."""
        before, after = (self.search.grasp(self.route.poses[index]) for index in (first - 1, first))
        held, lost, q = 0.0, 1.0, self.q[first - 1]
        for _ in range(_BISECTIONS):
            part = (held + lost) / 2.0
            landing = step_to(self.search, before, pin.SE3.Interpolate(before, after, part), q)
            held, lost = (part, lost) if landing.is_closed else (held, part)
        return self._between(first - 1, held)

    def singular(self) -> NearlySingular:
        """Return where the smallest singular value is smallest; a determinant that changes sign passed zero on the way."""
        if self.jacobians.shape[1] == self.jacobians.shape[2]:
            signs = np.sign(np.linalg.det(self.jacobians))
            turned = np.flatnonzero((signs[1:] != signs[:-1]) & self.held[1:] & self.held[:-1])
            if turned.size:
                return NearlySingular(self._between(int(turned[0]), 0.5), 0.0, float("inf"))
        index = int(np.argmin(np.where(self.held, self.sigma[:, -1], np.inf)))
        return NearlySingular(float(self.route.times[index]), float(self.sigma[index, -1]), float(self.condition[index]))

    def crossing(self) -> LimitApproach | None:
        """Return the first joint that leaves its position limits, with the time interpolated between two poses."""
        ranges = self.search.ranges
        beyond = np.stack([ranges.beyond(q) for q in self.q]) * self.held[:, None]
        outside = np.flatnonzero(beyond.any(axis=1))
        if not outside.size:
            return None
        index = int(outside[0])
        joint = int(np.abs(beyond[index]).argmax())
        limit = float(ranges.upper[joint] if beyond[index, joint] > 0.0 else ranges.lower[joint])
        before, after = (float(ranges.values(self.q[i])[joint]) for i in (max(index - 1, 0), index))
        part = (limit - before) / (after - before) if after != before else 0.0
        return self._limit(joint, self._between(max(index - 1, 0), part), limit)

    def closest(self) -> LimitApproach | None:
        """Return the joint with the smallest margin to a position limit, where it is smallest."""
        ranges = self.search.ranges
        values = np.stack([ranges.values(q) for q in self.q])
        margins = np.where(self.held[:, None], np.minimum(values - ranges.lower, ranges.upper - values), np.inf)
        index, joint = np.unravel_index(int(margins.argmin()), margins.shape)
        if not np.isfinite(margins[index, joint]):
            return None
        return self._limit(int(joint), float(self.route.times[index]), float(values[index, joint]))

    def _limit(self, joint: int, time: float, value: float) -> LimitApproach:
        ranges = self.search.ranges
        return LimitApproach(ranges.names[joint], time, value, float(ranges.lower[joint]), float(ranges.upper[joint]), ranges.units[joint])

    def fastest(self) -> FastestJoint | None:
        """Return the joint with the largest speed by its limit; of a redundant arm, at the least rates J^+ V_WP."""
        limits = np.array(self.search.model.velocityLimit)
        limited = np.isfinite(limits) & (limits > 0.0)
        if not limited.any():
            return None
        parts = np.abs(self.rates) / np.where(limited, limits, np.inf) * self.held[:, None]
        index, joint = (int(entry) for entry in np.unravel_index(int(parts.argmax()), parts.shape))
        ranges = self.search.ranges
        time, speed = float(self.route.times[index]), float(abs(self.rates[index, joint]))
        return FastestJoint(ranges.names[joint], time, speed, float(limits[joint]), f"{ranges.units[joint]}/s")

    def _between(self, index: int, part: float) -> float:
        """Return the time a part of the way from one pose to the next, s."""
        before, after = self.route.times[index : index + 2]
        return float(before + part * (after - before))
