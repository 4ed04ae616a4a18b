"""Forecast of a run's errors, moving and at rest: the linear closed loop along the motion, driven by it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.description.scenario import Scenario
from coop_pin.description.sensors import WristSensor
from coop_pin.feasibility.least_squeeze import least_squeeze
from coop_pin.feasibility.reachability import Reachability, reachability
from coop_pin.stability.motion_loop import GROWS, MotionLoop

_LARGEST = 1e6
"""State beyond which a loop counts as growing."""
_SLOWER = (2.0, 4.0, 8.0)
"""Times of a slower motion that are tried, over that of the motion."""
_ON_START = 1e-3
"""Error of the start above which its decay is most of the errors, m and rad."""


class Errors(NamedTuple):
    """Largest errors of the payload's pose and of the internal wrench of an arm.

    Attributes:
        position: m.
        angle: rad.
        force: N, without what a squeeze that comes in still lacks.
        moment: N m, likewise.
    """

    position: float
    angle: float
    force: float
    moment: float

    def __str__(self) -> str:
        """Return position and force as text."""
        return f"{1e3 * self.position:.2g} mm, {self.force:.2g} N"


_UNKNOWN = Errors(math.nan, math.nan, math.nan, math.nan)


class Forecast(NamedTuple):
    """Errors to expect of a run without noise and bias.

    Attributes:
        moving: largest ones while the reference moves; NaN if it does not, or where ``uncovered``.
        at_rest: those at the end; NaN while the reference still moves then, likewise.
        anchor: largest bias that the measured wrenches move the integral by, m and rad; NaN likewise.
        uncovered: reason for which the linear loop is not that of the run; empty if it is.
        until: time of the first event, s, before which they are; inf without one.
    """

    moving: Errors = _UNKNOWN
    at_rest: Errors = _UNKNOWN
    anchor: tuple[float, float] = (math.nan, math.nan)
    uncovered: str = ""
    until: float = math.inf

    def summary(self) -> str:
        """Return the errors, or why there are none, as text in one line."""
        if self.uncovered:
            return f"no forecast of errors covers this cell: {self.uncovered}"
        parts = {"while moving": self.moving, "at rest": self.at_rest}
        known = [f"{when} {errors}" for when, errors in parts.items() if math.isfinite(errors.position)]
        before = f" before the event at {self.until:.3g} s" if math.isfinite(self.until) else ""
        return f"to expect{before} {'; '.join(known)}"


@typed
def forecast(scenario: Scenario, cell_reach: Reachability) -> Forecast:
    """Return the errors to expect of a run of the payload-space law: payload, arms, grasps and law, linear.

    About the reference, on the task rows about P in world axes, with x of the payload and x_i of an arm whose
    grasp gives (else x_i = x), from tick to tick with held wrenches P_i::

        M_0 x''        = -sum F_i - push
        Lambda_i x_i'' = -P_i - a_i - B_i x_i' + F_i,    F_i = -K_i (x_i - x) - D_i (x_i' - x')
        s_i            = x_i' + gamma x_i + sigma_i,    P_i = G_i s_i + Z_i + f_r,i
        Z_i           <- Z_i - g (f_m,i - f_r,i) before the torque, and + T k_I G_i s_i after it

    a_i is what the motion asks of an arm (``HeldArm``), push that of the payload; sigma_i has what is zeroed
    at the grasp, known deflections and the decaying start; B_i is the slope of the joints' friction at the
    speeds of the reference. The wrench on a grasp that gives turns with the payload, the wanted one with what
    the arm sees (``changes_under_load``). Dampers of grasps are modal, patches stick. The matrices are
    interpolated between 33 poses. At most 5 s after the motion, 40 000 ticks and the time before the first
    event are looked at.

    Args:
        scenario: Scenario with its law.
        cell_reach: Reachability of the scenario, in which every arm holds the start.
    """
    first_event = min((event.time for event in scenario.events), default=math.inf)
    until = min(scenario.duration, first_event)
    if reason := _uncovered(scenario, until):
        return Forecast(uncovered=reason)
    scenario = scenario.replace(events=(), duration=until)
    loop = MotionLoop(scenario, cell_reach)
    states = loop.run()
    if not np.abs(states[-1]).max() < _LARGEST:
        return Forecast(uncovered="its loop grows from tick to tick")
    if scenario.cell.unclosed and (growth := loop.growth()) > GROWS:
        return Forecast(uncovered=f"its loop grows with {growth:.3g} /s; a smaller squeeze may hold")
    law: Any = scenario.controller
    errors, moves = loop.errors(states), loop.moves
    biases = loop.norms(loop.explained(states)).max(axis=(0, 1))
    anchor, uncovered = (float(biases[0]), float(biases[1])), ""
    if (biases > loop.bounds).any():
        uncovered = (
            f"the anchor comes to its bound: it would move {1e3 * anchor[0]:.3g} mm and"
            f" {1e3 * anchor[1]:.3g} mrad; a larger controller.anchor_bias allows it"
        )
    elif loop.k_I.any() and float(np.abs(loop.surfaces(states)).max()) > law.switching.width:
        uncovered = "the error leaves the layer of the integral; a larger controller.switching.width has it"
    if uncovered:
        return Forecast(anchor=anchor, uncovered=uncovered)
    moving = Errors(*errors[moves].max(axis=0).tolist()) if moves.any() else _UNKNOWN
    at_rest = _UNKNOWN if moves[-1] else Errors(*errors[-1].tolist())
    return Forecast(moving, at_rest, anchor, until=first_event)


def allowed_errors(scenario: Scenario) -> Errors:
    """Return what the limits of the task allow with the squeeze at t = 0; inf where they allow anything."""
    limits, cell = scenario.task, scenario.cell
    f_d, m_d = np.linalg.norm(scenario.squeeze_wrenches.reshape(-1, 2, 3), axis=2).max(axis=0)
    return Errors(
        limits.position,
        limits.orientation if cell.controls_turns else math.inf,
        max(limits.force, limits.force_share * f_d),
        math.inf if cell.patches else max(limits.moment, limits.moment_share * m_d),
    )


def worst_error(scenario: Scenario, expected: Forecast) -> tuple[float, float, str]:
    """Return the error to expect that is largest over what the task allows, that, and both in words.

    0 and 1 where none is known.

    Args:
        scenario: the scenario.
        expected: forecast of its run.
    """
    largest, allowed = np.fmax(expected.moving, expected.at_rest), allowed_errors(scenario)
    if np.isnan(largest).all():
        return 0.0, 1.0, ""
    worst = int(np.nanargmax(largest / allowed))
    value, limit, name = float(largest[worst]), allowed[worst], Errors._fields[worst]
    unit = ("m", "rad", "N", "N m")[worst]
    return value, limit, f"{name} {value:.2g} {unit}, and the task allows {limit:.2g} {unit}"


def _part_of_task(scenario: Scenario, expected: Forecast) -> float:
    value, limit, _ = worst_error(scenario, expected)
    return value / limit


def slower_motion(
    scenario: Scenario, expected: Forecast, poses: int, part: float = 1.0
) -> tuple[dict[str, Any], Forecast]:
    """Return the least slowing of the motion with a part of what the task allows, and the forecast with it.

    Twice, four and eight times the time are tried, and the run is longer by as much as the motion. Where none
    has the part, it is the first that the task allows. Nothing changes where none is, where errors at rest
    are beyond it, where there are events, whose times go with the motion's, nor of a motion of a table.

    Args:
        scenario: Scenario with its law.
        expected: forecast of its run.
        poses: number of poses that are looked at along the motion.
        part: part of what the task allows, up to which errors are expected.
    """
    changes, least, (begin, end) = dict[str, Any](), _part_of_task(scenario, expected), scenario.motion.span
    length = end - begin if math.isfinite(end) else 0.0
    if scenario.events or _part_of_task(scenario, expected._replace(moving=_UNKNOWN)) > 1.0:
        return changes, expected
    for factor in _SLOWER:
        if least <= part or not (slowed := scenario.motion.slowed(factor)):
            break
        tried = {f"motion.{field}": value for field, value in slowed.items()}
        tried |= {"duration": scenario.duration + (factor - 1.0) * length} if length else {}
        slower = scenario.override(tried)
        later = forecast(slower, reachability(slower, poses=poses))
        share = math.inf if later.uncovered else _part_of_task(scenario, later)
        if share <= part or share <= 1.0 < least:
            changes, expected, least = tried, later, share
    return changes, expected


def _uncovered(scenario: Scenario, until: float) -> str:
    """Return the first reason for which a run is not that of the linear loop; empty without one."""
    law: Any = scenario.controller
    cell, arms = scenario.cell, list(scenario.cell.arms)
    if law.kind != "payload-space":
        return f"it is for the law 'payload-space', not for {law.kind!r}"
    sensors = [scenario.sensors_of(arm) for arm in arms]
    wrists = [sensor.wrist for sensor in sensors if sensor.wrist is not None]
    as_sensed = [wrist.replace(delay=0, rate_hz=None) for wrist in wrists]
    is_off = [cell.arms[arm].calibration_error != type(cell.arms[arm].calibration_error)() for arm in arms]
    begin, rows = scenario.payload_motion.at(0.0).X_WP_d, cell.task_rows
    least = least_squeeze(scenario)
    reasons = {
        "the integral's switching is not smooth": not law.switching.is_smooth,
        "the integral's dead zone is not in it": any(law.integral_dead_zone),
        "the arm's own wrist wrench moves the payload": law.payload_mass is not None
        and not law.force_path.measures,
        "messages, servos and a feed-forward are not in it": bool(scenario.network)
        or scenario.has_servos
        or scenario.feed_forward is not None,
        "an event changes the cell at once": until <= scenario.clock.period,
        "drives fail": any(map(_fails, map(scenario.actuators_of, arms))),
        "tables are not in it": bool(cell.tables),
        "tools are not in it": bool(cell.tools),
        "kinematics or sensors are off": any(is_off)
        or any(wrist != WristSensor() for wrist in as_sensed)
        or any(not sensor.joints_are_ideal or np.any(sensor.holding_torque_error) for sensor in sensors),
        "the start is off the reference": float(np.abs(rows.pose_error(scenario.start.matrix, begin)).max())
        > _ON_START,
        "patches slide": least is not None and not least.ok,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def _fails(drives: Any) -> bool:
    """Return whether drives fail in the run."""
    return (
        bool(drives.missed_ticks) or drives.torque_lost_at is not None or drives.commands_lost_at is not None
    )
