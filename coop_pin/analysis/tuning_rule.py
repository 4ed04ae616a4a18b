"""Tuning rule of the payload-space law along a motion: control rate and gains from the task-space inertia."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from coop_pin.analysis.internal_moment import internal_moment
from coop_pin.analysis.reachability import Reachability
from coop_pin.analysis.task_inertia import motion_wrenches, task_inertia
from coop_pin.arrays import Array, typed
from coop_pin.control.force_path import ForcePath, LateForcePath, sampled_loop
from coop_pin.control.law import PostureGains
from coop_pin.control.payload_space import PayloadSpace, PayloadSpaceGains
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_arm import CellArm

_T_LAMBDA = 0.9
"""T lambda_max(A^-1 K): the rule allows 1, and the poses between those that are looked at need something."""
_BASE_POSTURE = PostureGains(stiffness=160.0, damping=80.0)
"""Null-space gains of arms on mobile bases: their spring moves the mass of the base."""
_ROUND_OFF = 1e-9
_POSE_PART = 20.0
"""Fewest ticks in 1 / gamma."""
_ANCHOR, _LARGEST_ANCHOR = 0.1, 0.5
_LEAK = 0.2
"""The law's own leak where nothing is measured, 1/s."""
_FASTEST_HZ = 1000.0
"""What the torque interfaces of common robots take."""
_TRACKING, _FORCE = 2e-4, 0.2
"""Expected error, m, and internal force, N, while moving, for which the rate is raised."""


class GainProposal(NamedTuple):
    """Gains of the payload-space law at a control rate, and what to expect of them.

    Attributes:
        rate_hz: control rate, Hz.
        gains: gains of the law.
        posture: gains of the spare joints.
        t_lambda_max: T lambda_max(A^-1 K), the largest along the motion.
        lambda_min: smallest eigenvalue of A^-1 K along the motion, 1/s.
        integral_rate: k_I, 1/s.
        anchor_bound: g at which the anchor would be unstable; None if no wrench is measured.
        tracking: error to expect while moving, m.
        internal_force: error of the internal force to expect while moving, N; None if none is measured.
        internal_moment: error of the internal moment to expect while moving, N m; None if it is controlled
            and no wrench is measured.
    """

    rate_hz: float
    gains: PayloadSpaceGains
    posture: PostureGains
    t_lambda_max: float
    lambda_min: float
    integral_rate: float
    anchor_bound: float | None
    tracking: float
    internal_force: float | None
    internal_moment: float | None

    def summary(self) -> str:
        """Return the proposal as text, in one line."""
        g = self.gains
        K = ", ".join(f"{entry:g}" for entry in np.ravel(g.sliding_gain))
        anchor = "leaky" if self.anchor_bound is None else f"anchor_gain {g.anchor_gain:.3g}"
        force = "" if self.internal_force is None else f", {self.internal_force:.2g} N"
        force += "" if self.internal_moment is None else f", {self.internal_moment:.2g} N m"
        return (
            f"proposal: {self.rate_hz:g} Hz, payload-space, sliding_gain [{K}], pose_gain {g.pose_gain:g},"
            f" sign_gain {g.sign_gain:g} (k_I {self.integral_rate:.3g} /s), {anchor}: T*lambda"
            f" {self.t_lambda_max:.2g}, smallest lambda {self.lambda_min:.3g} /s; to expect while moving"
            f" {1e3 * self.tracking:.2g} mm{force}"
        )


@typed
def gain_proposal(
    scenario: Scenario, cell_reach: Reachability, *, least_stiffness: float = 0.0
) -> GainProposal:
    """Return the gains by the tuning rule at the configurations of a scenario's reachability.

    K is diagonal, with the entries 1 / max (A^-1)_jj along the motion times one factor: the condition of
    A^-1 K is then at most k_0 times the best that a diagonal K can have (van der Sluis, 1969).

    Args:
        scenario: cell, motion, sensors and clock.
        cell_reach: reachability of the scenario, in which every arm holds the start.
        least_stiffness: of the posture's spring, N m/rad: what holds the spare joints against gravity.
    """
    inertia = task_inertia(scenario, cell_reach)
    scale = 1.0 / np.diagonal(inertia.mobility, axis1=1, axis2=2).max(axis=0)
    root = np.sqrt(scale)
    eigenvalues = np.linalg.eigvalsh(root[:, None] * inertia.mobility * root)
    largest = float(eigenvalues.max())
    spread = largest, max(float(eigenvalues.min()), _ROUND_OFF * largest)
    for rate in _rates(scenario):
        proposal = _at_rate(scenario, cell_reach, scale, spread, rate, least_stiffness)
        if proposal.tracking <= _TRACKING and (proposal.internal_force or 0.0) <= _FORCE:
            break
    proposal = _anchored_faster(proposal)
    if scenario.cell.task_rows.has_moments:
        return proposal
    moment = internal_moment(scenario, cell_reach, proposal.posture).moment  # no anchor acts on it
    return proposal._replace(internal_moment=moment)


def _anchored_faster(proposal: GainProposal) -> GainProposal:
    """Return the proposal with g raised, up to 0.5 and a quarter of its bound, if the force is too large."""
    force, bound = proposal.internal_force, proposal.anchor_bound
    if force is None or bound is None or force <= _FORCE:
        return proposal
    g = proposal.gains.anchor_gain
    raised = max(g, _rounded_down(min(_LARGEST_ANCHOR, bound / 4.0, g * force / _FORCE)))
    gains = proposal.gains.replace(anchor_gain=raised)
    part, moment = g / raised, proposal.internal_moment or 0.0
    return proposal._replace(gains=gains, internal_force=force * part, internal_moment=moment * part)


def _at_rate(
    scenario: Scenario,
    cell_reach: Reachability,
    scale: Array,
    spread: tuple[float, float],
    rate: float,
    least_stiffness: float,
) -> GainProposal:
    """Return the gains at a control rate; spread is that of the eigenvalues of A^-1 diag(scale)."""
    T, path = 1.0 / rate, force_path_of(scenario)
    posture = _posture_gains(scenario, cell_reach, T, least_stiffness)
    wrenches = motion_wrenches(scenario, cell_reach, posture)
    factor = _T_LAMBDA / (spread[0] * (T + 2.0 * _lag(scenario)))
    K = np.array([_rounded_down(factor * entry) for entry in scale])
    lambda_min = float(np.min(K / scale)) * spread[1]
    gamma = _rounded_down(min(lambda_min / 4.0, rate / _POSE_PART))
    width = PayloadSpace.model_fields["switching"].default.width
    alpha = _rounded_down(width * min(lambda_min / 2.0, rate / 4.0))
    k_I, bound = alpha / width, None
    if not path.measures:
        force, rest = None, wrenches.load_range / (K * gamma * (1.0 + k_I / _LEAK))
        tracking = np.maximum(wrenches.load_rate / (K * gamma * k_I), rest)
    else:
        lag = scenario.actuator_lag * scenario.clock.period / T
        bound = sampled_loop(path, scenario.wrists, lag).anchor_bound
        tracking = wrenches.load_rate / (K * gamma * k_I)
    g = _ANCHOR if bound is None else min(_ANCHOR, _rounded_down(bound / 4.0))
    linear = np.array(scenario.cell.task_rows.indices) < 3
    moment = None
    if bound is not None:
        errors = wrenches.internal_rate * T / g
        force, moment = float(np.linalg.norm(errors[linear])), float(np.linalg.norm(errors[~linear]))
    gains = PayloadSpaceGains(
        pose_gain=gamma, sliding_gain=tuple(K), sign_gain=alpha, anchor_gain=g, transient_rate=gamma
    )
    return GainProposal(
        rate_hz=rate,
        gains=gains,
        posture=posture,
        t_lambda_max=T * float(np.max(K / scale)) * spread[0],
        lambda_min=lambda_min,
        integral_rate=k_I,
        anchor_bound=bound,
        tracking=float(np.linalg.norm(tracking[linear])),
        internal_force=force,
        internal_moment=moment,
    )


def _rates(scenario: Scenario) -> Iterator[float]:
    """Yield the scenario's rate, and its multiples where no delay or sensor is counted in its ticks."""
    stated, path = scenario.clock.rate_hz, scenario.controller.force_path
    timed = bool(scenario.wrists or path.delay or path.pole)
    fastest = stated if timed else max(stated, _FASTEST_HZ)
    yield from (stated * count for count in range(1, int(fastest / stated) + 1))


def _lag(scenario: Scenario) -> float:
    """Return the largest time constant between a velocity and the torque that answers it, s."""
    arms = scenario.cell.arms
    cutoffs = [getattr(scenario.sensors_of(name).velocity, "cutoff_hz", np.inf) for name in arms]
    bands = [getattr(scenario.sensors_of(name).velocity, "bandwidth_hz", np.inf) for name in arms]
    filters = [1.0 / (2.0 * np.pi * cutoff) for cutoff in (*cutoffs, *bands)]
    return float(max((*filters, *(scenario.actuators_of(name).lag for name in arms))))


def force_path_of(scenario: Scenario) -> ForcePath:
    """Return the scenario's force path; the latest wrench where it has none but all wrists have sensors."""
    path = scenario.controller.force_path
    if not path.measures and len(scenario.wrists) == len(scenario.cell.arms):
        return LateForcePath()
    return path


def _posture_gains(
    scenario: Scenario, cell_reach: Reachability, T: float, least_stiffness: float
) -> PostureGains:
    """Return null-space gains, at most the usual ones but for a spring that has to be stiffer.

    The damping keeps T lambda below 0.9 with the payload held, and the spring is lowered with it. At
    rest the spring takes no more torque than gravity asks for, however stiff it is.
    """
    on_base = any(arm.base_joints for arm in scenario.cell.arms.values())
    usual, decay = _BASE_POSTURE if on_base else PostureGains(), 0.0
    for reach in cell_reach.arms:
        arm = CellArm(scenario.cell, reach.arm)
        if arm.nv == arm.rows.size:
            continue
        for q in reach.q[:: max(1, len(reach.q) // 20)]:
            U = np.linalg.svd(arm.null_space(q))[0][:, : arm.nv - arm.rows.size]
            spare = arm.from_drive @ U  # joint rates with the payload held
            decay = max(decay, 1.0 / float(np.linalg.eigvalsh(spare.T @ arm.mass_matrix(q) @ spare)[0]))
    stiffness, damping = float(np.max(usual.stiffness)), float(np.max(usual.damping))
    if decay > 0.0:
        damping = min(damping, _rounded_down(_T_LAMBDA / ((T + 2.0 * _lag(scenario)) * decay)))
    stiffness *= damping / float(np.max(usual.damping))
    return PostureGains(stiffness=max(stiffness, least_stiffness), damping=damping)


def _rounded_down(value: float) -> float:
    """Return a positive value with three significant digits, not above it."""
    digits = 2 - math.floor(math.log10(value))
    scaled = value * 10.0**digits
    return float(f"{math.floor(scaled * (1.0 + 1e-12)) / 10.0**digits:.6g}")
