"""Closure of the kinematics: tips, bases, joints, links and clocks from the views of the payload."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_coeffs, savgol_filter
from scipy.spatial.transform import Rotation

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import log3
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.grasps.spring_damper import SpringDamper
from coop_pin.identification.estimate import Fit, Parameter, Priors
from coop_pin.identification.filtering import (
    APART,
    EXACT_ANGLE,
    deflection,
    position_noise,
    sample_times,
    smoothing,
)
from coop_pin.identification.views import FRAME_AXES, View, columns, moved, view_of
from coop_pin.logs.record import ArmRecord, Record
from coop_pin.model.cell_arm import CellArm
from coop_pin.simulation.loop import start_configuration

_STEPS, _RESTS, _LARGEST = 60, 1e-3, 20.0
"""Most Gauss-Newton steps, and the sizes of the last and of the largest one, in sds of the priors."""
BEYOND = 4.0
"""Prior standard deviations from which on an estimate is doubtful, and no prior tells it from others."""
_UNSEEN = 0.1
"""Part of the prior's variance from which on the prior decides an estimate, too."""
_REPEATS = 0.1
"""Part of the usual step between stamps below which the second is left out."""
_ALIGNS = 5
"""Most steps of the clocks alone before."""


def arm_parameters(arm: CellArm) -> list[Parameter]:
    """Return tip, base, joints and links of an arm, in the order of ``columns``."""
    names, units = arm.limits.joints.names, arm.limits.joints.units
    frames = [(part, k) for part in ("tip", "base") for k in range(6)]
    rows = [(part, FRAME_AXES[k], "m" if k < 3 else "rad") for part, k in frames]
    joints = [name.removeprefix("arm/") for name in names]
    rows += [("joint", *one) for one in zip(joints, units, strict=True)]
    return [Parameter(arm.name, *row) for row in (*rows, *(("link", joint, "1") for joint in joints))]


def kinematic_parameters(arms: Mapping[str, CellArm], priors: Priors) -> tuple[list[Parameter], Array]:
    """Return the parameters of all arms, then clocks of all but the first, and the priors."""
    parameters = [one for arm in arms.values() for one in arm_parameters(arm)]
    parameters += [Parameter(name, "clock", "", "s") for name in [*arms][1:]]
    sds = [np.broadcast_to(getattr(priors, one.part), 2)[int(one.unit == "rad")] for one in parameters]
    return parameters, np.array(sds)


def grasp_springs(scenario: Scenario) -> dict[str, SpringDamper]:
    """Return the spring of every compliant grasp by its arm, damped as at the start of a run."""
    chain, names = CellChain(scenario.cell, scenario.plant), [*scenario.cell.arms]
    if len(chain.springs):
        chain.damp(start_configuration(chain, scenario))
    return {
        names[arm]: SpringDamper(*(part[k : k + 1] for part in chain.springs.springs))
        for k, arm in enumerate(chain.springs.arms)
    }


class ViewClosure:
    """Closure of the views of all arms, as a least-squares problem.

    With r_i = [p_i - p_1, log(R_i R_1^T)] of the views without the errors x, at a time of the first arm's
    clock, and W W^T the inverse of its covariance by the encoders' noise, x minimises the sum of |W r|^2 and
    of |x / prior|^2.

    Attributes:
        times: times that are fitted, s, shape (n,).
        parameters: parameters that move a view.
        prior: their standard deviations.
        noise: noise of the drive positions of every arm, shape (nv,) each.
        springs: springs of the grasps that have one.
        deflections: positions and turns of tips in their grasp frames by springs, as functions of time.
    """

    def __init__(
        self,
        record: Record,
        arms: Mapping[str, CellArm],
        priors: Priors,
        *,
        noise: Mapping[str, Array] | None = None,
        springs: Mapping[str, SpringDamper] | None = None,
    ) -> None:
        """Choose samples by how far the joints move, and look at how errors move the views there."""
        self.arms, self.rows = arms, next(iter(arms.values())).rows
        self.springs = springs or {}
        read = {name: one for name, one in self.springs.items() if len(record.arms[name].wrench_time)}
        by_spring = {name: deflection(record.arms[name], one, record.free) for name, one in read.items()}
        self.deflections = {name: off for name, (off, _) in by_spring.items()}
        self._springs = {name: (_smooth(off), sd) for name, (off, sd) in by_spring.items()}
        splines = {name: _spline(record.arms[name]) for name in arms}  # a spring swings as its arm does
        self._smoothed = {name: _smooth(one) for name, one in splines.items()}
        self._splines = self._smoothed if by_spring else splines
        self.noise = noise or {
            name: position_noise(record.arms[name].position @ arm.drive.T) for name, arm in arms.items()
        }
        apart, self._smooths = APART, 1.0
        if self._springs:
            width = smoothing(record.arms[next(iter(arms))].time)
            apart, self._smooths = width // 2, float(np.linalg.norm(savgol_coeffs(width, 3)))
        self.times = sample_times(record, apart)
        everything, sds = kinematic_parameters(arms, priors)
        _, J = self._evaluate(np.zeros(len(sds)), np.ones(len(sds), dtype=bool))
        self._is_free = (np.abs(J).max(axis=(0, 1)) > 1e-9) & (sds > 0.0)
        self.parameters = tuple(one for one, free in zip(everything, self._is_free, strict=True) if free)
        self.prior = sds[self._is_free]
        self._whiten = self._whitening()

    def view(self, name: str, times: Array, offset: Array | float = 0.0, late: float = 0.0) -> View:
        """Return the view of an arm at times of the first clock, with what the spring of its grasp gives."""
        arm = self.arms[name]
        view = view_of(arm, self.joints(name, times + late)[0] - offset)
        if name not in self._springs:
            return view
        return view._replace(pose=view.pose @ arm.X_PE @ np.linalg.inv(self.tip(name, times + late)))

    def tip(self, name: str, times: Array) -> Array:
        """Return the pose of a tip in the payload frame at times of its clock, shape (n, 4, 4)."""
        X = np.tile(self.arms[name].X_PE, (len(times), 1, 1))
        if name not in self._springs:
            return X
        off, slack = self._springs[name][0](times), np.tile(np.eye(4), (len(times), 1, 1))
        slack[:, :3, :3] = Rotation.from_rotvec(off[:, 3:]).as_matrix()
        slack[:, :3, 3] = off[:, :3]
        return np.asarray(X @ slack)

    def joints(self, name: str, times: Array) -> tuple[Array, Array]:
        """Return joint positions and velocities of an arm at times, shape (n, nv); its ends beyond them.

        From the nearest sample on by a smooth motion: the noise of an interpolation is less between samples,
        and would draw clocks there.
        """
        spline, smooth = self._splines[name], self._smoothed[name]
        times = np.clip(times, spline.x[0], spline.x[-1])
        middles = (spline.x[1:] + spline.x[:-1]) / 2.0
        nearest = spline.x[np.searchsorted(middles, times)]
        return spline(nearest) + smooth(times) - smooth(nearest), smooth(times, 1)

    def turns(self, times: Array) -> Array:
        """Return how the parameters turn the view of the first arm, world axes, rad, shape (n, 3, p)."""
        name, arm = next(iter(self.arms.items()))
        G = columns(self.view(name, times), arm)[:, 3:]
        others = len(self._is_free) - G.shape[2]
        return np.asarray(np.pad(G, ((0, 0), (0, 0), (0, others)))[:, :, self._is_free])

    def _evaluate(self, x: Array, is_free: Array) -> tuple[Array, Array]:
        """Return residuals and their derivatives, shapes (n, r) and (n, r, all parameters)."""
        rows, poses, by_errors, by_clock = list(self.rows.indices), [], [], []
        full = np.zeros(len(is_free))
        full[is_free] = x
        ends = np.cumsum([12 + 2 * arm.nv for arm in self.arms.values()])
        *of_arms, clocks = np.split(full, ends)
        for (name, arm), late, part in zip(self.arms.items(), (0.0, *clocks), of_arms, strict=True):
            tip, base, offset, links = np.split(part, (6, 12, 12 + arm.nv))
            view, (_, speed) = self.view(name, self.times, offset, late), self.joints(name, self.times + late)
            poses.append(moved(view, arm, tip, base, links))
            by_errors.append(-columns(view._replace(pose=poses[-1]), arm)[:, rows])
            by_clock.append(np.einsum("nij,nj->ni", view.jacobian, speed)[:, rows])
        r = np.empty((len(self.times), len(rows) * (len(poses) - 1)))
        J = np.zeros((*r.shape, len(full)))
        for k in range(1, len(poses)):
            at = slice(len(rows) * (k - 1), len(rows) * k)
            turned = log3(poses[k][:, :3, :3] @ np.swapaxes(poses[0][:, :3, :3], 1, 2))
            r[:, at] = np.hstack((poses[k][:, :3, 3] - poses[0][:, :3, 3], turned))[:, rows]
            J[:, at, : ends[0]], J[:, at, ends[k - 1] : ends[k]] = -by_errors[0], by_errors[k]
            J[:, at, ends[-1] + k - 1] = by_clock[k]
        return r, J

    def _whitening(self) -> Array:
        """Return W at every time: noise of the first arm is in all residuals."""
        rows = list(self.rows.indices)
        of_arms = []
        for name in self.arms:
            view = self.view(name, self.times)
            sd = np.maximum(self.noise[name] * self._smooths, EXACT_ANGLE)
            J = view.jacobian[:, rows] @ self.arms[name].from_drive * sd
            if name in self._springs:
                tip = columns(view, self.arms[name])[:, rows, :6] * self._springs[name][1]
                J = np.concatenate((J, tip), axis=2)
            of_arms.append(J @ np.swapaxes(J, 1, 2))
        m, size = len(of_arms) - 1, len(rows)
        C = np.tile(of_arms[0], (1, m, m))
        for i, of_arm in enumerate(of_arms[1:]):
            C[:, size * i : size * (i + 1), size * i : size * (i + 1)] += of_arm
        floor = 1e-18 * np.eye(size * m)
        return np.linalg.inv(np.linalg.cholesky(C + floor))

    def mismatch(self, x: Array | None = None) -> Array:
        """Return the residuals without errors x, m and rad, shape (n, r)."""
        x = np.zeros(len(self.prior)) if x is None else x
        return self._evaluate(x, self._is_free)[0]

    def information(self) -> Array:
        """Return J^T W J at no errors, in units of the priors, shape (p, p)."""
        _, A = self._whitened(np.zeros(len(self.prior)))
        return np.asarray(A.T @ A)

    def _whitened(self, z: Array) -> tuple[Array, Array]:
        """Return residuals and derivatives by errors z in units of the priors, in units of the noise."""
        r, J = self._evaluate(z * self.prior, self._is_free)
        A = (self._whiten @ J[:, :, self._is_free]).reshape(-1, len(z)) * self.prior
        return np.einsum("nij,nj->ni", self._whiten, r), A

    def _aligned(self) -> Array:
        """Return the errors, in units of the priors, with clocks that fit together with a constant mismatch.

        From clocks that are further off than one swing of the motion, steps of all errors at once go astray.
        """
        z = np.zeros(len(self.prior))
        clocks = [k for k, one in enumerate(self.parameters) if one.part == "clock"]
        for _ in range(_ALIGNS if clocks else 0):
            residual, A = self._whitened(z)
            late = A.reshape(*residual.shape, -1)[..., clocks]
            late = (late - late.mean(axis=0)).reshape(-1, len(clocks))
            right = late.T @ (residual - residual.mean(axis=0)).ravel()
            step = np.linalg.solve(late.T @ late + np.eye(len(clocks)), right)
            z[clocks] -= step
            if np.abs(step).max(initial=0.0) < 1.0:
                break
        return z

    def fit(self) -> Fit:
        """Return the estimate of all parameters: Gauss-Newton steps, halved where the sum rises, to rest.

        Where one is doubtful that the log does not see, all priors count as wider, so that it is at 2 sds:
        they do not tell apart what the log does not.
        """
        z, step, least = self._aligned(), np.zeros(len(self.prior)), np.inf
        for _ in range(_STEPS):
            residual, A = self._whitened(z)
            H = np.linalg.inv(A.T @ A + np.eye(len(z)))
            cost = (residual**2).sum() + z @ z
            if cost > least and np.abs(step).max() > _RESTS:
                step = step / 2.0
                z = z + step
                continue
            step, least = H @ (A.T @ residual.ravel() + z), cost
            if np.abs(step).max() < _RESTS:
                break
            step = step / max(1.0, np.abs(step).max() / _LARGEST)
            z = z - step
        chi = float(np.sqrt((residual**2).sum() / max(residual.size - (len(H) - np.trace(H)), 1.0)))
        if (far := np.abs(z[np.diag(H) > _UNSEEN]).max(initial=0.0)) > BEYOND:
            H = np.linalg.inv(A.T @ A + np.eye(len(z)) * (2.0 / far) ** 2)
        covariance = np.asarray(max(chi, 1.0) ** 2 * H * np.outer(self.prior, self.prior), dtype=np.float64)
        return Fit(self.parameters, z * self.prior, covariance, self.prior, chi)


def _spline(record: ArmRecord) -> CubicSpline:
    """Return the joint positions as functions of the arm's time; stamps that all but repeat are left out."""
    time, kept = np.unique(record.time, return_index=True)
    steps = np.diff(time, prepend=-np.inf)
    is_new = steps > _REPEATS * float(np.median(steps))
    return CubicSpline(time[is_new], record.position[kept][is_new])


def _smooth(spline: CubicSpline) -> CubicSpline:
    """Return a function of time without what swings faster than a motion."""
    return CubicSpline(spline.x, savgol_filter(spline(spline.x), smoothing(spline.x), 3, axis=0))
