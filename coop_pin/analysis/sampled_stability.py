"""Stability of damping in discrete time: a controller's under zero-order hold, friction in plant steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.analysis.reachability import Reachability
from coop_pin.arrays import Array, frozen, require_type, typed
from coop_pin.build_controller import build_controller
from coop_pin.chain.partner import partner_matrices
from coop_pin.description.events import Partner
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_arm import CellArm
from coop_pin.simulation import Simulation
from coop_pin.simulation.sensing import Sensing

STABILITY_LIMIT = 2.0
"""Sampled damping is stable below this: v[k+1] = (1 - value) v[k]."""

REAL_STABILITY = {"rk4": 2.785293563405282, "semi-implicit-euler": 2.0}
"""Largest h lambda for which an integrator's solution of v' = -lambda v decays: for RK4 the real root of
x^3 - 4 x^2 + 12 x - 24."""

_UNDAMPED = 1e-6
_POSES, _STEP_POSES = 9, 21
_SLOW = 1e-6
"""A speed at which Coulomb friction is linear, rad/s or m/s."""
_SHARE_OF_MODE = 0.3
_NEUTRAL_POLE = 1.0
"""Size of a pole that only rounding and slow friction have, 1/s."""
_FACTOR_BISECTIONS = 40
_LONGEST, _LIMIT_ERROR = 4.0, 1e-4
"""Beyond the stability region of RK4; accuracy of its border."""


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
            f"! T*lambda = {self.value:.3g} exceeds {limit}: {hold}, {subject} unstable."
            f" Raise clock.rate_hz{rate}, or lower the gains (posture damping included)"
        )


class StepStability(NamedTuple):
    """Stability of the plant's integration under joint friction and compliant grasps, with the critical mode.

    Attributes:
        value: ``h |lambda|``, with h the plant's step and lambda the fastest decay by friction alone; with
            compliant grasps the mode of springs, dampers and friction that is nearest to its limit.
        limit: stability limit of the integrator for it.
        steps_per_tick: plant steps in a tick.
        joints: the joints that move most in that mode, as arm/joint.
        time: time of the pose at which it is so, s.
        cause: origin of the mode, "friction", "compliant grasps", "patches" or "partner".
    """

    value: float
    limit: float
    steps_per_tick: int
    joints: tuple[str, ...]
    time: float = 0.0
    cause: str = "friction"

    @property
    def ok(self) -> bool:
        """Whether it is integrated stably."""
        return self.value <= self.limit

    def summary(self) -> str:
        """Return the finding as text, in one line."""
        at = f" at t = {self.time:.3g} s" if self.time else ""
        text = f"h*lambda = {self.value:.3g} of the {self.cause} of {', '.join(self.joints)}{at}"
        if self.ok:
            return f"{text} is within the stability limit {self.limit:.3g} of the plant's steps"
        steps = math.ceil(self.steps_per_tick * self.value / self.limit)
        remedy = "lower the friction" if self.cause == "friction" else "use a softer or less damped element"
        return (
            f"! {text} exceeds the stability limit {self.limit:.3g} of the plant's steps."
            f" Raise clock.steps_per_tick from {self.steps_per_tick} to {steps}, or {remedy}"
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

    At up to nine poses as ``sampled_stability`` at the start, with the law's state of the start. Gains that
    change with time, such as those of a funnel, are those of the pose's time.

    Args:
        simulation: Simulation of a law.
        cell_reach: Reachability of its scenario, in which every arm holds the start.
    """
    along = configurations_along(simulation, cell_reach, _POSES)
    stabilities = [_stability_at(simulation, q, time) for time, q in along]
    return max(stabilities, key=lambda stability: stability.value / stability.limit)


def configurations_along(
    simulation: Simulation, cell_reach: Reachability, most: int
) -> list[tuple[float, Array]]:
    """Return times, s, and configurations of the cell on the reference, evenly chosen, both ends among them.

    Args:
        simulation: Simulation, as of motion_stability.
        cell_reach: Reachability, likewise.
        most: Number of poses, at most.
    """
    model, reaches = simulation.plant.chain.model, cell_reach.arms
    lead = CellArm(simulation.scenario.cell, reaches[0].arm)
    # Of the poses at t = 0, which lead to the reference, the last.
    samples = list({time: sample for sample, time in enumerate(reaches[0].times.tolist())}.items())
    chosen = np.unique(np.linspace(0, len(samples) - 1, most).astype(int)).tolist()
    return [
        (time, model.configuration([reach.q[k] for reach in reaches], lead.payload_pose(reaches[0].q[k])))
        for time, k in (samples[index] for index in chosen)
    ]


def _stability_at(simulation: Simulation, q: Array, time: float) -> SampledStability:
    """Return the sampled stability at a configuration and a time."""
    D = _damping(simulation, q, _torque_of(simulation, q, time))
    eigenvalues, modes = np.linalg.eig(D)
    clock, network = simulation.scenario.clock, simulation.scenario.network
    values = np.array([_stability_value(clock.period * entry) for entry in eigenvalues])
    worst = int(np.argmax(values))
    stability = SampledStability(
        float(values[worst]), clock.rate_hz, fastest_joints(simulation, np.abs(modes[:, worst])), time
    )
    if network is None or not (late := network.oldest_of(list(simulation.scenario.cell.arms), clock)):
        return stability
    D_now = _damping(simulation, q, _torque_of(simulation, q, time, hears_rest=True))
    factor = _delayed_factor(clock.period * D_now, clock.period * (D - D_now), late)
    return stability._replace(limit=factor * stability.value, delay=late) if factor < np.inf else stability


def _delayed_factor(now: Array, late: Array, delay: int) -> float:
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

    low, high = 0.0, STABILITY_LIMIT / max(np.abs(np.linalg.eigvals(now + late)).max(), _UNDAMPED)
    for _ in range(_FACTOR_BISECTIONS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    return low


@typed
def step_stability(simulation: Simulation, cell_reach: Reachability | None = None) -> StepStability:
    """Return the stability of the plant's steps under friction and grasps, where it is least on the motion.

    D is that of sampled_stability for the friction. With compliant grasps it is looked at for every payload
    that the events bring. Coulomb friction is steepest at rest, where its slope is
    coulomb / coulomb_velocity: a joint that turns back along the motion passes it. Beyond the limit energy
    appears from nothing.

    Args:
        simulation: Simulation that has not begun.
        cell_reach: Reachability of its scenario, in which every arm holds the start; up to 21 poses of the
            motion are looked at. The start alone when omitted.
    """
    poses = [(0.0, simulation.plant.q)]
    if cell_reach is not None:
        poses += configurations_along(simulation, cell_reach, _STEP_POSES)[1:]
    stabilities = [_steps_at(simulation, *pose) for pose in poses]
    scenario = simulation.scenario
    if scenario.cell.unclosed or any(isinstance(event, Partner) for event in scenario.events):
        stabilities += [_grasp_steps_at(simulation, *pose) for pose in poses]
    return max(stabilities, key=lambda stability: stability.value / stability.limit)


def _grasp_steps_at(simulation: Simulation, time: float, q: Array) -> StepStability:
    """Return the stability of the plant's steps under grasps and friction, for the payload that is worst."""
    scenario, chain, cell = simulation.scenario, simulation.plant.chain, simulation.scenario.cell
    instants, stabilities = {0.0, *(event.time for event in scenario.events)}, list[StepStability]()
    for surroundings in map(scenario.surroundings_at, instants):
        chain.surround(surroundings)
        A, N = plant_matrix(simulation, q, partners=surroundings.partners)
        s, vectors = np.linalg.eig(A)
        modes = N @ vectors[len(A) // 2 :]
        limits = np.array([_ray_limit(entry) for entry in s])
        worst = int(np.argmax(np.abs(s) / limits))
        steps = scenario.clock.steps_per_tick
        value, joints = float(np.abs(s[worst])), fastest_joints(simulation, np.abs(modes[:, worst]))
        value *= scenario.clock.period / steps
        kinds = {"compliant grasps": cell.compliant, "patches": cell.patches}
        cause = next((kind for kind, grasps in kinds.items() if grasps), "partner")
        stabilities.append(StepStability(value, float(limits[worst]), steps, joints, time, cause))
    chain.surround(simulation.plant.surroundings)
    return max(stabilities, key=lambda stability: stability.value / stability.limit)


def plant_matrix(
    simulation: Simulation, q: Array, stiffer: float = 1.0, partners: Sequence[Partner] = ()
) -> tuple[Array, Array]:
    """Return the matrix of [y, w] under force elements and friction, and the basis N of the n motions.

    N has shape (nv, n), and v = N w.

    Args:
        simulation: Simulation of a cell.
        q: Configuration, with the payload at rest.
        stiffer: Factor of all stiffnesses of grasps, at the same damping ratios.
        partners: Partners that hold the payload.
    """
    plant = simulation.plant
    chain, rest, friction = plant.chain.mechanism, np.zeros(len(plant.v)), plant.transmission.friction
    basis, singular, _ = np.linalg.svd(
        np.column_stack([chain.project_velocity(q, row) for row in np.eye(len(rest))])
    )
    N = basis[:, singular > _UNDAMPED]
    elements = plant.chain.springs, plant.chain.patches
    K, D = (sum(parts) for parts in zip(*(element.matrices(q) for element in elements), strict=True))
    K, D = stiffer * K, math.sqrt(stiffer) * D
    for partner in partners:
        held = partner_matrices(partner, partner.time, plant.chain.payload_jacobian(q))
        K, D = K + held[0], D + held[1]
    D -= np.column_stack([friction(_SLOW * row) / _SLOW for row in np.eye(len(rest))])
    still = chain.forward_dynamics(q, rest, rest).acceleration
    forces = np.hstack((K @ N, D @ N)).T
    response = [chain.forward_dynamics(q, rest, force).acceleration - still for force in forces]
    n = N.shape[1]
    return np.vstack((np.eye(n, 2 * n, n), -N.T @ np.column_stack(response))), N


def _ray_limit(pole: complex) -> float:
    """Return the largest ``h |s|`` at which RK4 does not let the mode of a pole s grow."""
    direction = pole / abs(pole) if abs(pole) > _NEUTRAL_POLE else -1.0
    low, high = 0.0, _LONGEST
    while high - low > _LIMIT_ERROR:
        middle = (low + high) / 2.0
        x = middle * direction
        is_stable = abs(1.0 + x + x**2 / 2.0 + x**3 / 6.0 + x**4 / 24.0) <= 1.0 + _UNDAMPED
        low, high = (middle, high) if is_stable else (low, middle)
    return low


def _steps_at(simulation: Simulation, time: float, q: Array) -> StepStability:
    """Return the stability of the plant's steps at a configuration and its time."""
    friction, scenario = simulation.plant.transmission.friction, simulation.scenario
    eigenvalues, modes = np.linalg.eig(_damping(simulation, q, lambda v: friction(_SLOW * v) / _SLOW))
    worst = int(np.argmax(np.abs(eigenvalues)))
    steps = scenario.clock.steps_per_tick
    value = float(np.abs(eigenvalues[worst])) * scenario.clock.period / steps
    joints = fastest_joints(simulation, np.abs(modes[:, worst]))
    return StepStability(value, REAL_STABILITY[scenario.plant.integrator], steps, joints, time)


def _damping(simulation: Simulation, q: Array, torque: Callable[[Array], Array]) -> Array:
    """Return D = -d(acceleration)/dv through a torque, with the closures closed."""
    chain, rest = simulation.plant.chain.mechanism, np.zeros(len(simulation.plant.v))

    def acceleration(v: Array) -> Array:
        return chain.forward_dynamics(q, rest, torque(v)).acceleration

    speeds = [chain.project_velocity(q, row) for row in np.eye(len(rest))]
    return np.column_stack([(acceleration(-v) - acceleration(v)) / 2.0 for v in speeds])


def _stability_value(entry: complex) -> float:
    """Return ``|T lambda|^2 / Re(T lambda)``: zero without damping, infinity if the motion is driven."""
    if abs(entry) < _UNDAMPED:
        return 0.0
    return abs(entry) ** 2 / entry.real if entry.real > 0.0 else float("inf")


def _torque_of(
    simulation: Simulation, q: Array, time: float, *, hears_rest: bool = False
) -> Callable[[Array], Array]:
    """Return the controller's generalised force at a pose and time as a function of the velocity.

    Measured internal wrenches are as desired, joints are measured as they are. Torque limits play no part.

    Args:
        simulation: Simulation that has not begun.
        q: Configuration of the chain.
        time: Time of the pose, s.
        hears_rest: Whether messages are those of arms at rest; else they arrive at once.
    """
    plant, start, references = simulation.plant, simulation.references(0.0), simulation.references(time)
    ideal = simulation.scenario.with_ideal_sensors
    sensing = Sensing(ideal, plant.chain.model.arms, holding_torques=simulation.actuation.holding_commands)
    law, at_once, rest = simulation.controller, simulation.exchange.at_once, np.zeros(len(plant.v))
    state = law.init(at_once(law, sensing.start(plant.q, rest, start), start, None), start)
    # Laws are linear in small speeds but for bounded signs, which cancel between opposite large ones.
    speed, slots = simulation.scenario.controller.linear_speed, plant.chain.model.arms
    at_rest = [seen._replace(time=time, reported_torque=None) for seen in sensing.start(q, rest, references)]

    def torque(v: Array) -> Array:
        rates = [frozen(slot.drive.dot(speed * v[slot.v_slice])) for slot in slots]
        measurements = [
            seen._replace(v=rate, payload_twist=frozen(seen.payload_jacobian.dot(rate)))
            for seen, rate in zip(at_rest, rates, strict=True)
        ]
        told = at_once(law, at_rest if hears_rest else measurements, references, state)
        heard = [one._replace(messages=each.messages) for one, each in zip(measurements, told, strict=True)]
        command = law.step(heard, references, state)
        return plant.transmission.torque(simulation.actuation.torques_of(command)) / speed

    return torque


def fastest_joints(simulation: Simulation, mode: Array) -> tuple[str, ...]:
    """Return the joints that move fastest in a mode, the fastest first."""
    speeds = {
        name: float(speed)
        for slot in simulation.plant.chain.model.arms
        for name, speed in zip(slot.angles.names, mode[slot.v_slice], strict=True)
    }
    fastest = sorted(speeds, key=lambda name: -speeds[name])
    return tuple(name for name in fastest if speeds[name] >= _SHARE_OF_MODE * speeds[fastest[0]])[:4]
