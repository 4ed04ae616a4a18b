"""Steps of a plant: the fewest in a tick that keep a measured error, and their stability under friction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, as_positive, require_type, typed
from coop_pin.base.bisection import edge
from coop_pin.base.errors import DivergedError, OutOfRangeError
from coop_pin.description.events import Partner
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.reachability import Reachability
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.grasps.spring_damper import partner_matrices
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import PlantMaker
from coop_pin.simulation.simulate import simulate
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.modes import NEUTRAL, damping_matrix, fastest_joints, motion_basis
from coop_pin.stability.sampled_stability import start_and_later

STEPS_FIELD, AUTO = "clock.steps_per_tick", "auto"
"""Field whose value "auto", in changes of a scenario, stands for the fewest steps that keep an error."""
AUTO_ERROR = 1e-8
"""Limit of the error of that choice, m."""
MOST_STEPS = 64
"""Largest number of steps in a tick that is proposed; a run with twice as many measures its error."""


@dataclass(frozen=True, eq=False)
class StepSize:
    """Number of plant steps in a tick, chosen by measured error.

    Attributes:
        scenario: scenario with this number of steps, ready to run.
        limit: limit of the error, m.
        errors: bound of the error of payload position and closure, m, by number of steps in a tick; numbers
            with which the run diverges are missing.
    """

    scenario: Scenario
    limit: float
    errors: dict[int, float]

    @property
    def steps(self) -> int:
        """Number of steps in a tick."""
        return self.scenario.clock.steps_per_tick

    def summary(self) -> str:
        """Return the choice and the measured errors as text."""
        clock = self.scenario.clock
        step = f"steps of {1e3 * clock.period / self.steps:.4g} ms, {self.steps} in a tick"
        measured = (f"  {steps:3d} in a tick: {error:.2g} m" for steps, error in self.errors.items())
        return "\n".join((f"{self.scenario.name}: {step}, keep an error of {self.limit:.3g} m", *measured))


def with_changes(scenario: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """Return a scenario with changes by dotted path; ``steps_per_tick = "auto"`` is chosen for 1e-8 m.

    Raises:
        ScenarioError: a path does not exist, or the result has mistakes.
        OutOfRangeError: no number of steps keeps the error; others as of fewest_steps.
    """
    require_type("changes", changes, Mapping)
    if changes.get(STEPS_FIELD) != AUTO:
        return scenario.override(changes)
    others = {field: value for field, value in changes.items() if field != STEPS_FIELD}
    return fewest_steps(scenario.override(others), error=AUTO_ERROR).scenario


def fewest_steps(scenario: Scenario, *, error: float = 1e-9, plant: PlantMaker = PinocchioPlant) -> StepSize:
    """Return the fewest integration steps in a tick, of 1, 2, 4, ... 64, whose run keeps an error.

    With x the payload's position and the closure errors of the arms at the recorded ticks, ``|.|`` the
    largest over them and N the finest run so far, ``e_n <= |x_n - x_N| + e_N`` and ``e_N <= |x_N/2 - x_N|``,
    if halving the steps at least halves the error. A method of order p divides it by 2^p, so that this bound
    is up to twice the error for n = N/2 and close to the error for smaller n. N is doubled until a bound is
    within ``error``. Rate of the controller, events and random numbers stay as they are.

    Laws with sgn: where a surface passes zero, or the edge of its dead zone, within the error, its sign flips
    a tick earlier or later, and runs part by the torque of that tick, however small their steps are. A flip
    that separates the runs is in the bound, one that none of them shows is not; with ``dead_zone = 0`` signs
    of rounding can agree in two runs by chance, and the bound is then worth nothing.

    Args:
        scenario: scenario that would be run; a shorter duration or fewer events give what suffices for these.
        error: limit of the position of the payload and of the closure errors, m.
        plant: Maker of the plant, as of Simulation.

    Raises:
        OutOfRangeError: no number of steps keeps it, with the smallest error found.
        DivergedError: the run diverges with the finest steps too; other errors are those of coop_pin.run.
    """
    require_type("scenario", scenario, Scenario)
    error = as_positive("error", error)
    runs: dict[int, Array] = {}
    errors: dict[int, float] = {}
    for steps in (2**k for k in range(MOST_STEPS.bit_length() + 1)):
        try:
            runs[steps] = _positions(scenario, steps, plant)
        except DivergedError:
            if steps >= MOST_STEPS:
                raise
        if steps in runs and steps // 2 in runs:
            rest = _distance(runs[steps // 2], runs[steps])
            errors = {n: _distance(run, runs[steps]) + rest for n, run in runs.items() if n < steps}
        fewest = next((n for n, bound in errors.items() if bound <= error), None)
        if fewest is not None:
            return StepSize(scenario.override({STEPS_FIELD: fewest}), error, errors)
    raise OutOfRangeError(
        "error", error, f"at least {min(errors.values()):.3g} m with up to {MOST_STEPS} steps in a tick"
    )


def _positions(scenario: Scenario, steps: int, plant: PlantMaker) -> Array:
    """Return the payload's position and each arm's closure error at the recorded ticks, shape (k, 3 + m)."""
    scenario = scenario.override({STEPS_FIELD: steps})
    data = simulate(scenario, build_controller(scenario), plant=plant).data
    return np.hstack([data.payload_position.values, data.closure_distance.values])


def _distance(run: Array, other: Array) -> float:
    """Return the largest distance of the payload, or difference of a closure error, of two runs, m."""
    change = run - other
    return float(max(np.linalg.norm(change[:, :3], axis=1).max(), np.abs(change[:, 3:]).max()))


REAL_STABILITY = {"rk4": 2.785293563405282, "semi-implicit-euler": 2.0}
"""Largest h lambda for which an integrator's solution of v' = -lambda v decays: for RK4 the real root of
x^3 - 4 x^2 + 12 x - 24."""

_POSES = 21
_SLOW = 1e-6
"""A speed at which Coulomb friction is linear, rad/s or m/s."""
_NEUTRAL_POLE = 1.0
"""Size of a pole that only rounding and slow friction have, 1/s."""
_LONGEST, _LIMIT_ERROR = 4.0, 1e-4
"""Beyond the stability region of RK4; accuracy of its border."""


_REMEDIES = {
    "friction": "lower the friction",
    "end stops": "lower stops.stiffness or raise stops.give",
    "payload stops": "lower the stop_stiffness of the joint",
}
_HIT, _PAYLOAD_HIT = 0.12, 0.08
"""Largest ``h sqrt(k W)`` of a joint of an arm, and of a payload, on its end stop with ``2 zeta <= 1``: steps
straddle the first contact, and a hit then leaves at most 0.2 % of what the stop takes and loses unexplained;
stronger damping needs as much less. Springs and weights of a payload's joint turn it back sooner."""


class StepStability(NamedTuple):
    """Stability of the plant's integration under joint friction and compliant grasps, with the critical mode.

    Attributes:
        value: ``h |lambda|``, with h the plant's step and lambda the fastest decay by friction alone; with
            compliant grasps the mode of springs, dampers and friction that is nearest to its limit.
        limit: stability limit of the integrator for it.
        steps_per_tick: plant steps in a tick.
        joints: the joints that move most in that mode, as arm/joint.
        time: time of the pose at which it is so, s.
        cause: origin of the mode: "friction", "compliant grasps", "patches", "partner", "payload joints",
            "end stops" or "payload stops". Of a stop, lambda is the rate of its joint on it, and the limit
            that of its energy.
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
        remedy = _REMEDIES.get(self.cause, "use a softer or less damped element")
        of_what = "limit of the energy of a hit" if "stops" in self.cause else "stability limit"
        return (
            f"{text} exceeds the {of_what}, {self.limit:.3g}, of the plant's steps."
            f" Raise clock.steps_per_tick from {self.steps_per_tick} to {steps}, or {remedy}"
        )


@typed
def step_stability(simulation: Simulation, cell_reach: Reachability | None = None) -> StepStability:
    """Return the stability of the plant's steps under friction and grasps, where it is least on the motion.

    D is that of sampled_stability for the friction. With compliant grasps it is looked at for every payload
    that the events bring. Coulomb friction is steepest at rest, where its slope is
    coulomb / coulomb_velocity: a joint that turns back along the motion passes it. Beyond the limit energy
    appears from nothing. End stops are looked at as if every joint could hit its own.

    Args:
        simulation: Simulation that has not begun.
        cell_reach: Reachability of its scenario, in which every arm holds the start; up to 21 poses of the
            motion are looked at. The start alone when omitted.
    """
    poses = start_and_later(simulation, cell_reach, _POSES)
    stabilities = [_steps_at(simulation, *pose) for pose in poses]
    scenario = simulation.scenario
    if scenario.cell.unclosed or scenario.partners:
        stabilities += [_grasp_steps_at(simulation, *pose) for pose in poses]
    stabilities += [_joint_steps_at(simulation, *pose) for pose in poses if simulation.chain.joints]
    if simulation.chain.stops:
        stabilities += [each for pose in poses for each in _stop_steps_at(simulation, *pose)]
    return max(stabilities, key=lambda stability: stability.value / stability.limit)


def _grasp_steps_at(simulation: Simulation, time: float, q: Array) -> StepStability:
    """Return the stability of the plant's steps under grasps and friction, for the payload that is worst."""
    scenario, chain, cell = simulation.scenario, simulation.chain, simulation.scenario.cell
    instants, stabilities = {0.0, *(event.time for event in scenario.events)}, list[StepStability]()
    for surroundings in map(scenario.surroundings_at, instants):
        chain.surround(surroundings)
        A, N = plant_matrix(chain, q, partners=surroundings.partners)
        s, vectors = np.linalg.eig(A)
        modes = N @ vectors[len(A) // 2 :]
        limits = np.array([_ray_limit(entry) for entry in s])
        kinds = {"compliant grasps": cell.compliant, "patches": cell.patches}
        cause = next((kind for kind, grasps in kinds.items() if grasps), "partner")
        stabilities.append(_critical(simulation, time, s, modes, limits, cause))
    chain.surround(cell.surroundings)
    return max(stabilities, key=lambda stability: stability.value / stability.limit)


def plant_matrix(
    chain: CellChain, q: Array, stiffer: float = 1.0, partners: Sequence[Partner] = ()
) -> tuple[Array, Array]:
    """Return the matrix of [y, w] under force elements and friction, and the basis N of the n motions.

    N has shape (nv, n), and v = N w.

    Args:
        chain: Chain of a cell.
        q: Configuration, with the payload at rest.
        stiffer: Factor of all stiffnesses of grasps, at the same damping ratios.
        partners: Partners that hold the payload.
    """
    mechanism, friction = chain.mechanism, chain.transmission.friction
    N, rest = motion_basis(mechanism, q), np.zeros(mechanism.model.nv)
    elements = chain.springs, chain.patches
    K, D = (sum(parts) for parts in zip(*(element.matrices(q) for element in elements), strict=True))
    K, D = stiffer * K, math.sqrt(stiffer) * D
    for partner in partners:
        held = partner_matrices(partner, partner.time, chain.payload_jacobian(q))
        K, D = K + held[0], D + held[1]
    D -= np.column_stack([friction(_SLOW * row) / _SLOW for row in np.eye(len(rest))])
    still = mechanism.forward_dynamics(q, rest, rest).acceleration
    forces = np.hstack((K @ N, D @ N)).T
    response = [mechanism.forward_dynamics(q, rest, force).acceleration - still for force in forces]
    n = N.shape[1]
    return np.vstack((np.eye(n, 2 * n, n), -N.T @ np.column_stack(response))), N


def _ray_limit(pole: complex) -> float:
    """Return the largest ``h |s|`` at which RK4 does not let the mode of a pole s grow."""
    direction = pole / abs(pole) if abs(pole) > _NEUTRAL_POLE else -1.0

    def is_stable(size: float) -> bool:
        x = size * direction
        return abs(1.0 + x + x**2 / 2.0 + x**3 / 6.0 + x**4 / 24.0) <= 1.0 + NEUTRAL

    return edge(is_stable, 0.0, _LONGEST, _LIMIT_ERROR)


def _steps_at(simulation: Simulation, time: float, q: Array) -> StepStability:
    """Return the stability of the plant's steps at a configuration and its time."""
    friction = simulation.chain.transmission.friction
    eigenvalues, modes = np.linalg.eig(damping_matrix(simulation, q, lambda v: friction(_SLOW * v) / _SLOW))
    limits = np.full(len(modes), REAL_STABILITY[simulation.scenario.plant.integrator])
    return _critical(simulation, time, eigenvalues, modes, limits, "friction")


def _stop_steps_at(simulation: Simulation, time: float, q: Array) -> list[StepStability]:
    """Return how well the plant's steps follow a hit of the worst joint of each arm and of the payload.

    A joint on its stop swings at w = sqrt(k W), with W its mobility in the closed chain.
    """
    chain, stabilities = simulation.chain, list[StepStability]()
    rates = chain.stops.rates(chain.joint_mobility(q))
    for place, stops in chain.stops:
        cause, hit = ("payload stops", _PAYLOAD_HIT) if place is chain.model.linked else ("end stops", _HIT)
        limits = hit / np.maximum(1.0, 2.0 * stops.damping_ratio) * np.ones(len(place.angles.names))
        worst, stability = _worst(simulation, time, rates[place.v_slice], limits, cause)
        joint = place.angles.names[worst].replace("payload.", "payload/")
        stabilities.append(stability._replace(joints=(joint,)))
    return stabilities


def _joint_steps_at(simulation: Simulation, time: float, q: Array) -> StepStability:
    """Return the stability of the plant's steps for the modes of a payload of links on limp arms."""
    poles, shapes = simulation.chain.payload_modes(q, arms_move=True)
    limits = np.array([_ray_limit(complex(-abs(s.real), s.imag)) for s in poles])  # limp arms may fall
    worst, stability = _worst(simulation, time, poles, limits, "payload joints")
    joints = simulation.chain.joints.linked.joint_names if simulation.chain.joints else ()
    return stability._replace(joints=(f"payload/{joints[int(np.argmax(np.abs(shapes[:, worst])))]}",))


def _critical(
    simulation: Simulation, time: float, poles: Array, modes: Array, limits: Array, cause: str
) -> StepStability:
    """Return the stability of the plant's steps for the pole that is largest in its limit, rates in 1/s."""
    worst, stability = _worst(simulation, time, poles, limits, cause)
    return stability._replace(joints=fastest_joints(simulation, np.abs(modes[:, worst])))


def _worst(
    simulation: Simulation, time: float, rates: Array, limits: Array, cause: str
) -> tuple[int, StepStability]:
    """Return which rate, 1/s, is largest in its limit, and the stability of the plant's steps for it."""
    clock, worst = simulation.scenario.clock, int(np.argmax(np.abs(rates) / limits))
    value = float(np.abs(rates[worst])) * (clock.period / clock.steps_per_tick)
    return worst, StepStability(value, float(limits[worst]), clock.steps_per_tick, (), time, cause)
