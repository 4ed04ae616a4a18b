"""Steady errors of a law: internal force under a kinematic bias, sag under a load, and what the law needs."""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import as_positive, require_type
from coop_pin.chain.cell_chain import CellChain
from coop_pin.control import Switching
from coop_pin.control.bounds import force_loop_is_stable
from coop_pin.control.terms import gain_matrix, jacobian_inverse
from coop_pin.description.controller import Law, NoForcePath, PayloadSpace, SlidingMode, UserController
from coop_pin.description.controller_checks import sampled_loop
from coop_pin.description.scenario import Scenario
from coop_pin.errors import ArgumentError
from coop_pin.model.cell_arm import CellArm

_LARGEST_DELAY = 200
"""A loop that is stable at this delay, ticks, counts as stable at any."""
_LARGEST_SAG = 1.0
"""A load that is not carried within it counts as dropped, m."""


class SteadyErrors(NamedTuple):
    """Steady errors of a law at rest, and what it needs.

    Attributes:
        needs: quantities that the law measures, besides joint positions and velocities.
        wrenches: that cross between the arms at each tick.
        delay: largest further delay of the measured wrench at which its feedback is stable, ticks; inf for
            any, or if no wrench is fed back; -1 if it is unstable as it is.
        bias: kinematic bias of the position of one arm's tip, m.
        load: constant force on the payload that the law does not know, N.
        force: internal force that the bias leaves, N; inf if it grows; NaN for law (23) with redundant arms.
        sag: position error that the load leaves, m; inf if it is dropped; NaN likewise.
        product: c (1 - c) b D, which force times (sag + bias) of no law of these measurements stays below for
            all loads up to D; force times sag of a linear one is exactly this, N m.
        balanced: the anchor gain with which the load sags as far as the bias moves the payload, c b, which
            leaves (1 - c) D of internal force; NaN but for the own-wrist law.
    """

    needs: str
    wrenches: int
    delay: float
    bias: float
    load: float
    force: float
    sag: float
    product: float
    balanced: float

    def summary(self) -> str:
        """Return the errors as text."""
        crossing = f"{self.wrenches} wrenches cross" if self.wrenches else "nothing crosses"
        further = f"with {self.delay:g} more ticks of" if math.isfinite(self.delay) else "at any"
        stable = f"; stable {further} delay" if "wrench" in self.needs else ""
        lines = [f"the law needs {self.needs}, no model; {crossing} between the arms at each tick{stable}"]
        if not math.isnan(self.force):
            force = (
                f"{self.force:.3g} N of internal force" if math.isfinite(self.force) else "a growing force"
            )
            lines.append(
                f"at rest a bias of {self.bias * 1e3:g} mm leaves {force},"
                f" and {self.load:g} N of unknown load a sag of {self.sag * 1e3:.3g} mm"
            )
        if not math.isnan(self.balanced):
            lines.append(
                f"anchor_gain {self.balanced:.3g} lets the load sag as far as the bias itself moves it"
            )
        if self.product:
            lines.append(
                f"no law of these measurements has force times (sag + bias) below {self.product:.3g} N m"
            )
        return "\n".join(lines)


def steady_errors(scenario: Scenario, *, bias: float = 1e-3, load: float = 10.0) -> SteadyErrors:
    """Return the steady errors of a scenario's law at rest; those of law (23) at the start pose.

    The formulas are derived on the pages "The payload-space law" and "Which law" of the documentation.

    Args:
        scenario: scenario with a law of coop_pin.
        bias: kinematic bias of the position of one arm's tip, m; the worst arm and direction are taken.
        load: constant force on the payload that the law does not know, N: for the own-wrench law the error of
            the stated weight, for the leaky law what the holding torques did not carry.

    Raises:
        ArgumentError: the controller is a user's own.
        SingularJacobianError, UnreachablePoseError: of law (23), where an arm cannot hold the start.
    """
    require_type("scenario", scenario, Scenario)
    bias, load, law = as_positive("bias", bias), as_positive("load", load), scenario.controller
    if isinstance(law, UserController):
        raise ArgumentError("steady errors are known of the laws of coop_pin, not of a user's controller")
    internal = not isinstance(law.force_path, NoForcePath)
    by_wrist = isinstance(law, PayloadSpace) and law.payload_mass is not None and not internal
    exchanges = internal and (isinstance(law, PayloadSpace) or law.gains.force_gain > 0.0)
    needs = "forward kinematics and Jacobians"
    if exchanges or by_wrist:
        needs += " and the internal wrench" if exchanges else " and each arm's own wrist wrench"
    shares, force, sag, balanced = [float(c) for c in scenario.cell.shares], math.nan, math.nan, math.nan
    if isinstance(law, PayloadSpace):
        directions = _directions(scenario, law, internal=internal, by_wrist=by_wrist)
        force = max(direction.force(share, bias) for direction in directions for share in shares)
        sag = max(direction.sag(load) for direction in directions)
        if by_wrist:
            beta = min(direction.integral_of(min(shares) * bias) for direction in directions) / load
            balanced = beta * _anchor_period(scenario, law)
    elif isinstance(law, SlidingMode):
        force, sag = _joint_space(scenario, law, bias, load)
    return SteadyErrors(
        needs=needs,
        wrenches=len(shares) if exchanges else 0,
        delay=_largest_delay(scenario, law) if exchanges or by_wrist else math.inf,
        bias=bias,
        load=load,
        force=force,
        sag=sag,
        product=0.0 if internal else max(c * (1.0 - c) for c in shares) * bias * load,
        balanced=balanced,
    )


class _Direction(NamedTuple):
    """The payload-space law at rest in one direction of the position.

    Attributes:
        spring: K gamma, N/m; 0 where an anchor takes its part out of the internal force or the load.
        integral: K alpha, N/s.
        gamma: 1/s.
        switching: phi.
        internal_rate: beta, or lambda where nothing is measured, 1/s.
        load_rate: rate at which the integral's sum loses the load, 1/s; 0 if it does not.
    """

    spring: float
    integral: float
    gamma: float
    switching: Switching
    internal_rate: float
    load_rate: float

    def held(self, error: float, rate: float) -> float:
        """Return spring x + K alpha phi(gamma x) / rate, N: what an arm with the whole share holds."""
        integral = self.integral_of(error)
        return self.spring * error + (integral / rate if rate else math.inf if integral else 0.0)

    def integral_of(self, error: float) -> float:
        """Return K alpha phi(gamma x), N/s."""
        return self.integral * float(self.switching(np.array(self.gamma * error)))

    def force(self, share: float, bias: float) -> float:
        """Return the internal force in an arm whose view is b off, (1 - c) b off the mean, N."""
        return share * self.held((1.0 - share) * bias, self.internal_rate)

    def sag(self, load: float) -> float:
        """Return the error at which the load is held, m."""
        from scipy.optimize import brentq  # slow to load

        if not self.load_rate and self.integral:
            return 0.0
        if self.held(_LARGEST_SAG, self.load_rate) < load:
            return math.inf
        return float(brentq(lambda x: self.held(x, self.load_rate) - load, 0.0, _LARGEST_SAG, xtol=1e-12))


def _directions(scenario: Scenario, law: PayloadSpace, *, internal: bool, by_wrist: bool) -> list[_Direction]:
    """Return the law in each linear task row."""
    rows, gains = scenario.cell.task_rows, law.gains
    gamma, K, alpha = (
        np.diagonal(gain_matrix(gain, rows.size))
        for gain in (gains.pose_gain, gains.sliding_gain, gains.sign_gain)
    )
    beta, leak = (
        gains.anchor_gain / _anchor_period(scenario, law),
        law.leak_of(next(iter(scenario.cell.arms))),
    )
    anchored = (internal or by_wrist) and beta > 0.0
    return [
        _Direction(
            spring=0.0 if anchored else float(K[row] * gamma[row]),
            integral=float(K[row] * alpha[row]),
            gamma=float(gamma[row]),
            switching=law.switching,
            internal_rate=beta if internal or by_wrist else leak,
            load_rate=0.0 if internal else beta if by_wrist else leak,
        )
        for row, index in enumerate(rows.indices)
        if index < 3
    ]


def _anchor_period(scenario: Scenario, law: PayloadSpace) -> float:
    """Return the time from one anchor to the next, s."""
    return sampled_loop(law.force_path, scenario.wrists, 0.0).every * scenario.clock.period


def _joint_space(scenario: Scenario, law: SlidingMode, bias: float, load: float) -> tuple[float, float]:
    """Return force and sag of law (23) at the start, for square Jacobians.

    Without its integrals arm i is a spring B_i = J_i^-T K_d J_i^-1 gamma against the pose that it sees:
    sum_i B_i (x + b_i) = 0 and (1 + K_f) ftilde_i = B_i (x + b_i).
    """
    rows, chain = scenario.cell.task_rows, CellChain(scenario.cell, scenario.plant)
    q = chain.configuration(scenario.start.matrix)
    springs = []
    for slot in chain.model.arms:
        gains, k = law.gains_of(slot.name), slot.drive.shape[0]
        if np.any(gains.sign_gain):
            return math.inf, 0.0
        J = CellArm(scenario.cell, slot.name).task_jacobian(q[slot.q_slice])
        J_inverse = jacobian_inverse(J, 0.0)
        K_d, gamma = (gain_matrix(gain, k) for gain in (gains.damping_gain, gains.pose_gain))
        springs.append(J_inverse.T @ K_d @ J_inverse @ gamma)
    linear = np.ix_(*[[row for row, index in enumerate(rows.indices) if index < 3]] * 2)
    compliance, eye = np.linalg.inv(sum(springs)), np.eye(rows.size)
    force = max(
        float(np.linalg.norm((B_i @ ((i == j) * eye - compliance @ B_j))[linear], 2))
        for i, B_i in enumerate(springs)
        for j, B_j in enumerate(springs)
    )
    sag = float(np.linalg.norm(compliance[linear], 2)) * load
    return force * bias / (1.0 + law.gains.force_gain), sag


def _largest_delay(scenario: Scenario, law: Law) -> float:
    """Return the largest delay beyond the stated ones at which force feedback is stable, ticks; -1 for none.

    Found by bisection: a loop that is stable at a delay is stable at every smaller one.
    """
    loop = sampled_loop(law.force_path, scenario.wrists, scenario.actuator_lag)._asdict()
    stated, loop["force_gain"] = loop.pop("delay"), law.gains.force_gain
    anchor_gain = law.gains.anchor_gain if isinstance(law, PayloadSpace) else 0.0

    def unstable(further: int) -> bool:
        return not force_loop_is_stable(anchor_gain, delay=stated + further, **loop)

    delay = bisect_left(range(_LARGEST_DELAY + 1), True, key=unstable) - 1
    return math.inf if delay == _LARGEST_DELAY else float(delay)
