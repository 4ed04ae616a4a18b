"""Gains of cells with tools, of each arm alone, and with joints and links, in the rows of each grasp."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.base.spatial import FullRows, spatial_inertia
from coop_pin.control import PostureGains
from coop_pin.control.laws.payload_space import PayloadSpace
from coop_pin.control.laws.payload_space_controller import PayloadSpaceGains
from coop_pin.control.laws.symmetric import Symmetric
from coop_pin.description.scenario import Scenario
from coop_pin.design.own_inertia import own_inertia
from coop_pin.design.posture_gains import (
    T_LAMBDA,
    base_posture_gains,
    posture_gains,
    rounded_down,
    slowest_lag,
    stands_on_bases,
)
from coop_pin.design.tuning_rule import anchor_of, damped, force_path_of, sampled_damping, squeeze_rate
from coop_pin.feasibility.reachability import Reachability
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.closed_loop import pressed_loop
from coop_pin.stability.sampled_stability import damping_rates, motion_stability
from coop_pin.stability.step_stability import step_stability

_KAPPA, _ALONG = 0.5, 0.9
"""T lambda of each arm alone at the start, and the largest along the motion; 2 is unstable."""
_INTEGRAL, _POSE = 0.4, 0.1
"""k_I and gamma as parts of the smallest lambda."""
_STEP_PART = 0.9
"""Part of the stability limit of the plant's steps that friction may take at the poses that are looked at."""
_ANCHORS = 1.0, 0.3, 0.1
"""Parts of the anchor's gain that are tried: links answer its forces late, hinges by a turn unseen."""
_SEEN = 1e-6
"""Part of the largest lambda above which a direction is moved."""


def with_tool_gains(scenario: Scenario, cell_reach: Reachability) -> tuple[Scenario, str]:
    """Return the scenario with the symmetric law and gains of single arms, and what limits them.

    ::

        G_i = c_i K_i = kappa / (T max(1, rho)) Lambda_i(q_0)      in payload axes, turned with the payload
        k_I = 0.4 lambda_min,  gamma = 0.1 lambda_min              or lower, for a damping ratio of 0.58

    With the inertias Lambda_i of arms alone the absolute and the relative motion of two tools would decouple,
    at kappa / T and rho kappa / T; what the payload adds to its arms makes their lambda smaller.

    Args:
        scenario: Cell with tools, motion and clock; rho is that of its law, if that is symmetric.
        cell_reach: Reachability of the scenario, in which every arm holds the start.

    Raises:
        InfeasibleMotionError: cause "stability": rho is 0, which leaves the relative pose to itself.
    """
    cell, law, T = scenario.cell, scenario.controller, scenario.clock.period
    rho = law.relative_gain if isinstance(law, Symmetric) else 1.0
    if rho == 0.0:
        detail = "controller.relative_gain is 0: nothing keeps a tool on its path; state one above 0"
        raise InfeasibleMotionError("stability", detail)
    inertia, lag, rows = own_inertia(scenario, cell_reach).arms, slowest_lag(scenario), cell.task_rows.indices
    first, payload = inertia[:, 0], cell.payload
    alone = float(np.linalg.eigvals(np.linalg.solve(inertia, first[:, None])).real.max())
    kappa = rounded_down(min(_KAPPA, _ALONG / alone) * T / (T + 2.0 * lag))
    G = kappa / (T * max(1.0, rho)) * first
    holds = np.array([name not in cell.tools for name in cell.arms])
    M_0 = spatial_inertia(payload.mass, payload.inertia_matrix, np.eye(3))[np.ix_(rows, rows)]
    held = np.linalg.eigvals(np.linalg.solve(M_0 + first[holds].sum(axis=0), G[holds].sum(axis=0))).real
    slowest, fastest = float(held.min()) * min(1.0, rho), kappa / T
    damping = sampled_damping(T * slowest, T * fastest, lag / T)
    gamma, k_I = map(rounded_down, damped(damping, _POSE * slowest, _INTEGRAL * slowest, T))
    width = Symmetric.model_fields["switching"].default.width
    gains: dict[str, Any] = {
        name: PayloadSpaceGains(
            pose_gain=gamma,
            sliding_gain=(G_i / c).round(9).tolist(),
            sign_gain=width * k_I,
            leak=0.0 if holds.sum() == 1 else None,  # views of one holder have nothing to pull against
            transient_rate=2.0 * gamma,
        )
        for name, G_i, c in zip(cell.arms, G, cell.gain_shares, strict=True)
    }
    posture = posture_gains(scenario, cell_reach, T, tips_give=True)
    proposal = Symmetric(
        relative_gain=rho,
        gains=next(iter(gains.values())),
        arm_gains=gains,
        gain_axes="payload",
        posture=posture,
        force_path=law.force_path,
    )
    sentence = (
        f"gains of each arm alone: T lambda {kappa:.3g} at the start and {kappa * alone:.3g} at most, of 2;"
        f" smallest lambda {slowest:.3g} /s with the payload, pose_gain {gamma:g} /s, k_I {k_I:g} /s"
    )
    return scenario.replace(controller=proposal), sentence


def with_joint_gains(scenario: Scenario, cell_reach: Reachability) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario with the payload-space law in the rows of each grasp, and its limits.

    ::

        K = k diag(1, 1, 1, l^2, l^2, l^2),  T lambda_max = 0.9
        k_I = lambda_min / 2,  gamma = lambda_min / 4                       or lower, damped

    with the eigenvalues lambda of the damping matrix D of the closed chain along the motion. Where the load
    is split, l is ``split_length``, so that the terms of the motion leave no internal wrench; else both parts
    of K have the same lambda_max. Where an arm holds another link than that of P, it bears the law by itself
    as the links give: K is that about each arm's own tip. Deflections of links are no biases:
    ``zero_at_grasp``. The anchor is lowered until the loop holds, beside hinges under the squeeze. The
    damping of joints that a grasp makes spare has T D / I of 0.9 with the inertia I of what they move alone.

    Args:
        scenario: Cell with joints or a payload of several links, motion and clock.
        cell_reach: Reachability of the scenario, in which every arm can follow.

    Raises:
        InfeasibleMotionError: cause "stability": the sampled loop grows.
    """
    cell, T, lag = scenario.cell, scenario.clock.period, slowest_lag(scenario)
    linear = cell.task_rows.are_linear

    def rates_of(unit: Array) -> Array:
        law = _law(scenario, unit, {"pose_gain": 1.0, "sign_gain": 0.0, "transient_rate": 1.0})
        still = law.replace(posture=PostureGains(stiffness=0.0, damping=0.0))
        return damping_rates(_simulation(scenario.replace(controller=still)), cell_reach)

    square = cell.split_length**2
    if not cell.splits_load:
        alone = [
            float(rates_of(np.where(linear == is_linear, 1.0, _SEEN)).max()) for is_linear in (True, False)
        ]
        square = alone[0] / alone[1]
    unit = np.where(linear, 1.0, square)
    rates = rates_of(unit)
    k = rounded_down(T_LAMBDA / ((T + 2.0 * lag) * float(rates.max())))
    slowest, fastest = k * float(rates[rates > _SEEN * rates.max()].min()), k * float(rates.max())
    damping = sampled_damping(T * slowest, T * fastest, lag / T)
    gamma, k_I = map(rounded_down, damped(damping, slowest / 4.0, min(slowest / 2.0, 0.25 / T), T))
    gains = {
        "pose_gain": gamma,
        "sign_gain": round(PayloadSpace.model_fields["switching"].default.width * k_I, 9),
        "transient_rate": squeeze_rate(scenario, gamma, scenario.clock.rate_hz),
    }
    of_drives = base_posture_gains if stands_on_bases(scenario) else posture_gains
    posture = of_drives(scenario, cell_reach, T)
    for part in _ANCHORS:
        law = _law(scenario, k * unit, gains | {"anchor_gain": part * anchor_of(scenario, T)[1]})
        suggested = with_steps(scenario.replace(controller=law.replace(posture=posture)), cell_reach)
        if (loop := pressed_loop(suggested)).ok:
            break
    along = motion_stability(_simulation(suggested), cell_reach)
    if not (along.ok and loop.ok):
        raise InfeasibleMotionError("stability", (loop if along.ok else along).summary())
    limits = [f"sliding_gain: T lambda {T * fastest:.3g}, smallest {slowest:.3g} /s, l = {square**0.5:.3g} m"]
    if any(B.shape[1] < arm.q.shape[1] for B, arm in zip(cell.transmitted(), cell_reach.arms, strict=True)):
        limits += [f"posture damping {posture.damping} N m s/rad, by the inertia of spare joints"]
    return suggested, (*limits, *(each.summary() for each in (along, loop)))


def _law(scenario: Scenario, K: Array, gains: Mapping[str, Any]) -> PayloadSpace:
    """Return the law with the diagonal K about P, or about each tip where an arm holds another link."""
    cell, of_arms = scenario.cell, dict[str, PayloadSpaceGains]()
    links, rows = cell.payload.links, cell.task_rows.indices
    if links is not None and {*cell.held_links.values()} - {links.link}:
        for name in cell.arms:
            A = FullRows().twist_shift(cell.grasps[name].matrix[:3, 3])[np.ix_(rows, rows)]
            of_arms[name] = PayloadSpaceGains(sliding_gain=((A.T * K) @ A).round(9).tolist(), **gains)
    # Links bend, and bases turn as they drive: a larger bias than the anchor's usual bound allows.
    has_bound = links is None and not stands_on_bases(scenario)
    return PayloadSpace(
        gains=PayloadSpaceGains(sliding_gain=tuple(K.round(9).tolist()), **gains),
        arm_gains=of_arms,
        gain_axes="payload" if of_arms else "world",
        force_path=force_path_of(scenario),
        zero_at_grasp=scenario.controller.near_rest.is_zeroed or links is not None,
        anchor_bias=PayloadSpace.model_fields["anchor_bias"].default if has_bound else "none",
    )


def with_steps(scenario: Scenario, cell_reach: Reachability) -> Scenario:
    """Return the scenario with as many steps in a tick as friction and joints of the payload ask for."""
    steps = step_stability(_simulation(scenario), cell_reach)
    count = math.ceil(steps.steps_per_tick * steps.value / (_STEP_PART * steps.limit))
    return scenario.override({"clock.steps_per_tick": count}) if count > steps.steps_per_tick else scenario


def _simulation(scenario: Scenario) -> Simulation:
    return Simulation(scenario, build_controller(scenario))
