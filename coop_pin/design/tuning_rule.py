"""Tuning rule of the payload-space law along a motion: control rate and gains from the task-space inertia."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.spatial import pose_error
from coop_pin.control import LateForcePath, PayloadSpace, PayloadSpaceGains, PostureGains
from coop_pin.control.bounds import ForcePath, sampled_loop
from coop_pin.description.scenario import Scenario
from coop_pin.design.posture_gains import ROUND_OFF, T_LAMBDA, posture_gains, rounded_down, slowest_lag
from coop_pin.feasibility.internal_moment import internal_moment
from coop_pin.feasibility.reachability import Reachability
from coop_pin.feasibility.task_inertia import MotionWrenches, motion_wrenches, task_inertia
from coop_pin.stability.forecast import Forecast, forecast
from coop_pin.stability.modes import damping_ratio
from coop_pin.stability.sampled_motion import tick_matrix

_DAMPING = 0.58
"""Least damping ratio: ``loop_stability`` asks for 0.55, and springs of postures need something."""
_LESS = 0.99
"""Factor by which pose gain and integral are lowered until no mode is damped less."""
_MODES = 12
"""Eigenvalues of A^-1 K, from the smallest to the largest, that are looked at."""
_POSE_PART = 20.0
"""Fewest ticks in 1 / gamma."""
ANCHOR, _LARGEST_ANCHOR = 0.1, 0.5
_LEAK = 0.2
"""The law's own leak where nothing is measured, 1/s."""
_FASTEST_HZ = 1000.0
"""What the torque interfaces of common robots take."""
_RAISED = 1.25
"""Factor by which g is raised at a time."""
_SQUEEZE_RATE = 10.0
"""Least kappa with which a squeeze comes in, 1/s: all but a hundredth of it in half a second."""
_ON_START = 1e-3
"""Distance and angle of a reference from the start that do not count, m and rad."""
_TRACKING, _FORCE = 2e-4, 0.2
"""Expected error, m, and internal force, N, while moving, for which the rate is raised."""

_MOMENT = 0.05
"""Expected internal moment while moving, N m, for which g is raised: half of what a task allows."""
_ANCHOR_PART = 0.8
"""Part of the anchor's bound that the motion may take."""


class GainProposal(NamedTuple):
    """Gains of the payload-space law at a control rate, and what to expect of them.

    Attributes:
        rate_hz: control rate, Hz.
        gains: gains of the law.
        posture: gains of the spare joints.
        t_lambda_max: T lambda_max(A^-1 K), the largest along the motion.
        lambda_min: smallest eigenvalue of A^-1 K along the motion, 1/s.
        damping: smallest damping ratio of a sampled mode between the two.
        integral_rate: k_I, 1/s.
        anchor_bound: g at which the anchor would be unstable; None if no wrench is measured.
        tracking: error while moving on rigid grasps of slow motions, m, by which rate and gamma are chosen.
        internal_force: error of the internal force while moving, N, likewise; None if none is measured.
        internal_moment: error of the internal moment while moving, N m; None if it is controlled and no
            wrench is measured.
        law: law with gains for each arm, of grasps that give; None for one with ``gains`` for all.
    """

    rate_hz: float
    gains: PayloadSpaceGains
    posture: PostureGains
    t_lambda_max: float
    lambda_min: float
    damping: float
    integral_rate: float
    anchor_bound: float | None
    tracking: float
    internal_force: float | None
    internal_moment: float | None
    law: PayloadSpace | None = None

    def with_anchor_gain(self, g: float) -> GainProposal:
        """Return the proposal of single arms' gains with another g; the internal errors go with 1 / g."""
        assert self.law is not None
        arm_gains = {name: gains.replace(anchor_gain=g) for name, gains in self.law.arm_gains.items()}
        law = self.law.replace(gains=self.gains.replace(anchor_gain=g), arm_gains=arm_gains)
        return self._replace(gains=law.gains, law=law)

    def summary(self) -> str:
        """Return the proposal as text, in one line."""
        g = self.gains
        K = ", ".join(f"{entry:g}" for entry in np.ravel(g.sliding_gain))
        K = f"[{K}]" if self.law is None else "of each arm's own inertia"
        anchor = "leaky" if self.anchor_bound is None else f"anchor_gain {g.anchor_gain:.3g}"
        return (
            f"proposal: {self.rate_hz:g} Hz, payload-space, sliding_gain {K}, pose_gain {g.pose_gain:g},"
            f" sign_gain {g.sign_gain:g} (k_I {self.integral_rate:.3g} /s), {anchor}: T*lambda"
            f" {self.t_lambda_max:.2g}, smallest lambda {self.lambda_min:.3g} /s, damping ratio"
            f" {self.damping:.2f}"
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
        least_stiffness: stiffness of the posture's spring, N m/rad: what holds the spare joints against
            gravity.
    """
    inertia = task_inertia(scenario, cell_reach)
    scale = 1.0 / np.diagonal(inertia.mobility, axis1=1, axis2=2).max(axis=0)
    root = np.sqrt(scale)
    eigenvalues = np.linalg.eigvalsh(root[:, None] * inertia.mobility * root)
    largest = float(eigenvalues.max())
    spread = largest, max(float(eigenvalues.min()), ROUND_OFF * largest)
    at_rate = partial(_at_rate, scenario, scale, spread)
    proposal, wrenches = accurate_proposal(scenario, cell_reach, least_stiffness, at_rate)
    proposal = _anchored_faster(proposal, scenario, wrenches)
    if scenario.cell.task_rows.has_moments:
        return proposal
    moment = internal_moment(scenario, cell_reach, proposal.posture).moment  # no anchor acts on it
    return proposal._replace(internal_moment=moment)


def _anchored_faster(proposal: GainProposal, scenario: Scenario, wrenches: MotionWrenches) -> GainProposal:
    """Return the proposal with g raised, up to 0.5 and a quarter of its bound, if an error is too large."""
    force, moment, bound = proposal.internal_force, proposal.internal_moment, proposal.anchor_bound
    if force is None or moment is None or bound is None:
        return proposal
    g, largest = proposal.gains.anchor_gain, rounded_down(min(_LARGEST_ANCHOR, bound / 4.0))
    while (force > _FORCE or moment > _MOMENT) and g < largest:
        g = min(largest, rounded_down(_RAISED * g))
        force, moment = expected_internal_errors(scenario, wrenches, g * proposal.rate_hz)
        gains = proposal.gains.replace(anchor_gain=g)
        proposal = proposal._replace(gains=gains, internal_force=force, internal_moment=moment)
    return proposal


def _at_rate(
    scenario: Scenario,
    scale: Array,
    spread: tuple[float, float],
    rate: float,
    posture: PostureGains,
    wrenches: MotionWrenches,
) -> GainProposal:
    """Return the gains at a control rate; spread is that of the eigenvalues of A^-1 diag(scale)."""
    T, path = 1.0 / rate, force_path_of(scenario)
    factor = T_LAMBDA / (spread[0] * (T + 2.0 * slowest_lag(scenario)))
    K = np.array([rounded_down(factor * entry) for entry in scale])
    lambda_min = float(np.min(K / scale)) * spread[1]
    t_lambda_max = T * float(np.max(K / scale)) * spread[0]
    width = PayloadSpace.model_fields["switching"].default.width
    damping = sampled_damping(T * lambda_min, t_lambda_max, slowest_lag(scenario) / T)
    gamma, k_I = damped(
        damping, min(lambda_min / 4.0, rate / _POSE_PART), min(lambda_min / 2.0, rate / 4.0), T
    )
    gamma, alpha = rounded_down(gamma), rounded_down(width * k_I)
    kappa = squeeze_rate(scenario, gamma, rate)
    k_I, force, moment = alpha / width, None, None
    linear = scenario.cell.task_rows.are_linear
    tracking = float(np.linalg.norm(wrenches.tracking(K, gamma, k_I)[:, linear], axis=1).max())
    if not path.measures:
        sag = np.abs(wrenches.load - wrenches.load[0]).max(axis=0) / (K * gamma * (1.0 + k_I / _LEAK))
        tracking = max(tracking, float(np.linalg.norm(sag[linear])))
    bound, g = anchor_of(scenario, T)
    if bound is not None:
        force, moment = expected_internal_errors(scenario, wrenches, g * rate)
    gains = PayloadSpaceGains(
        pose_gain=gamma, sliding_gain=tuple(K), sign_gain=alpha, anchor_gain=g, transient_rate=kappa
    )
    return GainProposal(
        rate_hz=rate,
        gains=gains,
        posture=posture,
        t_lambda_max=t_lambda_max,
        lambda_min=lambda_min,
        damping=damping(T * gamma, T * k_I),
        integral_rate=k_I,
        anchor_bound=bound,
        tracking=tracking,
        internal_force=force,
        internal_moment=moment,
    )


def anchor_of(scenario: Scenario, period: float) -> tuple[float | None, float]:
    """Return the g at which the anchor is unstable, None without measured wrenches, and one below it."""
    path, lag = force_path_of(scenario), scenario.actuator_lag * scenario.clock.period / period
    if not path.measures:
        return None, ANCHOR
    bound = sampled_loop(path, scenario.wrists, lag).anchor_bound
    return bound, min(ANCHOR, rounded_down(bound / 4.0))


def sampled_damping(slowest: float, fastest: float, lag: float) -> Callable[[float, float], float]:
    """Return the smallest damping ratio of modes between two T lambda, by T gamma and T k_I; lag in ticks."""
    return partial(_least_damping, np.geomspace(slowest, fastest, _MODES), lag=lag)


def damped(
    damping: Callable[[float, float], float], gamma: float, k_I: float, period: float
) -> tuple[float, float]:
    """Return gamma and k_I, 1/s, lowered until every mode is damped enough."""
    enough = min(_DAMPING, _LESS * damping(0.0, 0.0))  # lags may leave less to the damping alone
    while damping(period * gamma, period * k_I) < enough:
        gamma, k_I = _LESS * gamma, _LESS * k_I
    return gamma, k_I


def squeeze_rate(scenario: Scenario, gamma: float, rate: float) -> float:
    """Return kappa, 1/s: faster than gamma where only the squeeze comes in with it."""
    begin = np.array(scenario.payload_motion.at(0.0).X_WP_d)
    starts_on_motion = float(np.abs(pose_error(scenario.start.matrix, begin)).max()) < _ON_START
    return max(gamma, min(_SQUEEZE_RATE, rate / 4.0)) if starts_on_motion else gamma


def _least_damping(rates: Array, gamma: float, k_I: float, *, lag: float) -> float:
    """Return the smallest damping ratio of sampled modes; rates lambda, gamma, k_I and lag in ticks."""
    law = np.array([[gamma, 1.0]])
    return min(
        damping_ratio(z)
        for rate in rates
        for z in np.linalg.eigvals(tick_matrix(-rate * law, -rate * k_I * law, 1.0, lag=lag))
    )


def expected_internal_errors(
    scenario: Scenario, wrenches: MotionWrenches, anchor_rate: float
) -> tuple[float, float]:
    """Return the largest errors of the internal force and moment of an arm, N and N m."""
    errors, linear = wrenches.internal_error(anchor_rate), scenario.cell.task_rows.are_linear
    force, moment = (np.linalg.norm(errors[..., rows], axis=-1).max() for rows in (linear, ~linear))
    return float(force), float(moment)


def accurate_proposal(
    scenario: Scenario,
    cell_reach: Reachability,
    least_stiffness: float,
    at_rate: Callable[[float, PostureGains, MotionWrenches], GainProposal],
    tips_give: bool = False,
) -> tuple[GainProposal, MotionWrenches]:
    """Return the proposal at the first control rate at which it is accurate, and what the motion asks of it.

    The rates are the scenario's, and its multiples where no delay or sensor is counted in its ticks.
    """
    stated, path = scenario.clock.rate_hz, scenario.controller.force_path
    timed = bool(scenario.wrists or path.delay or path.pole)
    fastest = stated if timed else max(stated, _FASTEST_HZ)
    wrenches = cache(partial(motion_wrenches, scenario, cell_reach))
    for count in range(1, int(fastest / stated) + 1):
        posture = posture_gains(scenario, cell_reach, 1.0 / (stated * count), least_stiffness, tips_give)
        proposal = at_rate(stated * count, posture, wrenches(posture))
        if proposal.tracking <= _TRACKING and (proposal.internal_force or 0.0) <= _FORCE:
            break
    return proposal, wrenches(posture)


def force_path_of(scenario: Scenario) -> ForcePath:
    """Return the scenario's force path; the latest wrench where it has none but all wrists have sensors.

    The virtual linkage splits the load of patches, which bear hardly any moment.
    """
    path = scenario.controller.force_path
    if not path.measures and len(scenario.wrists) == len(scenario.cell.arms):
        path = LateForcePath()
    return path.replace(split="virtual-linkage") if scenario.cell.patches and path.by_sensors else path


def anchored_enough(scenario: Scenario, cell_reach: Reachability) -> tuple[Scenario, Forecast]:
    """Return the scenario with an anchor's bound that has what the motion asks of it, and the forecast."""
    law: Any = scenario.controller
    errors, width = forecast(scenario, cell_reach), law.switching.width
    needed, twice = np.divide(errors.anchor, _ANCHOR_PART), 2.0 * float(np.max(law.gains.pose_gain))
    if law.anchor_bias == "none" or not np.greater(needed, np.minimum(law.anchor_bias, width / twice)).any():
        return scenario, errors
    b_0 = np.add(PayloadSpace.model_fields["anchor_bias"].default, needed)
    wider = max(width, twice * float(b_0.max())) / width

    def widened(gains: PayloadSpaceGains) -> PayloadSpaceGains:
        return gains.replace(sign_gain=gains.sign_gain * wider)

    law = law.replace(
        anchor_bias=tuple(b_0.round(6).tolist()),
        anchor_bias_answered=tuple(np.maximum(b_0, law.anchor_bias_answered).round(6).tolist()),
        switching=law.switching.replace(width=width * wider),
        gains=widened(law.gains),
        arm_gains={name: widened(gains) for name, gains in law.arm_gains.items()},
    )
    scenario = scenario.replace(controller=law)
    return scenario, forecast(scenario, cell_reach)
