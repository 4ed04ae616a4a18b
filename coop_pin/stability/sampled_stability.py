"""Stability of a controller's damping in discrete time, under zero-order hold."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, require_type, typed
from coop_pin.base.bisection import edge
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.reachability import Reachability
from coop_pin.model.cell_arm import CellArm
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.modes import damping_matrix, fastest_joints
from coop_pin.stability.sampled_motion import RestingLaw

STABILITY_LIMIT = 2.0
"""Sampled damping is stable below this: v[k+1] = (1 - value) v[k]."""

_UNDAMPED = 1e-6
_POSES = 9
_FACTOR_ERROR = 2.0**-40
"""Accuracy of the factor of a limit, as a part of the largest one."""


class SampledStability(NamedTuple):
    """Stability of sampled damping, with the critical mode.

    Attributes:
        value: ``T |lambda|^2 / Re lambda``, the largest of all modes; T lambda for a real lambda.
        rate_hz: the control rate, Hz.
        joints: the joints that move most in that mode, as arm/joint.
        time: time of the pose at which it is so, s.
        limit: value from which on the motion grows: 2, or less where the damping hears late messages.
        delay: age of the messages that the damping hears, ticks.
    """

    value: float
    rate_hz: float
    joints: tuple[str, ...]
    time: float = 0.0
    limit: float = STABILITY_LIMIT
    delay: int = 0

    @property
    def ok(self) -> bool:
        """Whether the motion decays from tick to tick."""
        return self.value < self.limit

    def summary(self) -> str:
        """Return the finding as text, in one line."""
        limit, joints = f"the stability limit {self.limit:.4g}", ", ".join(self.joints)
        if self.delay:
            limit += f" of messages {self.delay} ticks late"
        at = f", t = {self.time:.3g} s" if self.time else ""
        hold = f"with zero-order hold at {self.rate_hz:g} Hz{at}"
        if self.ok:
            return f"T*lambda = {self.value:.3g} is below {limit} {hold}; largest in {joints}"
        rate = f" above {self.rate_hz * self.value / self.limit:.4g} Hz" if np.isfinite(self.value) else ""
        subject = f"joint {joints} is" if len(self.joints) == 1 else f"joints {joints} are"
        return (
            f"T*lambda = {self.value:.3g} exceeds {limit}: {hold}, {subject} unstable."
            f" Raise clock.rate_hz{rate}, or lower the gains (posture damping included)"
        )


def sampled_stability(scenario: Scenario) -> SampledStability:
    """Return the stability of a controller's damping under zero-order hold, linearised at the start.

    With D = -d(acceleration)/dv through the torques alone and the closures kept closed, v[k+1] = (I - T D)
    v[k] from tick to tick. The mode of an eigenvalue lambda of D decays if ``|1 - T lambda| < 1``, that is,
    if ``T |lambda|^2 / Re lambda < 2``.

    Args:
        scenario: scenario that would be run. Friction, actuators and integral terms are not considered.

    Raises:
        UnreachablePoseError: an arm cannot hold the payload at the start.
        SingularJacobianError: an arm is singular there.
    """
    require_type("scenario", scenario, Scenario)
    return start_stability(Simulation(scenario, build_controller(scenario)))


@typed
def start_stability(simulation: Simulation) -> SampledStability:
    """Return the sampled stability of a simulation that has not begun; raises as sampled_stability."""
    return _stability_at(simulation, simulation.plant.q, 0.0)


@typed
def motion_stability(simulation: Simulation, cell_reach: Reachability) -> SampledStability:
    """Return the sampled stability where it is least along the motion of a simulation that has not begun.

    At up to nine poses as ``sampled_stability`` at the start; at each the law begins anew, at rest. Gains
    that change with time, such as those of a funnel, are those of the pose's time.

    Args:
        simulation: Simulation of a law.
        cell_reach: Reachability of its scenario, in which every arm holds the start.
    """
    along = configurations_along(simulation, cell_reach, _POSES)
    stabilities = [_stability_at(simulation, q, time) for time, q in along]
    return max(stabilities, key=lambda stability: stability.value / stability.limit)


def start_and_later(
    simulation: Simulation, cell_reach: Reachability | None, most: int
) -> list[tuple[float, Array]]:
    """Return the configuration of the start, and those of ``configurations_along`` later than that."""
    later = [] if cell_reach is None else configurations_along(simulation, cell_reach, most)[1:]
    return [(0.0, simulation.plant.q), *later]


def configurations_along(
    simulation: Simulation, cell_reach: Reachability, most: int
) -> list[tuple[float, Array]]:
    """Return times, s, and configurations of the cell on the reference, evenly chosen, both ends among them.

    Of a payload of several links those at which its base or its deflections leave the grasps closed; else the
    start alone.

    Args:
        simulation: Simulation, as of motion_stability.
        cell_reach: Reachability, likewise.
        most: Number of poses, at most.
    """
    model, reaches = simulation.chain.model, cell_reach.arms
    lead = CellArm(simulation.scenario.cell, reaches[0].arm)

    def X_WP(time: float, k: int) -> Array:  # which an arm does not see beyond a joint, or with a tool
        cell = simulation.scenario.cell
        if cell.jointed or cell.tools or simulation.chain.joints is not None:
            return simulation.scenario.payload_motion.at(time).X_WP_d
        return lead.payload_pose(reaches[0].q[k])

    # Of the poses at t = 0, which lead to the reference, the last.
    samples = list({time: sample for sample, time in enumerate(reaches[0].times.tolist())}.items())
    chosen = np.unique(np.linspace(0, len(samples) - 1, most).astype(int)).tolist()
    along = [
        (time, model.configuration([reach.q[k] for reach in reaches], X_WP(time, k)))
        for time, k in (samples[index] for index in chosen)
    ]
    if simulation.chain.joints is None:
        return along
    allowed = simulation.chain.mechanism.open_allowed
    closed = [each for each in along if max(map(max, simulation.chain.closure_errors(each[1]))) <= allowed]
    return closed or [(0.0, simulation.plant.q)]


def damping_rates(simulation: Simulation, cell_reach: Reachability) -> Array:
    """Return the eigenvalues lambda of D at the poses of ``motion_stability``, 1/s, shape (n, nv)."""
    along = configurations_along(simulation, cell_reach, _POSES)
    return np.array([np.linalg.eigvals(_damping(simulation, q, time)()).real for time, q in along])


def _damping(simulation: Simulation, q: Array, time: float) -> Callable[..., Array]:
    """Return D of a law that begins at a configuration and a time, by whether its messages are of rest."""
    law, speed = RestingLaw(simulation, q, time), simulation.scenario.controller.near_rest.linear_speed

    def damping(hears_rest: bool = False) -> Array:
        def torque(v: Array) -> Array:
            # Laws are linear in small speeds but for bounded signs, which cancel between opposite large ones.
            measured = law.moving(speed * v)
            return law.step(measured, law.state, law.at_rest if hears_rest else measured)[0] / speed

        return damping_matrix(simulation, q, torque)

    return damping


def _stability_at(simulation: Simulation, q: Array, time: float) -> SampledStability:
    """Return the sampled stability at a configuration and a time."""
    damping = _damping(simulation, q, time)
    eigenvalues, modes = np.linalg.eig(D := damping())
    clock, network = simulation.scenario.clock, simulation.scenario.network
    values = np.array([_stability_value(clock.period * entry) for entry in eigenvalues])
    worst = int(np.argmax(values))
    stability = SampledStability(
        float(values[worst]), clock.rate_hz, fastest_joints(simulation, np.abs(modes[:, worst])), time
    )
    if network is None or not (late := network.oldest_of(list(simulation.scenario.cell.arms), clock)):
        return stability
    D_now = damping(hears_rest=True)
    factor = delayed_factor(clock.period * D_now, clock.period * (D - D_now), late)
    return stability._replace(limit=factor * stability.value, delay=late) if factor < np.inf else stability


def delayed_factor(now: Array, late: Array, delay: int) -> float:
    """Return the factor of both at which v[k+1] = v[k] - now v[k] - late v[k-D] stops to decay.

    For one late mode alone that is 2 sin(pi / (4 D + 2)) / late (Levin and May, 1976); inf where nothing is
    late, for which the limit of sampled damping stands.
    """
    if np.abs(late).max() < _UNDAMPED:
        return np.inf
    basis, singular, _ = np.linalg.svd(np.hstack((now, late)))  # the motions that are damped at all
    N = basis[:, singular > _UNDAMPED * singular[0]]
    now, late, m = N.T @ now @ N, N.T @ late @ N, N.shape[1]

    def radius(factor: float) -> float:
        matrix = np.eye(m * (delay + 1), k=-m)
        matrix[:m, :m] = np.eye(m) - factor * now
        matrix[:m, -m:] -= factor * late
        return float(np.abs(np.linalg.eigvals(matrix)).max())

    largest = STABILITY_LIMIT / max(np.abs(np.linalg.eigvals(now + late)).max(), _UNDAMPED)
    return edge(lambda factor: radius(factor) < 1.0, 0.0, largest, _FACTOR_ERROR * largest)


def _stability_value(entry: complex) -> float:
    """Return ``|T lambda|^2 / Re(T lambda)``: zero without damping, infinity if the motion is driven."""
    if abs(entry) < _UNDAMPED:
        return 0.0
    return abs(entry) ** 2 / entry.real if entry.real > 0.0 else float("inf")
