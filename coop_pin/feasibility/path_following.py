"""Path of the payload to a reference and along it, and an arm that follows it: reach, limits, speeds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, frozen
from coop_pin.base.bisection import edge
from coop_pin.base.errors import UnreachablePoseError
from coop_pin.base.spatial import FullRows
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.ik_solver import IKSolver
from coop_pin.model.inverse_kinematics import solve_ik

_APPROACH_POSES = 20
_TURN_STEPS, _CLOSED = 30, 1e-9
"""Largest number of Newton steps from pose to pose, and the error that they leave, m or rad."""
_PROBES, _RESTING = 401, 0.1
"""Times at which a reference is looked at, and how dense poses are where it rests."""
_ROUND_OFF = 1e-6
"""Singular values below this part of the largest are redundant rows."""


class PayloadPath(NamedTuple):
    """Path of the payload from the start of a scenario to the beginning of its reference, and along it.

    Attributes:
        times: s, shape (n,); 0 for all poses before the reference.
        poses: X_WP, shape (n, 4, 4).
        twists: V_WP_d, shape (n, 6); zero before the reference.
    """

    times: Array
    poses: Array
    twists: Array


def payload_path(scenario: Scenario, poses: int, arm: str = "") -> PayloadPath:
    """Return the path that an arm sees: straight to the reference, then along it, denser where it moves."""
    reference = scenario.payload_motion  # reads a CSV table again
    times = _pose_times(scenario, poses)
    targets = [scenario.cell.target_of(arm, reference.at(time), time) for time in times.tolist()]
    start, begin = pin.SE3(scenario.start.matrix), pin.SE3(np.array(targets[0].X_WP_d))
    approach = [
        pin.SE3.Interpolate(start, begin, float(part)).homogeneous
        for part in np.linspace(0.0, 1.0, _APPROACH_POSES + 1)[:-1]
    ]
    return PayloadPath(
        frozen(np.concatenate((np.zeros(len(approach)), times))),
        frozen(np.stack((*approach, *(target.X_WP_d for target in targets)))),
        frozen(np.concatenate((np.zeros((len(approach), 6)), [target.V_WP_d for target in targets]))),
    )


def _pose_times(scenario: Scenario, poses: int) -> Array:
    """Return times of poses, s: evenly spaced, a tenth as dense where the reference rests."""
    probes, moves = _moving(scenario)
    if np.all(moves):
        return np.linspace(0.0, scenario.duration, poses)
    passed = np.concatenate(([0.0], np.cumsum(np.where(moves, 1.0, _RESTING))))
    return np.interp(np.linspace(0.0, passed[-1], poses), passed, probes)


def time_at_rest(scenario: Scenario) -> float:
    """Return the time from which on the reference rests, s; the duration if it never does."""
    probes, moves = _moving(scenario)
    return float(probes[1:][moves].max(initial=0.0))


def _moving(scenario: Scenario) -> tuple[Array, Array]:
    """Return probed times, s, and whether the reference moves in the intervals between them."""
    motion, probes = scenario.payload_motion, np.linspace(0.0, scenario.duration, _PROBES)
    targets, seen_by = [(motion.at(time), time) for time in probes.tolist()], scenario.cell.target_of
    seen = [[seen_by(arm, at, t).X_WP_d for arm in ("", *scenario.cell.tools)] for at, t in targets]
    return probes, np.abs(np.diff(np.array(seen), axis=0)).max(axis=(1, 2, 3)) > 0.0


def with_free_turn(scenario: Scenario, path: PayloadPath) -> PayloadPath:
    """Return a path of a cell on positional rows with the orientations that its closed chain takes.

    Nothing controls them: from pose to pose the joints of all arms move as little as position and closures
    allow. Springs and dampers of a posture are not considered. From a position on that the chain cannot take,
    the orientations are those of the reference, and at the start those of the start.
    """
    chain = CellChain(scenario.cell if scenario.cell.tools else scenario.cell.rigid)
    model, closures = chain.mechanism.model, chain.mechanism.closures
    try:
        q = chain.configuration(path.poses[0])
    except UnreachablePoseError:
        return path
    poses = path.poses.copy()
    for X_WP in poses[1:]:
        for _ in range(_TURN_STEPS):
            state = closures.state(q, np.zeros(model.nv))
            error = np.concatenate((state.position, chain.payload_pose(q)[:3, 3] - X_WP[:3, 3]))
            if np.abs(error).max() < _CLOSED:
                break
            J = np.concatenate((state.jacobian, chain.payload_jacobian(q)[:3]))
            q = pin.integrate(model, q, -np.linalg.pinv(J, rcond=_ROUND_OFF) @ error)
        else:
            break
        X_WP[:3, :3] = chain.payload_pose(q)[:3, :3]
    return path._replace(poses=frozen(poses))


_PART_ERROR = 2.0**-20
"""Accuracy of the edge of the reach between two poses, as a part of the way."""


class Unreachable(NamedTuple):
    """Part of the path that is out of an arm's reach.

    Attributes:
        time: time from which the arm cannot follow, s.
        gap_time: time of the largest gap, s.
        gap_m: the least distance between tip and grasp then.
        gap_rad: the angle between them at that distance.
        other_branch: the pose is reachable, but not on the branch of the path; then the gap is that of its
            branch.
    """

    time: float
    gap_time: float
    gap_m: float
    gap_rad: float
    other_branch: bool


class NearlySingular(NamedTuple):
    """Pose of an arm closest to a singular one.

    Attributes:
        time: s.
        sigma_min: smallest singular value of the payload Jacobian; 0 if the path leads through a singular
            pose.
        condition: largest over smallest singular value.
    """

    time: float
    sigma_min: float
    condition: float


class JointLimitMargin(NamedTuple):
    """Joint near or beyond a position limit.

    Attributes:
        joint: joint name.
        time: s.
        value: joint position, rad or m.
        lower: lower limit.
        upper: upper limit.
        unit: "rad" or "m".
    """

    joint: str
    time: float
    value: float
    lower: float
    upper: float
    unit: str

    @property
    def margin(self) -> float:
        """Distance to the nearer limit, rad or m; negative beyond it."""
        return min(self.value - self.lower, self.upper - self.value)


class FastestJoint(NamedTuple):
    """Joint that comes closest to its velocity limit, or exceeds it most.

    Attributes:
        joint: joint name.
        time: s.
        speed: rad/s or m/s.
        limit: limit of the speed.
        unit: "rad/s" or "m/s".
    """

    joint: str
    time: float
    speed: float
    limit: float
    unit: str


class PathFollowing:
    """One arm following a payload path by inverse kinematics, without regard to joint limits.

    Attributes:
        q: configurations, shape (n, nq).
        sigma_min: smallest singular value of the payload Jacobian in task rows and drive coordinates, shape
            (n,).
        condition: condition number of it, shape (n,).
    """

    def __init__(self, model: CellArm, path: PayloadPath, q: Array) -> None:
        """Follow the path.

        Args:
            model: The arm, with its grasp.
            path: Path of the payload.
            q: Configuration that holds it at the first pose, shape (nq,).
        """
        self._model, self._path, self._solver = model, path, IKSolver(model)
        posture = model.description.posture
        self._near = q if posture is None else model.posture(posture)
        self._solutions = self._solver.follow(list(path.poses), q, self._near)
        self.q = frozen(np.stack([solution.q for solution in self._solutions]))
        self._reached = np.array([solution.is_closed for solution in self._solutions])
        rows = model.rows
        self._jacobians = np.stack([model.task_jacobian(q) for q in self.q])
        shape = self._jacobians.shape  # beside a joint with too few joints the motion decides
        sigma = np.zeros((len(self.q), shape[1] if model.grasp_rows is None else min(shape[1:])))
        sigma[:, : model.nv] = np.linalg.svd(self._jacobians, compute_uv=False)
        self.sigma_min = frozen(sigma[:, -1])
        with np.errstate(divide="ignore"):
            self.condition = frozen(sigma[:, 0] / sigma[:, -1])
        V = np.stack([rows.select(twist) for twist in path.twists])
        if (grasp := model.grasp_rows) is not None:  # with the payload as desired
            about = [X[:3, :3] @ grasp.X_PC[:3, 3] for X in path.poses]
            turned = [np.kron(np.eye(2), (model.payload_pose(q) @ grasp.X_PC)[:3, :3].T) for q in self.q]
            moved = [FullRows().twist_shift(r) @ twist for r, twist in zip(about, path.twists, strict=True)]
            V = np.stack([grasp.select(R @ twist) for R, twist in zip(turned, moved, strict=True)])
        drive_rates = np.linalg.pinv(self._jacobians) @ V[..., None]
        self._rates = drive_rates[..., 0] @ model.from_drive.T

    def unreachable(self) -> Unreachable | None:
        """Return when the arm first cannot follow, to a millionth of the spacing, and the largest gap."""
        if self._reached.all():
            return None
        gaps = [(solution.distance, solution.angle) for solution in self._solutions]
        worst = max(range(len(gaps)), key=gaps.__getitem__)
        (gap_m, gap_rad), other_branch = gaps[worst], True
        try:
            solve_ik(self._model, self._path.poses[worst], posture=self._near)
        except UnreachablePoseError as error:
            gap_m, gap_rad, other_branch = error.distance, error.angle, False
        time = self._last_reached(int(np.argmin(self._reached)))
        return Unreachable(time, float(self._path.times[worst]), gap_m, gap_rad, other_branch)

    def _last_reached(self, first: int) -> float:
        """Return the last time before an unreachable pose at which the arm still follows, by bisection, s."""
        before, after = (self._solver.tip_target(self._path.poses[index]) for index in (first - 1, first))

        def is_reached(part: float) -> bool:
            target = pin.SE3.Interpolate(before, after, part)
            return self._solver.follow_step(before, target, self.q[first - 1]).is_closed

        return self._time_between(first - 1, edge(is_reached, 0.0, 1.0, _PART_ERROR))

    def nearest_singularity(self) -> NearlySingular | None:
        """Return the pose of the smallest singular value; it is zero if the determinant changes its sign.

        None for an arm with fewer joints than task rows.
        """
        if self._jacobians.shape[2] < self._jacobians.shape[1]:
            return None
        if self._jacobians.shape[1] == self._jacobians.shape[2]:
            signs = np.sign(np.linalg.det(self._jacobians))
            changed = np.flatnonzero((signs[1:] != signs[:-1]) & self._reached[1:] & self._reached[:-1])
            if changed.size:
                return NearlySingular(self._time_between(int(changed[0]), 0.5), 0.0, float("inf"))
        index = int(np.argmin(np.where(self._reached, self.sigma_min, np.inf)))
        values = (self._path.times, self.sigma_min, self.condition)
        return NearlySingular(*(float(value[index]) for value in values))

    def limit_violation(self) -> JointLimitMargin | None:
        """Return the first joint that exceeds its position limits; its time is interpolated."""
        limits = self._solver.limits
        violation = np.stack([limits.violation(q) for q in self.q]) * self._reached[:, None]
        outside = np.flatnonzero(violation.any(axis=1))
        if not outside.size:
            return None
        index = int(outside[0])
        joint = int(np.abs(violation[index]).argmax())
        limit = float((limits.upper if violation[index, joint] > 0.0 else limits.lower)[joint])
        before, after = (float(limits.joints.of(self.q[i])[joint]) for i in (max(index - 1, 0), index))
        part = (limit - before) / (after - before) if after != before else 0.0
        return self._margin(joint, self._time_between(max(index - 1, 0), part), limit)

    def smallest_margin(self) -> JointLimitMargin | None:
        """Return the joint with the smallest margin to a position limit; None without limits."""
        limits = self._solver.limits
        positions = limits.joints.of(self.q)
        margins = np.minimum(positions - limits.lower, limits.upper - positions)
        margins = np.where(self._reached[:, None], margins, np.inf)
        index, joint = (int(entry) for entry in np.unravel_index(int(margins.argmin()), margins.shape))
        if not np.isfinite(margins[index, joint]):
            return None
        return self._margin(joint, float(self._path.times[index]), float(positions[index, joint]))

    def _margin(self, joint: int, time: float, value: float) -> JointLimitMargin:
        limits, joints = self._solver.limits, self._solver.limits.joints
        lower, upper = float(limits.lower[joint]), float(limits.upper[joint])
        return JointLimitMargin(joints.names[joint], time, value, lower, upper, joints.units[joint])

    def fastest_joint(self) -> FastestJoint | None:
        """Return the joint with the largest speed relative to its limit, at the rates J^+ V_WP.

        None without velocity limits.
        """
        limits, joints = self._solver.limits.velocity, self._solver.limits.joints
        if not np.isfinite(limits).any():
            return None
        parts = np.abs(self._rates) / limits * self._reached[:, None]
        index, joint = (int(entry) for entry in np.unravel_index(int(parts.argmax()), parts.shape))
        time, speed = float(self._path.times[index]), float(abs(self._rates[index, joint]))
        unit = f"{joints.units[joint]}/s"
        return FastestJoint(joints.names[joint], time, speed, float(limits[joint]), unit)

    def _time_between(self, index: int, part: float) -> float:
        """Return the time at a part of the way from one pose to the next, s."""
        before, after = self._path.times[index : index + 2]
        return float(before + part * (after - before))
