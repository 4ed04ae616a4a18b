"""Stability of a plant's steps: under joint friction, grasps that give, payload joints and end stops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.bisection import edge
from coop_pin.description.events import Partner
from coop_pin.feasibility.reachability import Reachability
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.grasps.spring_damper import partner_matrices
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.modes import NEUTRAL, damping_matrix, fastest_joints, motion_basis
from coop_pin.stability.sampled_stability import start_and_later

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
    for slot, stops in chain.stops:
        cause, hit = ("payload stops", _PAYLOAD_HIT) if slot is chain.model.linked else ("end stops", _HIT)
        limits = hit / np.maximum(1.0, 2.0 * stops.damping_ratio) * np.ones(len(slot.angles.names))
        worst, stability = _worst(simulation, time, rates[slot.v_slice], limits, cause)
        joint = slot.angles.names[worst].replace("payload.", "payload/")
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
