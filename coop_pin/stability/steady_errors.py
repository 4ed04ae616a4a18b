"""Steady errors of a law: internal force under a kinematic bias, sag under a load, and what the law needs."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, as_number, as_positive, typed
from coop_pin.base.errors import ArgumentError
from coop_pin.control.bounds import SampledLoop
from coop_pin.control.steady_state import LARGEST_SAG, SteadyDirection
from coop_pin.control.terms import jacobian_inverse
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.cell_arm import CellArm

_BISECTIONS = 60
_LARGEST_DELAY = 200
"""A loop that is stable at this delay, ticks, counts as stable at any."""
_NEEDED = {
    "holding torque": "at the start the torque that each drive holds with",
    "start pose": "the payload's pose at the start",
    "internal wrench": "the internal wrench",
    "own wrench": "each arm's own wrist wrench",
    "learned mass": "the mass that all arms believe in",
    "wrenches of all arms": "the wrist wrenches of all arms",
    "poses of all arms": "the poses and twists that all arms see",
    "states of all arms": "the states of all arms",
    "model": "a model of arms and payload",
    "regressor": "the regressors of arms and payload",
    "role": "who leads",
}
"""Needs of laws as text."""
_EXCHANGED = {"internal wrench", "wrenches of all arms"}


class SteadyErrors(NamedTuple):
    """Steady errors of a law at rest, and what it needs.

    Attributes:
        needs: quantities that the law measures, besides joint positions and velocities.
        wrenches: wrenches that cross between the arms at each tick.
        delay: largest further delay of the measured wrench at which its feedback is stable, ticks; inf for
            any, or if no wrench is fed back; -1 if it is unstable as it is.
        bias: kinematic bias of the position of one arm's tip, m.
        load: constant force on the payload that the law does not know, N.
        force: internal force that the bias leaves, N; inf if it grows; NaN for law (23) with redundant arms.
        zero: internal force that 1 N leaves by which a wrist's zero is off, N: 1 - c where the internal
            wrench of all arms anchors an integral; NaN elsewhere.
        growth: rate at which it grows where it does, N/s; NaN likewise.
        limit: largest bias of one arm from the start on that is sure to come to rest, m; inf without a bound
            of the anchor.
        ramp: internal force that the bias leaves after the load has come slowly, where the integral has a
            dead zone, N; loads that come and go add to it. NaN without one.
        free: b_0, m: half of the largest bias of one arm that comes to rest whenever it begins; inf likewise.
        drift: position error if the load is a force error that no arm can change, such as a dead arm's, m;
            inf if the payload is lost; NaN likewise, and where no force is measured.
        unreachable: largest such force error against which the payload is held, N; inf for any; NaN likewise.
        sag: position error that the load leaves, m; inf if it is dropped; NaN likewise.
        product: c (1 - c) b D, N m. Of equal laws that are continuous in the error, the largest force times
            (largest held sag + bias) over all histories of loads up to D and biases up to b is not below;
            with a static characteristic at rest already. Force times sag of a linear law is exactly this.
        balanced: the anchor gain with which the load sags as far as the bias moves the payload, c b, which
            leaves (1 - c) D of internal force; NaN but for the own-wrist law.
    """

    needs: str
    wrenches: int
    delay: float
    bias: float
    load: float
    force: float
    zero: float
    growth: float
    limit: float
    ramp: float
    free: float
    drift: float
    unreachable: float
    sag: float
    product: float
    balanced: float

    def summary(self) -> str:
        """Return the errors as text."""
        none = "poses and twists cross" if "poses" in self.needs else "nothing crosses"
        none = "two numbers of each arm cross" if "believe" in self.needs else none
        crossing = f"{self.wrenches} wrenches cross" if self.wrenches else none
        further = f"with {self.delay:g} more ticks of" if math.isfinite(self.delay) else "at any"
        stable = f"; stable {further} delay" if "wrench" in self.needs else ""
        model = "" if "model" in self.needs or "regressors" in self.needs else ", no model"
        lines = [f"the law needs {self.needs}{model}; {crossing} between the arms at each tick{stable}"]
        if not math.isnan(self.force):
            rate = "" if math.isnan(self.growth) else f" by {self.growth:.3g} N/s"
            force = (
                f"{self.force:.3g} N of internal force"
                if math.isfinite(self.force)
                else f"a force that grows{rate}"
            )
            lines.append(
                f"at rest a bias of {self.bias * 1e3:g} mm leaves {force} (norm, worst arm and axis),"
                f" and {self.load:g} N of unknown load a sag of {self.sag * 1e3:.3g} mm"
            )
        if not math.isnan(self.zero):
            lines[-1] += f"; a wrist's zero of 1 N leaves {self.zero:.3g} N"
        if not math.isnan(self.ramp):
            lines.append(
                f"a load of {self.load:g} N that comes slowly leaves {self.ramp:.3g} N with that bias, and"
                " loads that come and go add to it; a force grows with a bias beyond"
                f" {1e3 * self.limit:.3g} mm"
            )
        if math.isfinite(self.free):
            lines.append(
                f"a bias of one arm comes to rest up to {self.limit * 1e3:.3g} mm from the start on, and"
                f" up to {2e3 * self.free:.3g} mm if it begins later"
            )
        if not math.isnan(self.drift):
            moved = f"moves it by {self.drift * 1e3:.3g} mm" if math.isfinite(self.drift) else "loses it"
            held = f"up to {self.unreachable:.3g} N" if math.isfinite(self.unreachable) else "any size"
            lines.append(
                f"{self.load:g} N of internal force that no arm can change (a dead one's) {moved}; the law"
                f" holds against {held} of it"
            )
        if not math.isnan(self.balanced):
            lines.append(
                f"anchor_gain {self.balanced:.3g} lets the load sag as far as the bias itself moves it"
            )
        if self.product:
            product = f"force times (sag + bias) below {self.product:.3g} N m"
            lines.append(
                f"at rest no equal laws with a static characteristic, each on its own view, have {product}"
            )
            if _NEEDED["start pose"] not in self.needs:  # a law that knows its start needs no other
                lines.append(
                    "over all histories of such loads no equal laws with memory that are continuous in the"
                    f" error keep {product} either"
                )
        return "\n".join(lines)


@typed
def steady_errors(scenario: Scenario, *, bias: float = 1e-3, load: float = 10.0) -> SteadyErrors:
    """Return the steady errors of a scenario's law at rest; those of law (23) at the start pose.

    The formulas stand on the pages "Proofs of the payload-space law" and "Choose a law" of the documentation.

    Args:
        scenario: scenario with a law of coop_pin.
        bias: kinematic bias of the position of one arm's tip, m; the worst arm and direction are taken.
        load: constant force on the payload that the law does not know, N: for the own-wrench law the error of
            the stated weight, for the leaky law what the holding torques did not carry.

    Raises:
        ArgumentError: the controller is a user's own, or arms have servos or tools.
        SingularJacobianError, UnreachablePoseError: of law (23), where an arm cannot hold the start.
    """
    bias, load = as_positive("bias", bias), as_positive("load", load)
    law: Any = scenario.controller
    if law.user_code:
        raise ArgumentError("steady errors are known of the laws of coop_pin, not of a user's controller")
    if scenario.cell.tools:
        raise ArgumentError("steady errors are known of arms that hold one payload, not beside tools")
    if scenario.has_servos:
        raise ArgumentError("steady errors are known of commanded torques, not of servos")
    exchanges, measures_own = bool(_EXCHANGED & {*law.needs}), "own wrench" in law.needs
    shares, balanced = scenario.cell.shares.tolist(), math.nan
    force, zero, growth, ramp, drift, unreachable, sag = [math.nan] * 7
    limit = free = math.inf
    loop = law.loop(scenario.timing)
    period = loop.every * scenario.clock.period
    if directions := law.steady_directions(scenario.cell.task_rows, loop, scenario.clock.period):
        force = max(direction.force(share, bias) for direction in directions for share in shares)
        growth = max(direction.growth(share, bias) for direction in directions for share in shares)
        limit = min(direction.limit(share) for direction in directions for share in shares)
        free = min(direction.free for direction in directions)
        if any(direction.rests for direction in directions):
            ramp = max(each.after_slow_load(share, bias, load) for each in directions for share in shares)
        sag = max(_sag(direction, load) for direction in directions)
        if law.measures and exchanges:
            drift = max(_drift(direction, share, load) for direction in directions for share in shares)
            zero = 1.0 - min(shares)
            unreachable = min(direction.unreachable(share) for direction in directions for share in shares)
        if measures_own:
            rate = min(direction.integral(min(shares) * bias) for direction in directions)
            balanced = rate / load * period
    elif springs := _joint_springs(scenario):
        force, sag = _held_by_springs(scenario, springs, bias, load, loop.force_gain)
    return SteadyErrors(
        needs=" and ".join(["forward kinematics and Jacobians", *(_NEEDED[need] for need in law.needs)]),
        wrenches=len(shares) if exchanges else 0,
        delay=_largest_delay(loop) if exchanges or measures_own else math.inf,
        bias=bias,
        load=load,
        force=force,
        zero=zero,
        growth=growth,
        limit=limit,
        ramp=ramp,
        free=free,
        drift=drift,
        unreachable=unreachable,
        sag=sag,
        product=0.0
        if law.force_path.measures or {"role", "poses of all arms"} & {*law.needs}
        else max(c * (1.0 - c) for c in shares) * bias * load,
        balanced=balanced,
    )


@typed
def anchor_biases(scenario: Scenario, bias: float, turn: float = 0.0) -> dict[str, tuple[float, float]]:
    """Return for each arm the least ``anchor_bias`` that bears a bias of it whenever it begins, m and rad.

    Half of what the bias changes of the arm's view of the payload at the start: the payload comes to rest
    between the views.

    Args:
        scenario: arms and start.
        bias: position of the arm's tip or base that is off, m.
        turn: angle by which its base is off, rad.
    """
    bias, turn = as_positive("bias", bias), abs(as_number("turn", turn))
    start = np.array(scenario.start.xyz)
    levers = {name: np.linalg.norm(start - arm.base.xyz) for name, arm in scenario.cell.arms.items()}
    return {name: (float(bias + turn * lever) / 2.0, turn / 2.0) for name, lever in levers.items()}


def _sag(direction: SteadyDirection, load: float) -> float:
    """Return the error at which a load is held, m."""
    if not direction.load_rate and direction.integral(LARGEST_SAG):
        delta = direction.rests
        return delta if direction.spring(delta) <= load else delta * load / direction.spring(delta)
    if direction.held(LARGEST_SAG, direction.load_rate) < load:
        return math.inf
    rate = direction.load_rate
    return _least(lambda x: direction.held(x, rate) >= load)


def _drift(direction: SteadyDirection, share: float, force: float) -> float:
    """Return the error at which an arm rests whose force error it cannot change, m; inf if it never does."""
    rate = direction.internal_rate * force / share
    if direction.integral(min(direction.free, LARGEST_SAG)) <= rate:
        return direction.free
    return _least(lambda x: direction.integral(x) >= rate)


def _least(is_enough: Callable[[float], bool]) -> float:
    """Return the least error that is enough, by bisection: scipy.optimize takes long to load."""
    low, high = 0.0, LARGEST_SAG
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2.0
        low, high = (low, middle) if is_enough(middle) else (middle, high)
    return high


def _joint_springs(scenario: Scenario) -> list[Array]:
    """Return the spring of each arm at the start, for square Jacobians; none where its law knows none."""
    cell, chain = scenario.cell, CellChain(scenario.cell, scenario.plant)
    q, springs = chain.configuration(scenario.start.matrix), list[Array]()
    for arm in chain.model.arms:
        J = CellArm(cell, arm.name).task_jacobian(q[arm.q_slice])
        if J.shape[0] != J.shape[1]:
            return []
        spring = scenario.controller.joint_spring(arm.name, jacobian_inverse(J, 0.0))
        if spring is None:
            return []
        springs.append(spring)
    return springs


def _held_by_springs(
    scenario: Scenario, springs: list[Array], bias: float, load: float, force_gain: float
) -> tuple[float, float]:
    """Return force and sag of arms that are springs B_i against the pose that each sees.

    sum_i B_i (x + b_i) = 0 and (1 + K_f) ftilde_i = B_i (x + b_i).
    """
    if not np.isfinite(springs).all():
        return math.inf, 0.0
    rows = scenario.cell.task_rows
    linear = np.ix_(rows.are_linear, rows.are_linear)
    compliance, eye = np.linalg.inv(sum(springs)), np.eye(rows.size)
    force = max(
        float(np.linalg.norm((B_i @ ((i == j) * eye - compliance @ B_j))[linear], 2))
        for i, B_i in enumerate(springs)
        for j, B_j in enumerate(springs)
    )
    sag = float(np.linalg.norm(compliance[linear], 2)) * load
    return force * bias / (1.0 + force_gain), sag


def _largest_delay(loop: SampledLoop) -> float:
    """Return the largest delay beyond the stated ones at which force feedback is stable, ticks; -1 for none.

    Found by bisection: a loop that is stable at a delay is stable at every smaller one.
    """
    delays = range(_LARGEST_DELAY + 1)
    largest = bisect_left(delays, True, key=lambda further: not loop.is_stable(further)) - 1
    return math.inf if largest == _LARGEST_DELAY else float(largest)
