"""Limits of a carried line, and its motions of least time and of least effort within them."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.bisection import edge, factor_edge
from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.base.spatial.limit_surface import motion_maps, sliding_speeds
from coop_pin.description.cell.cell import Cell
from coop_pin.design.carried_path import CarriedPath
from coop_pin.design.path_parameterization import PathLimits, fastest, smoothed
from coop_pin.model.joint_limits import JointLimits
from coop_pin.reference.lines import TimedLineMotion

KNOTS = 201
"""Entries of the table s(t) of a motion, at least."""
_SAMPLES = 801
"""Times at which limits are looked at, at least; four for each entry of a table."""
_ROUNDS = 4
"""Rounds of the friction, which is not affine: each takes the speed of the one before."""
_RESERVED = 0.1
"""Least part of what a limit leaves at rest that friction leaves for the motion, while it is iterated."""
_STRETCHED = 1e-4
"""Accuracy of a stretched duration, or of a shortened change, as a part of it."""
_PIECE, _PIECES = 0.03, (12, 60)
"""Longest piece on which the change of s'' in a motion of least effort is linear, s, while their number is
within bounds."""
_PENALTY = 30.0
"""Weight of what exceeds a limit, or runs backwards, beside the rms of the torques."""
_BACKWARD = 1e-9
"""Speed backwards that is rounding, 1/s."""
_DIRECTIONS, _SIDES = 64, 16
"""Planes that stand for the limit surface of a pad, and for the circle of the moment that tips it."""


class CarryTiming(NamedTuple):
    """A motion at n times.

    Attributes:
        times: s, shape (n,).
        s: fraction of the line, likewise.
        v: s', 1/s.
        a: s'', 1/s^2.
    """

    times: Array
    s: Array
    v: Array
    a: Array

    @classmethod
    def of(cls, motion: TimedLineMotion, count: int) -> CarryTiming:
        """Return a motion at even times."""
        times = np.linspace(0.0, motion.times[-1], count)
        return cls(times, *np.array([motion.scaling(time) for time in times.tolist()]).T)


class CarryLimits(NamedTuple):
    """A carried line and the limits along it.

    Attributes:
        path: the closed chain along the line.
        torque: largest drive torques, N m, shape (drives,).
        speed: largest joint speeds in the coordinates of the tree, rad/s or m/s, shape (nv,).
        pads: rows of which the product with all wrenches is at most zero, shape (r, m, 6).
        drives: number of drives of every arm.
    """

    path: CarriedPath
    torque: Array
    speed: Array
    pads: Array
    drives: dict[str, int]

    @classmethod
    def of(cls, cell: Cell, path: CarriedPath, reserve: float) -> CarryLimits:
        """Return the limits of a cell without a part that is left for feedback."""
        limits = [JointLimits(arm, name) for name, arm in cell.arms.items()]
        torque = (1.0 - reserve) * np.concatenate([each.torque for each in limits])
        speed = (1.0 - reserve) * np.concatenate([each.velocity for each in limits])
        pads = [_pad_rows(cell, name, reserve) for name in cell.arms if name in cell.pads]
        drives = {name: len(each.torque) for name, each in zip(cell.arms, limits, strict=True)}
        return cls(path, torque, speed, np.concatenate((np.zeros((0, len(cell.arms), 6)), *pads)), drives)

    def require_rest(self, cell: Cell) -> None:
        """Refuse a line on which a drive cannot hold the cell at rest, or a pad would slip.

        Raises:
            InfeasibleMotionError: cause "torque", with the first place.
        """
        places, needed = self.path.places, np.abs(self.path.torque[2])
        drives = [f"drive {k + 1} of {arm!r}" for arm, count in self.drives.items() for k in range(count)]
        for i, drive in np.argwhere(needed > self.torque).tolist():
            detail = f"{drives[drive]} needs {needed[i, drive]:.4g} N m at rest at s = {places[i]:.3g}"
            detail += f" of the line (allowed {self.torque[drive]:.4g})"
            raise InfeasibleMotionError("torque", f"{detail}; carry or squeeze less, or take another line")
        slips = np.einsum("rmi,nmi->nr", self.pads, self.path.wrench[2]) > 0.0
        for i, row in np.argwhere(slips).tolist():
            detail = f"the pad of {[*cell.padded][row // (_DIRECTIONS + _SIDES)]!r} would slip or tip at rest"
            detail += f" at s = {places[i]:.3g} of the line"
            raise InfeasibleMotionError("torque", f"{detail}; squeeze more, or carry less")

    def along(self, path: CarriedPath, friction: Array) -> PathLimits:
        """Return the limits at the places of a path, each as a part of itself, with torques of friction."""
        (A, B, C), zero = path.torque, np.zeros_like(path.rates)
        F = np.einsum("rmi,pnmi->pnr", self.pads, path.wrench)
        F = F / np.maximum(np.abs(F[2]).max(axis=0, initial=0.0), 1e-9)
        drives = [np.concatenate((T, -T), axis=1) / np.tile(self.torque, 2) for T in (A, B, C + friction)]
        return PathLimits(
            path.places,
            np.concatenate((drives[0], zero, F[0]), axis=1),
            np.concatenate((drives[1], (path.rates / self.speed) ** 2, F[1]), axis=1),
            np.concatenate((drives[2] - 1.0, zero - 1.0, F[2]), axis=1),
        )

    def exceeded(self, path: CarriedPath, v: Array, a: Array) -> Array:
        """Return the largest part by which a limit is exceeded at s' and s'' of every place, shape (n,)."""
        return self.along(path, path.friction(v)).largest(a, v**2)

    def effort(self, motion: TimedLineMotion) -> float:
        """Return the integral of the sum of the squared drive torques, N^2 m^2 s."""
        times, s, v, a = CarryTiming.of(motion, _SAMPLES)
        return float(np.trapezoid((self.path.at(s).torques(v, a) ** 2).sum(axis=1), times))

    def least_time(self, line: TimedLineMotion, smoothing: float) -> TimedLineMotion:
        """Return the fastest motion, averaged over a time and stretched until all limits hold."""
        path, friction = self.path, np.zeros_like(self.path.torque[2])
        resting = self.along(path, friction).c
        for _ in range(_ROUNDS):
            limits = self.along(path, friction)
            x = fastest(limits._replace(c=np.minimum(limits.c, _RESERVED * resting)))
            friction = path.friction(np.sqrt(x))
        times, fractions = smoothed(path.places, x, smoothing, KNOTS)
        return self.stretched(line.replace(times=times, fractions=fractions))

    def stretched(self, motion: TimedLineMotion) -> TimedLineMotion:
        """Return a motion with its time stretched, or shortened, until the limits just hold."""
        _, s, v, a = CarryTiming.of(motion, max(_SAMPLES, 4 * len(motion.times)))
        path = self.path.at(s)

        def holds(factor: float) -> bool:
            return bool(self.exceeded(path, v / factor, a / factor**2).max() <= 0.0)

        low = high = 1.0
        while not holds(high):
            low, high = high, 1.5 * high
        while holds(low):
            low, high = low / 1.5, low
        return slower(motion, factor_edge(holds, high, low, _STRETCHED))

    def least_effort(self, seed: TimedLineMotion) -> TimedLineMotion:
        """Return the motion of least effort of a duration: a seed plus splines at rest at both ends.

        The change of s'' is linear on pieces of at most 30 ms and zero at both ends. What exceeds a limit is
        a penalty, by least squares with all else; then the change is shortened until the limits hold.
        """
        from scipy.optimize import least_squares  # slow to load

        begun, T = CarryTiming.of(seed, KNOTS), seed.times[-1]
        splines = _splines(begun.times)
        moved = partial(_moved, begun, splines)

        def parts(timing: CarryTiming) -> tuple[Array, Array]:
            path = self.path.at(np.clip(timing.s, 0.0, 1.0))
            excess = np.maximum(self.exceeded(path, timing.v, timing.a), 0.0)
            return path.torques(timing.v, timing.a), excess

        def residuals(p: Array) -> Array:
            torque, excess = parts(timing := moved(p))
            beyond = np.concatenate((excess, np.minimum(T * timing.v, 0.0)))
            return np.concatenate((torque.ravel() / scale, _PENALTY * beyond))

        scale = float(np.linalg.norm(parts(begun)[0])) / np.sqrt(KNOTS)
        p = least_squares(residuals, np.zeros(splines[0].shape[1]), method="lm").x

        def holds(part: float) -> bool:
            timing = moved(part * p)
            return timing.v.min() >= -_BACKWARD and not parts(timing)[1].any()

        part = 1.0 if holds(1.0) else edge(holds, 0.0, 1.0, _STRETCHED) if holds(0.0) else 0.0
        timing = moved(part * p)
        timing.s[[0, -1]] = 0.0, 1.0
        return seed.replace(times=timing.times, fractions=np.clip(timing.s, 0.0, 1.0))


def slower(motion: TimedLineMotion, factor: float) -> TimedLineMotion:
    """Return a motion with its times multiplied."""
    return motion.replace(times=factor * np.array(motion.times))


def _splines(times: Array) -> list[Array]:
    """Return values and two derivatives of cubic splines at rest at both ends, shape (n, splines) each."""
    from scipy.interpolate import BSpline  # slow to load

    count = int(np.clip(np.ceil(times[-1] / _PIECE), *_PIECES))
    knots = np.linspace(0.0, times[-1], count + 1)
    splines = [BSpline.basis_element(knots[i : i + 5], extrapolate=False) for i in range(count - 3)]
    return [np.nan_to_num(np.array([spline.derivative(k)(times) for spline in splines]).T) for k in range(3)]


def _moved(begun: CarryTiming, splines: list[Array], p: Array) -> CarryTiming:
    """Return a motion plus splines times p."""
    changes = [spline @ p for spline in splines]
    return CarryTiming(begun.times, *(part + change for part, change in zip(begun[1:], changes, strict=True)))


def _pad_rows(cell: Cell, name: str, reserve: float) -> Array:
    """Return rows of an arm's pad: planes inside the cones of ``chain.friction_cones``, shape (r, m, 6).

    d . (f_x, f_y, m / R) <= (1 - reserve) mu N h r for unit vectors d = (v, w R), with the mean h of the
    points' ``sliding_speeds``, and d . (b / l) <= (1 - reserve) N r with the levers l of the pad. r shrinks
    the planes until all their corners are inside the cone.
    """
    pad = cell.pads[name]
    on_pad = pad.in_plane(np.eye(6), cell.grasps[name].matrix).T
    k, R = np.arange(_DIRECTIONS) + 0.5, pad.torsion_radius
    z, azimuth = 1.0 - 2.0 * k / _DIRECTIONS, k * np.pi * (1.0 + np.sqrt(5.0))
    circle = np.sqrt(1.0 - z**2)
    d = np.stack((circle * np.cos(azimuth), circle * np.sin(azimuth), z), axis=1)
    h = sliding_speeds(motion_maps(pad.points), d / (1.0, 1.0, R)).mean(axis=1)
    from scipy.spatial import ConvexHull  # slow to load

    sides = ConvexHull(d / h[:, None]).simplices  # three planes that meet in a corner each
    corners = np.zeros((len(sides), 6))
    corners[:, [0, 1, 5]] = np.linalg.solve(d[sides], h[sides][..., None])[..., 0] * (1.0, 1.0, R)
    slip = d @ (on_pad[[0, 1, 5]] / np.array([[1.0], [1.0], [R]])) / h[:, None]
    slip -= (1.0 - reserve) * pad.mu / pad.needed_friction(corners).max() * on_pad[2]
    turn = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    tip = np.stack((np.cos(turn), np.sin(turn)), axis=1) @ (on_pad[3:5] / pad.levers[:, None])
    tip -= (1.0 - reserve) * np.cos(np.pi / _SIDES) * on_pad[2]
    rows = np.zeros((len(slip) + len(tip), len(cell.arms), 6))
    rows[:, list(cell.arms).index(name)] = np.concatenate((slip, tip))
    return rows
