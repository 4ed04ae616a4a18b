"""Linear closed loop of the payload-space law along a motion: its matrices at poses and what drives it."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import TaskRows, spatial_inertia, weight_wrench
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.path_following import time_at_rest
from coop_pin.feasibility.reachability import Reachability
from coop_pin.feasibility.task_inertia import HeldArm
from coop_pin.model.arm_model import ArmModel
from coop_pin.simulation.build_controller import controlled_arm
from coop_pin.stability.admittance_stability import matrix_of
from coop_pin.stability.loaded_grasps import changes_under_load, give_way

_SAMPLES, _LATER = 401, 41
"""Times at which wrenches are computed while the reference moves, and after it."""
_POSES = 33
"""Poses between which the loop is interpolated."""
_REST = 5.0
"""Longest time after the motion that is looked at, s."""
GROWS = 1e-3
"""Growth of a mode at a pose above which the loop counts as unstable, 1/s."""
_MOST_TICKS = 40_000
"""Most ticks that are looked at."""


def _turn(rows: TaskRows, X_WP: Array) -> Array:
    """Return Q with which task rows turn from payload to world axes, shape (k_0, k_0)."""
    return np.array([rows.turn(X_WP, row) for row in np.eye(rows.size)]).T


class MotionLoop:
    """Closed loop along the motion: its law, its matrices at poses and what drives it.

    Bodies are the payload with the arms that hold it rigidly, then the arms whose grasps give.
    """

    def __init__(self, scenario: Scenario, cell_reach: Reachability) -> None:
        """Look up the law, and compute what the motion asks for."""
        law: Any = scenario.controller
        cell = scenario.cell
        rows, names = cell.task_rows, list(cell.arms)
        self.scenario, self.rows, self.m, self.k = scenario, rows, len(names), rows.size
        arms = {name: controlled_arm(scenario, ArmModel(cell.arms[name], name=name)) for name in names}
        self.laws: list[Any] = [
            law.controller_of(arm, law.gains_of(name).sized(rows.size, arm.drives), scenario)
            for name, arm in arms.items()
        ]
        gains = [each.gains for each in self.laws]
        self.gamma = np.array([gain.pose_gain for gain in gains])
        self.k_I = np.array([gain.sign_gain.diagonal() for gain in gains]) / law.switching.width
        bound, linear = self.laws[0].integral.bound, rows.are_linear
        kinds = (linear, ~linear) if bound else ()
        self.bounds = np.array([bound.free[kind].min(initial=np.inf) for kind in kinds] or [np.inf])
        every = max((wrist.every for wrist in scenario.wrists), default=1)
        self.g = law.measures * self.laws[0].integral.gain / every
        self.leak = (not law.measures) * self.laws[0].integral.leak
        late = law.force_path.delay + max((wrist.delay for wrist in scenario.wrists), default=0)
        K = [np.linalg.inv(C) if C.any() else C for C in map(cell.compliance, names)]
        self.K = np.array([each[np.ix_(rows.indices, rows.indices)] for each in K])
        gives = np.array([each.any() for each in K])
        self.n = 1 + int(gives.sum())
        self.held = np.eye(self.n)[np.where(gives, np.cumsum(gives), 0)]  # body of each arm
        self.give = gives[:, None] * (self.held - np.eye(self.n)[0])  # x_i - x by bodies
        self.is_rigid = ~gives[:, None, None]
        self.zeta = np.array([getattr(grasp, "damping_ratio", 0.0) for grasp in cell.grasps.values()])
        plan = scenario.grasp_plan_at(0.0).linkage
        parts = cell.shares[:, None, None] * np.eye(6) if plan is None else plan
        self.split = np.array([part[np.ix_(rows.indices, rows.indices)] for part in parts])
        arm_shape = (self.m, self.k)
        self.shapes = [(self.n, self.k)] * 2 + [arm_shape, (late + 1, *arm_shape)] + [arm_shape] * 3
        self._follow(cell_reach)

    def _follow(self, cell_reach: Reachability) -> None:
        """Compute what the motion asks for at times of its own, and its poses."""
        scenario, rows = self.scenario, self.rows
        law: Any = scenario.controller
        motion, first = scenario.payload_motion, cell_reach.arms[0].first
        period, end = scenario.clock.period, min(time_at_rest(scenario), scenario.duration)
        last = min(scenario.duration, end + _REST, _MOST_TICKS * period)
        end = min(end, last)
        later = end + (last - end) * np.linspace(0.0, 1.0, _LATER) ** 2
        self.end, self.times = end, np.unique(np.append(np.linspace(0.0, end, _SAMPLES), later))
        self.ticks = np.arange(1 + round(last / period)) * period
        t = cell_reach.arms[0].times[first:]
        self.arms = [HeldArm(scenario, reach, law.posture) for reach in cell_reach.arms]
        pairs = zip(self.arms, cell_reach.arms, strict=True)
        self.paths = [arm.path(self.times, t, reach.q[first:]) for arm, reach in pairs]
        self.speeds = [arm.speeds(self.times, path) for arm, path in zip(self.arms, self.paths, strict=True)]
        targets = [motion.at(time) for time in self.times.tolist()]
        payload, indices = scenario.cell.payload, list(rows.indices)
        M_0 = [
            spatial_inertia(payload.mass, payload.inertia_matrix, target.X_WP_d[:3, :3]) for target in targets
        ]
        twists = np.array([target.V_WP_d for target in targets])
        moves = np.interp(self.ticks, self.times, np.abs(twists).max(axis=1)) > 0.0
        self.moves = moves & (self.ticks <= end)
        self.M_0 = np.array(M_0)[:, indices][:, :, indices]
        self.R = np.array([target.X_WP_d[:3, :3] for target in targets])
        self.Q = np.array([_turn(rows, target.X_WP_d) for target in targets])
        push = np.einsum("nij,nj->ni", M_0, np.gradient(twists, self.times, axis=0))[:, indices]
        pairs_of = zip(self.arms, self.paths, strict=True)
        a = np.array([arm.wrenches(self.times, path) for arm, path in pairs_of]).swapaxes(0, 1)
        grasps = scenario.cell.grasps
        squeeze = np.array(
            [[rows.select(f) for f in scenario.squeeze.at(time, grasps)] for time in self.times]
        )
        self._drive(push, a - a[0], squeeze, -rows.select(twists[0]))

    def _drive(self, push: Array, a: Array, squeeze: Array, velocity: Array) -> None:
        """Set the first state, and what drives the loop at every tick, shape (ticks, inputs)."""
        scenario, m, is_pressed = self.scenario, self.m, bool(self.scenario.cell.patches)
        start, begin = scenario.start.matrix, scenario.payload_motion.at(0.0).X_WP_d
        Q_0, weight = (
            _turn(self.rows, start),
            weight_wrench(scenario.cell.payload.mass, scenario.cell.gravity),
        )
        load = np.array([Q_0 @ part @ Q_0.T @ self.rows.select(weight) for part in self.split])
        self.load = load
        borne = load + is_pressed * squeeze[0] @ Q_0.T
        x = self.rows.pose_error(start, begin)
        sprung = borne @ Q_0 * ~self.is_rigid[:, :, 0]  # in payload axes
        off, self.r, self.K = give_way(scenario.cell, self.K, sprung)
        view = x + off @ Q_0.T
        e = np.exp(-self.laws[0].gains.transient_rate * self.ticks)[:, None, None]
        Q, f_d = self._at_ticks(self.Q), self._at_ticks(squeeze)
        f_d = f_d if is_pressed else f_d - squeeze[0] * e
        self.f_r = np.einsum("nij,nmj->nmi", Q, f_d)
        C = [
            np.zeros_like(K) if law.compliance is None else law.compliance
            for K, law in zip(self.K, self.laws, strict=True)
        ]
        known = np.einsum("nij,mjk,nmk->nmi", Q, C, f_d)
        zeroed = scenario.controller.near_rest.is_zeroed * view
        surface = velocity + np.einsum("mij,mj->mi", self.gamma, view - zeroed)
        known = known + np.einsum("nij,mj->nmi", Q, off - zeroed @ Q_0)
        self.sigma = np.einsum("mij,nmj->nmi", self.gamma, known) - surface * e
        every = (
            self.sigma,
            self.f_r,
            self._at_ticks(a),
            self._at_ticks(push),
            np.tile(load, (len(e), 1, 1)),
            np.einsum("nij,mj->nmi", Q, sprung),
        )
        self.inputs = np.concatenate([each.reshape(len(e), -1) for each in every], axis=1)
        self.input_shapes = [each.shape[1:] for each in every]
        internal = borne - np.einsum("mij,j->mi", Q_0 @ self.split @ Q_0.T, borne.sum(axis=0))
        zero = np.zeros((m, self.k))
        of_result = self._internal(borne, load)
        states = x, np.tile(velocity, (self.n, 1)), zero, internal, self.f_r[0], zero, of_result
        self.first = np.concatenate(
            [np.broadcast_to(*pair).ravel() for pair in zip(states, self.shapes, strict=True)]
        )

    def _internal(self, F: Array, load: Array) -> Array:
        """Return internal wrenches by the shares, as of results, without the bending by the weight."""
        bends = np.expand_dims(~self.rows.are_linear, tuple(range(1, F.ndim - 1)))
        kept = F - bends * load
        return kept - np.tensordot(np.outer(self.scenario.cell.shares, np.ones(self.m)), kept, 1)

    def _at_ticks(self, values: Array) -> Array:
        """Return values of the motion's times at the ticks."""
        columns = values.reshape(len(values), -1).T
        each = np.array([np.interp(self.ticks, self.times, column) for column in columns])
        return each.T.reshape(-1, *values.shape[1:])

    @cached_property
    def matrices(self) -> tuple[Array, Array, Array]:
        """Return times of poses, and there the matrices from states and from inputs to the next states."""
        poses = np.unique(np.searchsorted(self.times, np.linspace(0.0, self.end or self.times[-1], _POSES)))
        A, B = np.split(np.array([self._tick_matrix(pose) for pose in poses]), [len(self.first)], axis=2)
        return self.times[poses], A, B

    def growth(self) -> float:
        """Return the rate at which the fastest mode at any pose grows, 1/s; at most 0 if none does."""
        radius = float(np.abs(np.linalg.eigvals(self.matrices[1])).max())
        return (radius - 1.0) / self.scenario.clock.period

    def run(self) -> Array:
        """Return the states at all ticks, shape (ticks, states); not finite in the end if they grow."""
        times, A, B = self.matrices
        after = np.clip(np.searchsorted(times, self.ticks, side="right"), 1, len(times) - 1)
        part = np.clip((self.ticks - times[after - 1]) / (times[after] - times[after - 1]), 0.0, 1.0)
        states = np.empty((len(self.ticks), len(self.first)))
        states[0] = x = self.first
        steps = np.stack((A[:-1], A[1:] - A[:-1]), axis=1)
        driven = [np.empty((0, len(self.first)))]
        for j in range(1, len(times)):
            at = after == j
            ends = [self.inputs[at] @ B[k].T for k in (j - 1, j)]
            driven.append(ends[0] + part[at, None] * (ends[1] - ends[0]))
        with np.errstate(over="ignore", invalid="ignore"):  # of a loop that grows
            for k, u in enumerate(np.concatenate(driven)[:-1]):
                still, more = steps[after[k] - 1] @ x
                states[k + 1] = x = still + part[k] * more + u
        return states

    def _tick_matrix(self, pose: int) -> Array:
        """Return the matrix from states and inputs to the next states, at the pose of a time."""
        n, k, T, Q = self.n, self.k, self.scenario.clock.period, self.Q[pose]
        Lambda, B = np.array([self._arm(arm, pose) for arm in range(len(self.arms))]).swapaxes(0, 1)
        K, split = Q @ self.K @ Q.T, Q @ self.split @ Q.T
        W = np.linalg.inv(Lambda) + np.linalg.inv(self.M_0[pose])
        D = np.array([_damper(*of) for of in zip(K, self.zeta, W, strict=True)])
        mass = np.einsum("ia,ijk,ib->ajbk", self.held, Lambda, self.held)
        mass[0, :, 0] += self.M_0[pose]
        mobility = np.linalg.inv(mass.reshape(n * k, -1))
        springs, dampers, friction = (
            np.einsum("ia,ijk,ib->ajbk", bodies, each, bodies).reshape(n * k, -1)
            for bodies, each in ((self.give, K), (self.give, D), (self.held, B))
        )
        f_r = self.f_r[min(np.searchsorted(self.ticks, self.times[pose]), len(self.ticks) - 1)]
        turns, levers, shifts = changes_under_load(self.rows, f_r + self.load, self.r @ self.R[pose].T)
        turns_wanted, _, _ = changes_under_load(self.rows, f_r, self.r)
        carried = self.give.any(axis=1)[:, None] * np.eye(n)[0]
        of_arm = np.einsum("mij,mb->mibj", turns, carried) + np.einsum("mij,mb->mibj", levers, self.give)
        bent = np.einsum("ma,mibj->aibj", self.give, of_arm)
        bent[0] -= np.einsum("mij,mb->ibj", shifts, self.give)
        springs = mobility @ (springs - bent.reshape(n * k, -1))
        dampers = mobility @ (dampers + friction)
        plant = _held_motion(T, springs, dampers, mobility)
        gains = [law.gains.sliding_gain for law in self.laws]
        turned = [Q @ K @ Q.T if law.axes.turns else K for law, K in zip(self.laws, gains, strict=True)]
        G = self.scenario.cell.shares[:, None, None] * np.array(turned)
        explains, pole = np.linalg.inv(G @ self.gamma), self.scenario.controller.force_path.pole
        K_f, k_I = self.laws[0].gains.force_gain, self.k_I[:, :, None]

        def tick(
            x: Array, v: Array, Z: Array, f: Array, f_m: Array, y: Array, _: Array, *driven: Array
        ) -> tuple[Array, ...]:
            sigma, f_r, a, push, load, held = driven
            view = np.tensordot(self.held, x, 1)
            s = np.tensordot(self.held, v, 1) + self.gamma @ view + sigma
            f_m = pole * f_m + (1.0 - pole) * f[-1]
            anchor = -self.g * (f_m - f_r)
            Z = Z + anchor
            P = G @ s + Z + f_r + turns_wanted @ view - K_f * (f_m - f_r)
            y = (1.0 - T * k_I) * (y + explains @ anchor)
            Z = Z + T * (G @ (k_I * s) - self.leak * Z)
            force = -np.tensordot(self.held.T, P + a, 1) - np.tensordot(self.give.T, load - held, 1)
            force[0] -= push
            state = np.concatenate([part.reshape(n * k, -1) for part in (x, v, force)])
            x, v = np.split(plant @ state, 2)
            acceleration = (mobility @ state[2 * n * k :] - springs @ x - dampers @ v).reshape(n, k, -1)
            x, v = x.reshape(n, k, -1), v.reshape(n, k, -1)
            F = -K @ np.tensordot(self.give, x, 1) - D @ np.tensordot(self.give, v, 1)
            F = F + held + np.tensordot(of_arm, x, 2)
            F = F + self.is_rigid * (Lambda @ acceleration[0] + B @ v[0] + P + a + load)
            seen = F - turns @ np.tensordot(self.give, x, 1)
            f = np.concatenate(((seen - split @ seen.sum(axis=0))[None], f[:-1]))
            return x, v, Z, f, f_m, y, self._internal(F, load)

        return matrix_of(tick, [*self.shapes, *self.input_shapes])

    def _arm(self, index: int, pose: int) -> tuple[Array, Array]:
        """Return Lambda of an arm, and J#^T D J# of its joints' friction with J# = M^-1 J^T Lambda."""
        arm, q, v = self.arms[index], self.paths[index][pose], self.speeds[index][pose]
        J = self.rows.select(arm.model.payload_jacobian(q))
        weighted = np.linalg.solve(arm.model.mass_matrix(q), J.T)
        Lambda = np.linalg.inv(J @ weighted)
        inverse = weighted @ Lambda
        return Lambda, inverse.T @ arm.friction.damping(v) @ inverse

    def errors(self, states: Array) -> Array:
        """Return position, angle, and force and moment of the worst arm at the ticks, shape (ticks, 4)."""
        internal = states[:, -self.m * self.k :].reshape(self.f_r.shape) - self.f_r
        return np.hstack((self.norms(states[:, : self.k]), self.norms(internal).max(axis=1)))

    def explained(self, states: Array) -> Array:
        """Return the biases y_i that explain what the anchors move, shape (ticks, m, k_0)."""
        size = self.m * self.k
        return states[:, -2 * size : -size].reshape(self.f_r.shape)

    def surfaces(self, states: Array) -> Array:
        """Return s_i, shape (ticks, m, k_0)."""
        x, v = np.moveaxis(states[:, : 2 * self.n * self.k].reshape(-1, 2, self.n, self.k), 1, 0)
        return self.held @ v + np.einsum("mij,nmj->nmi", self.gamma, self.held @ x) + self.sigma

    def norms(self, values: Array) -> Array:
        """Return the norms of positions and of rotations, or of forces and moments, shape (..., 2)."""
        linear = self.rows.are_linear
        return np.stack([np.linalg.norm(values[..., rows], axis=-1) for rows in (linear, ~linear)], axis=-1)


def _held_motion(T: float, springs: Array, dampers: Array, mobility: Array) -> Array:
    """Return the matrix from x, v and a held force to x and v a time T later, of v' = -Sx - Dv + Wf."""
    from scipy.linalg import expm  # slow to load

    n = len(mobility)
    flow = np.zeros((3 * n, 3 * n))
    flow[:n, n : 2 * n] = np.eye(n)
    flow[n : 2 * n] = np.hstack((-springs, -dampers, mobility))
    return np.asarray(expm(T * flow)[: 2 * n])


def _damper(K: Array, zeta: float, mobility: Array) -> Array:
    """Return D with which every mode of a spring has the damping ratio zeta, shape (k_0, k_0)."""
    s, U = np.linalg.eigh(mobility)
    root, inverse = U * np.sqrt(s) @ U.T, U / np.sqrt(s) @ U.T
    s, U = np.linalg.eigh(root @ K @ root)
    return 2.0 * zeta * inverse @ (U * np.sqrt(np.abs(s)) @ U.T) @ inverse
