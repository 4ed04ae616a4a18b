"""Limits of a proposal, as lines for people to read: rate, gains, friction, null space, moments, postures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coop_pin.control import PayloadSpace
from coop_pin.description.scenario import Scenario
from coop_pin.design.tuning_rule import GainProposal, force_path_of
from coop_pin.feasibility.least_squeeze import least_squeeze
from coop_pin.feasibility.motion_feasibility import PostureMargin
from coop_pin.stability.loop_stability import LoopStability


def friction_limits(scenario: Scenario) -> Iterator[str]:
    """Yield squeeze, split and guards of patches."""
    law: Any = scenario.controller
    if not scenario.cell.patches or (least := least_squeeze(scenario)) is None:
        return
    yield least.summary()
    yield (
        f"split of the load: {law.force_path.split}; a patch bears no moments of equal shares"
        if law.measures
        else "force path: none, so that nothing keeps the squeeze: add --controller.force-path.kind late"
    )
    normal = f", and below {law.normal_guard:.3g} N at its own wrist" if law.normal_guard else ""
    yield f"guards: an arm gives up its squeeze at {1e3 * law.slip_guard:.3g} mm of slip{normal}"


def gain_limits(scenario: Scenario, proposal: GainProposal, suggested: Scenario) -> Iterator[str]:
    """Yield what limits rate and gains."""
    stated, T, law = scenario.clock.rate_hz, 1.0 / proposal.rate_hz, suggested.controller
    assert isinstance(law, PayloadSpace)
    kept = "as stated" if proposal.rate_hz == stated else f"raised from {stated:g} Hz"
    yield f"rate: {kept}; the error to expect while moving grows with T^3, the internal force with T"
    if proposal.law is None:
        yield f"K: by T lambda_max(A^-1 K) = {proposal.t_lambda_max:.2g} <= 1 along the motion"
        parts = "half", "a quarter"
    else:
        yield (
            f"K: by T lambda_max(Lambda_i^-1 c_i K_i) = {proposal.t_lambda_max:.2g} of each arm alone along"
            f" the motion{', or by the table' * bool(scenario.put_downs)}; it is 2 where a soft grasp lets"
            " the arm go unstable"
        )
        if law.knows_deflection:
            yield "knows_deflection: the arms give up no squeeze to what it deflects"
        parts = "0.4", "a tenth to a fortieth"
    yield (
        f"k_I: {proposal.integral_rate:.3g} /s, by {parts[0]} of lambda_min = {proposal.lambda_min:.3g} /s"
        f" and by 1 / (4 T) = {0.25 / T:.3g} /s; gamma by {parts[1]} of lambda_min; both by the damping ratio"
        f" of the sampled modes, {proposal.damping:.2f}"
    )
    if proposal.anchor_bound is None:
        yield (
            "force path: none, so that the integral leaks; weight and bias leave an internal force. Where a"
            " wrist wrench is measured, add --controller.force-path.kind late: the law is anchored then"
        )
    else:
        kind, g = force_path_of(scenario).kind, proposal.gains.anchor_gain
        yield f"force path: {kind}; g {g:.3g}, unstable from {proposal.anchor_bound:.3g} on"
        bias = law.anchor_bias
        yield (
            "anchor_bias: none, by the put-down: a bounded anchor would keep the load that the table gets"
            if bias == "none"
            else f"anchor_bias: {1e3 * bias[0]:.3g} mm and {1e3 * bias[1]:.3g} mrad, by the usual bias,"
            " deflections and what the measured wrenches move along the motion"
        )


def null_space_limits(proposal: GainProposal, loop: LoopStability) -> Iterator[str]:
    """Yield what limits the posture's gains, where there are spare joints."""
    if loop.spare is not None:
        posture = proposal.posture
        yield (
            f"null space: stiffness {posture.stiffness:g}, damping {posture.damping:g}; the"
            f" {loop.spare.name} decays with {loop.spare_rate:.3g} /s or faster along the motion"
        )


def moment_limits(scenario: Scenario, proposal: GainProposal) -> Iterator[str]:
    """Yield the internal moment of positional rows, which nothing limits."""
    if not scenario.cell.controls_turns:
        yield (
            f"internal moment: up to {proposal.internal_moment:.3g} N m beside the desired one; no task row"
            " controls it, weights, friction and springs of postures decide"
        )


def posture_limit(margin: PostureMargin) -> str:
    """Return what limits the posture of an arm."""
    torque, position, singularity = (100.0 * part for part in margin[1:])
    return (
        f"posture of {margin.arm}: {torque:.0f} % of the torque, {position:.0f} % of the joint range and"
        f" {singularity:.0f} % of the condition number are left"
    )
