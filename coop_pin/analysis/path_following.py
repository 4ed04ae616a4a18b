"""What an arm meets on its way along a route."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.analysis.arm_reach import FastestJoint, JointLimitMargin, NearlySingular, Unreachable
from coop_pin.arrays import Array, frozen
from coop_pin.chain.ik_solver import IKSolution, IKSolver
from coop_pin.chain.inverse_kinematics import configuration_near, solve_ik
from coop_pin.description.scenario import Scenario
from coop_pin.errors import UnreachablePoseError
from coop_pin.model.arm_model import ArmModel

_APPROACH = 21


class Route(NamedTuple):
    """The payload's way from the start of a scenario to the beginning of its reference, and along it.

    Attributes:
        times: s, shape (n,); 0 for all poses on the way to the reference.
        poses: X_WP, shape (n, 4, 4).
        twists: V_WP_d, shape (n, 6); zero on the way to the reference.
    """

    times: Array
    poses: Array
    twists: Array


def route_of(scenario: Scenario, poses: int) -> Route:
    """Return the route of a scenario: straight to the reference, then along it through poses evenly spaced in time."""
    reference = scenario.motion.replace()
    times = np.linspace(0.0, scenario.duration, poses)
    targets = [reference.at(float(time)) for time in times]
    start, begin = pin.SE3(scenario.start.matrix), pin.SE3(np.array(targets[0].X_WP_d))
    approach = [
        pin.SE3.Interpolate(start, begin, float(part)).homogeneous
        for part in np.linspace(0.0, 1.0, _APPROACH)[:-1]
    ]
    return Route(
        frozen(np.concatenate((np.zeros(len(approach)), times))),
        frozen(np.stack((*approach, *(target.X_WP_d for target in targets)))),
        frozen(np.concatenate((np.zeros((len(approach), 6)), [target.V_WP_d for target in targets]))),
    )


_LONGEST_STEP = 0.2
_HALVINGS = 6
_STEPS = 40
_SLIDES = 2
_ANGLE_WEIGHT = 1e-3


def follow(search: IKSolver, poses: Sequence[Array], q: Array, near: Array) -> list[IKSolution]:
    """Return where an arm stands at every pose of a path, carried on from pose to pose.

    Limits are not looked at: no law avoids them. Where a pose is out of reach, the arm takes the angles that
    come nearest, least distance first, and carries on from there. A redundant arm is drawn towards a posture,
    as its law's spring would draw it.

    Args:
        search: the arm.
        poses: payload poses X_WP, each shape (4, 4), a short way from one to the next.
        q: angles that hold the first, shape (nq,).
        near: the posture, shape (nq,).
    """
    landings: list[IKSolution] = []
    last, halvings = search.grasp(poses[0]), _HALVINGS
    for X_WP in poses:
        target = search.grasp(X_WP)
        landing = step_to(search, last, target, q, halvings)
        if landing.is_closed and search.is_redundant:
            landing = landing._replace(q=search.slide(target, landing.q, near, limited=False, steps=_SLIDES))
        landings.append(landing)
        last, q, halvings = target, landing.q, _HALVINGS if landing.is_closed else 0
    return landings


def step_to(
    search: IKSolver, last: pin.SE3, target: pin.SE3, q: Array, halvings: int = _HALVINGS
) -> IKSolution:
    """Return where an arm stands after a step of its grasp, halved until no joint moves far in one go.

    Args:
        search: the arm.
        last: where its grasp was.
        target: where it is now.
        q: where the arm stood, shape (nq,).
        halvings: of the step, at most.
    """
    landing = search.descend(target, q, limited=False, steps=_STEPS)
    moved = float(np.abs(pin.difference(search.model, q, landing.q)).max())
    if landing.is_closed and moved < _LONGEST_STEP:
        return landing
    if halvings:
        middle = pin.SE3.Interpolate(last, target, 0.5)
        halfway = step_to(search, last, middle, q, halvings - 1)
        if halfway.is_closed:
            return step_to(search, middle, target, halfway.q, halvings - 1)
    return (
        landing
        if landing.is_closed
        else search.descend(target, q, limited=False, angle_weight=_ANGLE_WEIGHT, steps=_STEPS)
    )


_BISECTIONS = 20


class ArmWalk:
    """One arm on its way along a route.

    Attributes:
        q: where it stands, shape (n, nq).
        sigma_min: smallest singular value of its payload Jacobian in task rows and drive coordinates, shape
            (n,).
        condition: its condition number, shape (n,).
    """

    def __init__(self, scenario: Scenario, name: str, model: ArmModel, route: Route, q: Array) -> None:
        """Walk.

        Args:
            scenario: the arm's.
            name: the arm.
            model: its model, with its grasp.
            route: where the payload goes.
            q: angles that hold it at the first pose, shape (nq,).
        """
        self._name, self._model, self._route, self._search = name, model, route, IKSolver(model)
        posture = scenario.cell.arms[name].posture
        self._near = q if posture is None else configuration_near(name, model, posture)
        self._landings = follow(self._search, list(route.poses), q, self._near)
        self.q = frozen(np.stack([landing.q for landing in self._landings]))
        self._held = np.array([landing.is_closed for landing in self._landings])
        rows, from_drive = scenario.cell.task_rows, np.linalg.inv(model.drive)
        self._jacobians = np.stack([rows.select(model.payload_jacobian(q)) @ from_drive for q in self.q])
        sigma = np.zeros((len(self.q), rows.size))
        sigma[:, : model.nv] = np.linalg.svd(self._jacobians, compute_uv=False)
        self.sigma_min = frozen(sigma[:, -1])
        with np.errstate(divide="ignore"):
            self.condition = frozen(sigma[:, 0] / sigma[:, -1])
        drive_rates = [
            np.linalg.pinv(J) @ rows.select(V) for J, V in zip(self._jacobians, route.twists, strict=True)
        ]
        self._rates = np.stack(drive_rates) @ from_drive.T

    def loss(self) -> Unreachable | None:
        """Return when the arm first cannot follow, to a millionth of the spacing, and the gap where it is farthest away."""
        if self._held.all():
            return None
        worst = max(
            range(len(self._landings)),
            key=lambda index: (self._landings[index].distance, self._landings[index].angle),
        )
        gap_m, gap_rad, other_branch = self._landings[worst].distance, self._landings[worst].angle, True
        try:
            solve_ik(self._name, self._model, self._route.poses[worst], self._near)
        except UnreachablePoseError as error:
            gap_m, gap_rad, other_branch = error.gap_m, error.gap_rad, False
        time = self._last_held(int(np.argmin(self._held)))
        return Unreachable(time, float(self._route.times[worst]), gap_m, gap_rad, other_branch)

    def _last_held(self, first: int) -> float:
        """Return the last time before a pose out of reach at which the arm still holds, by bisection."""
        before, after = (self._search.grasp(self._route.poses[index]) for index in (first - 1, first))
        held, lost, q = 0.0, 1.0, self.q[first - 1]
        for _ in range(_BISECTIONS):
            part = (held + lost) / 2.0
            landing = step_to(self._search, before, pin.SE3.Interpolate(before, after, part), q)
            held, lost = (part, lost) if landing.is_closed else (held, part)
        return self._between(first - 1, held)

    def singular(self) -> NearlySingular:
        """Return where the smallest singular value is smallest; a determinant that changes sign passed zero on the way."""
        if self._jacobians.shape[1] == self._jacobians.shape[2]:
            signs = np.sign(np.linalg.det(self._jacobians))
            turned = np.flatnonzero((signs[1:] != signs[:-1]) & self._held[1:] & self._held[:-1])
            if turned.size:
                return NearlySingular(self._between(int(turned[0]), 0.5), 0.0, float("inf"))
        index = int(np.argmin(np.where(self._held, self.sigma_min, np.inf)))
        return NearlySingular(
            float(self._route.times[index]), float(self.sigma_min[index]), float(self.condition[index])
        )

    def crossing(self) -> JointLimitMargin | None:
        """Return the first joint that leaves its position limits, with the time interpolated between two poses."""
        ranges = self._search.ranges
        beyond = np.stack([ranges.beyond(q) for q in self.q]) * self._held[:, None]
        outside = np.flatnonzero(beyond.any(axis=1))
        if not outside.size:
            return None
        index = int(outside[0])
        joint = int(np.abs(beyond[index]).argmax())
        limit = float(ranges.upper[joint] if beyond[index, joint] > 0.0 else ranges.lower[joint])
        before, after = (float(ranges.values(self.q[i])[joint]) for i in (max(index - 1, 0), index))
        part = (limit - before) / (after - before) if after != before else 0.0
        return self._limit(joint, self._between(max(index - 1, 0), part), limit)

    def closest(self) -> JointLimitMargin | None:
        """Return the joint with the smallest margin to a position limit, where it is smallest."""
        ranges = self._search.ranges
        values = np.stack([ranges.values(q) for q in self.q])
        margins = np.where(
            self._held[:, None], np.minimum(values - ranges.lower, ranges.upper - values), np.inf
        )
        index, joint = np.unravel_index(int(margins.argmin()), margins.shape)
        if not np.isfinite(margins[index, joint]):
            return None
        return self._limit(int(joint), float(self._route.times[index]), float(values[index, joint]))

    def _limit(self, joint: int, time: float, value: float) -> JointLimitMargin:
        ranges = self._search.ranges
        return JointLimitMargin(
            ranges.names[joint],
            time,
            value,
            float(ranges.lower[joint]),
            float(ranges.upper[joint]),
            ranges.units[joint],
        )

    def fastest(self) -> FastestJoint | None:
        """Return the joint with the largest speed by its limit; of a redundant arm, at the least rates J^+ V_WP."""
        limits = np.array(self._search.model.velocityLimit)
        limited = np.isfinite(limits) & (limits > 0.0)
        if not limited.any():
            return None
        parts = np.abs(self._rates) / np.where(limited, limits, np.inf) * self._held[:, None]
        index, joint = (int(entry) for entry in np.unravel_index(int(parts.argmax()), parts.shape))
        ranges = self._search.ranges
        time, speed = float(self._route.times[index]), float(abs(self._rates[index, joint]))
        return FastestJoint(
            ranges.names[joint], time, speed, float(limits[joint]), f"{ranges.units[joint]}/s"
        )

    def _between(self, index: int, part: float) -> float:
        """Return the time a part of the way from one pose to the next, s."""
        before, after = self._route.times[index : index + 2]
        return float(before + part * (after - before))
