"""Stability of the sampled motion with all gains of a law, spare joints included, along the motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.analysis.reachability import Reachability
from coop_pin.analysis.sampled_stability import configurations_along, fastest_joints
from coop_pin.arrays import Array, typed
from coop_pin.control.bounds import lag_pole
from coop_pin.description.sensors import Sensors
from coop_pin.simulation import Simulation
from coop_pin.simulation.sensing import Sensing

_SMALL = 1e-6
"""Displacement of differences, rad or m; speeds likewise."""
_SETTLED = 1e6
"""A time at which the transients of the start are gone, s."""
_NEUTRAL = 1e-6
"""Growth in a tick, and part of a singular value, that count as none."""
_LARGEST_LAG = 1.0
_POSES = 6
"""Largest number of poses on the reference, evenly spread."""
_SPARE = 0.5
"""Part of a mode's square that must leave the task rows at rest for it to be one of spare joints."""


class Mode(NamedTuple):
    """A mode of the sampled motion.

    Attributes:
        z: its factor from tick to tick.
        joints: the joints that move most, as arm/joint, the fastest first.
        is_spare: whether most of it leaves the task rows of the payload at rest.
    """

    z: complex
    joints: tuple[str, ...]
    is_spare: bool

    @property
    def name(self) -> str:
        """Name of the mode: that of the spare joints with their arms, or its joints."""
        arms = " and ".join(sorted({joint.partition("/")[0] for joint in self.joints}))
        return f"elbow (spare joints) of {arms}" if self.is_spare else f"motion of {', '.join(self.joints)}"


class LoopStability(NamedTuple):
    """Stability of the sampled motion with pose gain, integral, posture and lag.

    Attributes:
        radius: largest ``|z|`` of the motion from tick to tick; 1 where nothing controls a direction.
        lag: largest time constant of an arm's drives, s.
        largest_lag: largest lag with which the motion would still not grow, s, counted from that of the
            drives if that is stable, else from none; at most 1, and 0 where the motion grows without any.
        mode: mode of that ``|z|``.
        spare: slowest mode of the spare joints; None without any.
        period: of the control, s.
        remedy: field of the spring of spare joints; empty if the law has none.
        time: time of the pose at which the motion is least stable, s.
    """

    radius: float
    lag: float
    largest_lag: float
    mode: Mode
    spare: Mode | None
    period: float
    remedy: str
    time: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether the motion does not grow from tick to tick."""
        return self.radius < 1.0 + _NEUTRAL

    @property
    def spare_rate(self) -> float:
        """Decay of the slowest mode of the spare joints, 1/s; negative if it grows, inf without any."""
        return np.inf if self.spare is None else -float(np.log(abs(self.spare.z))) / self.period

    def summary(self) -> str:
        """Return the finding as text, in one line."""
        at = f" at t = {self.time:.3g} s" if self.time else ""
        finding = f"|z| = {self.radius:.5f}{at} with all gains and a lag of {1e3 * self.lag:.3g} ms"
        bound = f"lags up to {1e3 * self.largest_lag:.3g} ms"
        if self.ok:
            return f"{finding}: the motion is stable, with {bound}"
        if self.mode.is_spare and self.mode.z.real > 0.0:
            spring = f"Raise {self.remedy}" if self.remedy else "Its law has no spring for them"
            growth = f"grows by e in {self.period / np.log(self.radius):.3g} s"
            return f"! {finding}: the {self.mode.name} {growth}: nothing holds it against gravity. {spring}"
        allowed = f"stable with {bound}" if self.largest_lag else "unstable without any lag, too"
        lower = f"Lower {self.remedy.rpartition('.')[0]}" if self.mode.is_spare else "Lower the gains"
        return f"! {finding}: the {self.mode.name} is unstable ({allowed}). {lower} or raise clock.rate_hz"


@typed
def loop_stability(simulation: Simulation, cell_reach: Reachability | None = None) -> LoopStability:
    """Return the stability of a law with all its gains under the lag of the drives, where it is least.

    On the n motions y that the closures leave, with their speed w, the acceleration b by the torques that
    act, and what the law keeps in its integral, h::

        u[k] = G [y, w][k] + h[k],   h[k+1] = h[k] + H [y, w][k],   y' = w,  w' = b,  b' = (u - b) / lag

    over a tick in closed form, with the largest lag of an arm for all. sgn has no linear integral: there H =
    0. Friction, leak, rate limits, and filters and delays of the sensors are not considered. At each pose the
    law starts anew from the torques that hold the cell there.

    Args:
        simulation: simulation of a law of coop_pin that has not begun.
        cell_reach: reachability of its scenario, in which every arm holds the start; up to six poses of the
            motion are looked at. The start alone when omitted.

    Raises:
        SingularJacobianError: an arm is singular at a pose.
        ArgumentError: a grasp is compliant.
    """
    simulation.scenario.cell.require_rigid("loop_stability")
    poses = [(0.0, simulation.plant.q)]
    if cell_reach is not None:
        poses += configurations_along(simulation, cell_reach, _POSES)[1:]
    found, bound = list[LoopStability](), _LARGEST_LAG
    for time, q in poses:
        found.append(_PoseLoop(simulation, q, time).stability(bound))
        bound = found[-1].largest_lag
    worst = max(found, key=lambda stability: stability.radius)
    slowest = min(found, key=lambda stability: stability.spare_rate)
    return worst._replace(largest_lag=bound, spare=slowest.spare)


class _PoseLoop:
    """Sampled loop of a law, linearised at rest at a pose of the motion."""

    def __init__(self, simulation: Simulation, q: Array, time: float) -> None:
        self._simulation, self._q, self._time = simulation, q, time
        self._period = simulation.scenario.clock.period
        self._G, self._H, self._N = law_feedback(simulation, q, time)

    def stability(self, bound: float) -> LoopStability:
        """Return the stability at the lag of the drives, and the largest lag up to a bound, s."""
        lag = self._simulation.scenario.actuator_lag * self._period
        modes = self._modes(lag)
        mode = max(modes, key=lambda mode: abs(mode.z))
        spare = max((mode for mode in modes if mode.is_spare), key=lambda mode: abs(mode.z), default=None)
        remedy = self._simulation.scenario.controller.spare_spring
        largest = self._largest_lag(lag, bound)
        return LoopStability(abs(mode.z), lag, largest, mode, spare, self._period, remedy, self._time)

    def _map(self, lag: float) -> Array:
        return _tick_map(self._G, self._H, self._period, lag)

    def _is_stable(self, lag: float) -> bool:
        return float(np.abs(np.linalg.eigvals(self._map(lag))).max()) < 1.0 + _NEUTRAL

    def _largest_lag(self, lag: float, bound: float) -> float:
        """Return the largest lag up to a bound with which the motion does not grow, s."""
        # A lag can also stabilise what the sampling does not bear without: the search starts at the drives'.
        low, high = lag if self._is_stable(lag) else 0.0, max(bound, lag)
        if self._is_stable(high):
            return high
        if not self._is_stable(low):
            return 0.0
        while high - low > _SMALL:
            middle = (low + high) / 2.0
            low, high = (middle, high) if self._is_stable(middle) else (low, middle)
        return low

    def _modes(self, lag: float) -> list[Mode]:
        """Return the modes with the lag of the drives that move the chain."""
        z, vectors = np.linalg.eig(self._map(lag))
        chain, rows, n = self._simulation.plant.chain, self._simulation.scenario.cell.task_rows, len(self._G)
        J = rows.select(chain.payload_jacobian(self._q)) @ self._N
        at_rest, y = np.eye(n) - np.linalg.pinv(J) @ J, vectors[:n]
        size = np.linalg.norm(y, axis=0)
        is_spare = np.linalg.norm(at_rest @ y, axis=0) ** 2 > _SPARE * size**2
        joints = [fastest_joints(self._simulation, speeds) for speeds in np.abs(self._N @ y).T]
        return [Mode(complex(z[k]), joints[k], bool(is_spare[k])) for k in np.flatnonzero(size > 0.0)]


def _tick_map(G: Array, H: Array, T: float, lag: float) -> Array:
    """Return the map of [y, w, b, h] over a tick, h in coordinates U of what H can reach."""
    basis, singular, _ = np.linalg.svd(H)
    U, eye = basis[:, singular > _NEUTRAL * np.abs(G).max()], np.eye(len(G))
    r = lag_pole(lag / T)
    held = lag * (1.0 - r)  # the integral of exp(-s / lag) over the tick
    free = np.array([[1.0, T, lag * (T - held)], [0.0, 1.0, held], [0.0, 0.0, r]])
    by_u = np.array([[T * T / 2.0 - free[0, 2]], [T - held], [1.0 - r]])
    zero = np.zeros((len(G), U.shape[1]))
    feedback, kept = np.hstack((G, 0.0 * eye, U)), np.hstack((U.T @ H, zero.T, np.eye(U.shape[1])))
    return np.vstack((np.hstack((np.kron(free, eye), np.tile(zero, (3, 1)))) + np.kron(by_u, feedback), kept))


def law_feedback(
    simulation: Simulation,
    q_0: Array,
    time: float,
    wrenches: Callable[[Array, Array], Array] | None = None,
) -> tuple[Array, Array, Array]:
    """Return d(acceleration)/d[y, w] by a tick's torque, and by what the law keeps of it, (n, 2 n) each.

    At rest on the reference at a pose, joints measured as they are and internal wrenches as desired. The last
    entry is the basis N of the n motions, shape (nv, n).

    Args:
        simulation: Simulation that has not begun.
        q_0: Configuration at the pose.
        time: Time of the pose, s.
        wrenches: Errors of the measured internal wrenches, task rows, shape (m, k_0), at a state; none when
            omitted.
    """
    plant, law, scenario = simulation.plant, simulation.controller, simulation.scenario
    chain, rest = plant.chain.mechanism, np.zeros(len(plant.v))
    ideal = scenario.replace(sensors=Sensors(), arm_sensors={}, beyond_bound=True)
    holding = simulation.actuation.holding_commands(q_0)
    sensing = Sensing(ideal, plant.chain.model.arms, holding_torques=lambda _q: holding)
    first = sensing.start(q_0, rest, simulation.references(time))
    references = [
        reference._replace(pose=seen.payload_pose, twist=0.0 * reference.twist)
        for reference, seen in zip(simulation.references(time), first, strict=True)
    ]
    basis, singular, _ = np.linalg.svd(
        np.column_stack([chain.project_velocity(q_0, row) for row in np.eye(len(rest))])
    )
    N = basis[:, singular > _NEUTRAL]

    def step(q: Array, v: Array, state: object) -> tuple[Array, object]:
        # Drives cut nothing here: what the law asked for a tick ago is what acted.
        measured: Any = sensing.start(q, v, references)
        seen = [arm._replace(time=_SETTLED, reported_torque=None) for arm in measured]
        if wrenches is not None:
            seen = [
                arm._replace(internal_wrench=arm.internal_wrench + error, internal_wrench_age=0.0)
                for arm, error in zip(seen, wrenches(q, v), strict=True)
            ]
        command = law.step(seen, references, state)
        torque = plant.transmission.torque(simulation.actuation.commanded(command))
        return N.T @ chain.forward_dynamics(q, rest, torque).acceleration, command.state

    def answer(q: Array, v: Array) -> Array:
        now, state = step(q, v, start)
        kept = step(q_0, rest, state)[0] if scenario.controller.has_linear_integral else 0.0 * now
        return np.concatenate((now, kept))

    start = law.init(first, references)
    moved = [
        [answer(pin.integrate(chain.model, q_0, h * row), rest), answer(q_0, h * row)]
        for row in N.T
        for h in (_SMALL, -_SMALL)
    ]
    slopes = (np.array(moved[::2]) - np.array(moved[1::2])) / (2.0 * _SMALL)
    G, H = np.split(np.hstack((slopes[:, 0].T, slopes[:, 1].T)), 2)
    return G, H, N
