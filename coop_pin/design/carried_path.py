"""A closed chain carried along a line: joint paths, torques and wrenches as functions of s, s' and s''."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.base.spatial import rotate_vector6
from coop_pin.description.cell.cell import Cell
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.ik_solver import IKSolution, IKSolver
from coop_pin.model.inverse_kinematics import solve_ik
from coop_pin.model.transmission import Transmission
from coop_pin.reference.lines import TimedLineMotion
from coop_pin.reference.quintic import TimeScaling

_NODES = 33
"""Places between which a spline of the joint angles starts the inverse kinematics."""
_STEP = 1e-3
"""Step of the differences along the path."""
_OFFSETS = _STEP * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
_REDUNDANT = 1e-10
"""Singular values of the closures below this part of the largest are redundant rows."""
_FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12.0 * _STEP)
_SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12.0 * _STEP**2)


@dataclass(frozen=True, eq=False)
class CarriedPath:
    """Drives and grasps of a cell along a line, at n places, all affine in u = s'' and x = s'^2.

    ``tau = torque[0] u + torque[1] x + torque[2] - friction(rates s')`` and likewise the wrenches.

    Attributes:
        places: s, from 0 to 1, shape (n,).
        rates: joint velocities by s' in the coordinates of the tree, shape (n, nv).
        torque: drive torques of all arms without friction, N m, shape (3, n, drives).
        wrench: interaction wrenches about P in payload axes, shape (3, n, m, 6).
        transmission: transmission of the cell.
        from_drive: map of generalised forces to drive torques, shape (drives, nv).
    """

    places: Array
    rates: Array
    torque: Array
    wrench: Array
    transmission: Transmission
    from_drive: Array

    def friction(self, speed: Array) -> Array:
        """Return the torques that overcome friction at speeds s', N m, shape (n, drives)."""
        return -(self.from_drive @ self.transmission.friction((self.rates * speed[:, None]).T)).T

    def torques(self, speed: Array, acceleration: Array) -> Array:
        """Return the drive torques at s' and s'' of every place, N m, shape (n, drives)."""
        A, B, C = self.torque
        return A * acceleration[:, None] + B * speed[:, None] ** 2 + C + self.friction(speed)

    def at(self, places: Array) -> CarriedPath:
        """Return the path at other places, by cubic splines."""
        first = self.rates.shape[1]  # columns of the spline: rates, torques, wrenches
        ends = first, first + 3 * self.torque.shape[2]
        rates, torque, wrench = np.split(self._spline(places), ends, axis=-1)
        return replace(
            self,
            places=places,
            rates=rates,
            torque=_by_row(torque, self.torque.shape[2:]),
            wrench=_by_row(wrench, self.wrench.shape[2:]),
        )

    @cached_property
    def _spline(self) -> Any:
        from scipy.interpolate import CubicSpline  # slow to load

        parts = (np.moveaxis(part, 0, 1).reshape(len(self.places), -1) for part in (self.torque, self.wrench))
        return CubicSpline(self.places, np.concatenate((self.rates, *parts), axis=1))


def _by_row(table: Array, shape: tuple[int, ...]) -> Array:
    """Return three rows at n places, shape (3, n, ...), of one row of numbers for each place."""
    return np.moveaxis(table.reshape(len(table), 3, *shape), 1, 0)


class CarriedLine:
    """A closed chain that carries its payload along a line, each arm near its posture.

    Joint paths are splines projected onto the poses by inverse kinematics, so that they are smooth, and
    closed to rounding. A redundant arm is nearest to its posture at every place.
    """

    def __init__(self, cell: Cell, line: TimedLineMotion, options: PlantOptions | None = None) -> None:
        """Find the joint paths.

        Args:
            cell: Cell with rigid grasps.
            line: Path of the payload.
            options: Options of the chain, whose coordinates are used.

        Raises:
            UnreachablePoseError: an arm cannot hold the start.
            InfeasibleMotionError: cause "reach": it cannot follow the line; cause "limits": a joint limit.
            ArgumentError: a grasp is not rigid.
        """
        cell.require_rigid("a planned carry")
        self._chain, self._line = CellChain(cell, options), line
        self._arms = [_JointPath(cell, name, line) for name in cell.arms]

    @property
    def edges(self) -> list[int]:
        """Number of drives before each arm but the first."""
        return list(np.cumsum([len(slot.drive) for slot in self._chain.model.arms])[:-1])

    def configuration(self, s: float) -> Array:
        """Return the configuration of the tree at a place, shape (nq,)."""
        X_WP = _pose_at(self._line, s)
        return self._chain.model.configuration([arm.at(s, X_WP) for arm in self._arms], X_WP)

    def derivatives(self, s: float) -> tuple[Array, Array, Array]:
        """Return q, and velocity and acceleration by s: differences of fourth order, put on the closures."""
        mechanism, around = self._chain.mechanism, [self.configuration(s + step) for step in _OFFSETS]
        q = around[2]
        steps = np.array([pin.difference(mechanism.model, q, near) for near in around])
        v = mechanism.project_velocity(q, _FIRST @ steps)
        a, closures = _SECOND @ steps, mechanism.closures.state(q, v)
        opening = closures.jacobian @ a + closures.drift
        return q, v, a - np.linalg.lstsq(closures.jacobian, opening, rcond=_REDUNDANT)[0]

    def dynamics(self, places: Array, squeeze: Array) -> CarriedPath:
        """Return rates, torques and wrenches at places of the line.

        Args:
            places: s, shape (n,).
            squeeze: Desired internal wrenches about P in payload axes, N and N m, shape (m, 6).
        """
        slots, nv = self._chain.model.arms, self._chain.mechanism.model.nv
        drives = np.split(np.zeros((sum(len(slot.drive) for slot in slots), nv)), self.edges)
        for slot, rows in zip(slots, drives, strict=True):
            rows[:, slot.v_slice] = slot.from_drive.T
        from_drive = np.concatenate(drives)
        q, v, a = map(np.array, zip(*map(self.derivatives, places.tolist()), strict=True))
        R = np.array([_pose_at(self._line, s)[:3, :3] for s in places.tolist()])
        rest, internal = np.zeros_like(v), rotate_vector6(R[:, None], np.tile(squeeze, (len(R), 1, 1)))
        parts = [
            self._chain.inverse_dynamics(q, *motion, internal=internal)
            for motion in ((rest, v), (v, a), (rest, rest))
        ]
        tau = np.array([part.torque for part in parts])
        F = np.array([part.interaction_wrench for part in parts])
        F = rotate_vector6(np.swapaxes(R, 1, 2)[:, None], F)
        tau[:2] -= tau[2]
        F[:2] -= F[2]
        return CarriedPath(places, v, tau @ from_drive.T, F, self._chain.transmission, from_drive)


def _pose_at(line: TimedLineMotion, s: float) -> Array:
    """Return X_WP at a place of a line, shape (4, 4)."""
    return line.along(TimeScaling(s, 0.0, 0.0)).X_WP_d


class _JointPath:
    """Configurations of one arm along a line."""

    def __init__(self, cell: Cell, name: str, line: TimedLineMotion) -> None:
        from scipy.interpolate import make_interp_spline  # slow to load

        self.model = model = CellArm(cell, name)
        self._solver = solver = IKSolver(model)
        places = np.linspace(0.0, 1.0, _NODES)
        poses = [_pose_at(line, s) for s in places.tolist()]
        q = solve_ik(model, poses[0], posture=cell.arms[name].posture)
        near = q if cell.arms[name].posture is None else model.posture_configuration
        angles = []
        for s, last, X_WP in zip(places, [poses[0], *poses], poses, strict=False):
            target = solver.tip_target(X_WP)
            solution = solver.follow_step(solver.tip_target(last), target, q)
            self._require_closed(s, solution)
            q = solution.q
            if solver.is_redundant:
                q = solver.null_space_descent(target, q, near, limited=False)
            self._require_within(s, q)
            angles.append(solver.limits.joints.of(q))
        self._spline = make_interp_spline(places, np.unwrap(angles, axis=0), k=5)

    def at(self, s: float, X_WP: Array) -> Array:
        """Return the configuration at a place, shape (nq,)."""
        guess = self._solver.limits.joints.configuration(self._spline(s))
        solution = self._solver.solve(self._solver.tip_target(X_WP), guess, limited=False)
        self._require_closed(s, solution)
        return solution.q

    def _require_closed(self, s: float, solution: IKSolution) -> None:
        if not solution.is_closed:
            gap = f"{solution.distance:.3g} m and {solution.angle:.3g} rad at s = {s:.3g} of the line"
            detail = f"arm {self.model.name!r} misses its grasp by {gap}"
            raise InfeasibleMotionError("reach", f"{detail}; move start, goal or base")

    def _require_within(self, s: float, q: Array) -> None:
        limits = self._solver.limits
        if (violation := limits.violation(q)).any():
            joint = int(np.abs(violation).argmax())
            detail = (
                f"{limits.joints.names[joint]!r} would be at {limits.joints.of(q)[joint]:.4g} at s = {s:.3g}"
                f" (allowed {limits.lower[joint]:.4g} to {limits.upper[joint]:.4g})"
            )
            raise InfeasibleMotionError("limits", f"{detail}; take another posture, start or goal")
