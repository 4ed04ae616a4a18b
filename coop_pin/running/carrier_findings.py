"""Findings of what carries arms: servos of shared joints and rolling bases, sensors of these, wheels."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from coop_pin.base.spatial import exp3
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.carried_motion import RollingCourse, displacement, rolling_course
from coop_pin.results.finding import Finding, Kind

_ASIDE = math.radians(60.0)
"""Angle between the heading of a base and its way, from which on the base turns first."""
_CALM = 0.25
"""Proposed gain of a servo, 1/s, times the period of a tick."""
_INSTANTS, _TOGETHER = 21, 0.01
"""Instants at which ways of bases are compared, and difference from which on they are others, m."""


def carrier_findings(scenario: Scenario) -> Iterator[Finding]:
    """Yield what is known of shared joints and of bases that roll, before a run."""
    yield from _servo_findings(scenario)
    yield from _ignorance_findings(scenario)
    yield from _wheel_findings(scenario)
    yield from _apart_findings(scenario)


def _servo_findings(scenario: Scenario) -> Iterator[Finding]:
    """Yield servos that are too fast for the ticks: u[k+1] = A u[k] - b K u[k], of unit inertia.

    With K = (s, d) they decay for T d < 2 and T s < 2 d; the remedy has T s <= d and T d <= 1/2.
    """
    T, servos = scenario.clock.period, list[tuple[Kind, str, str, float, float, dict[str, float]]]()
    for name, joint in scenario.cell.shared_joints.items():
        w, zeta, field = joint.bandwidth, joint.damping_ratio, f"cell.shared_joints.{name}"
        calm = {f"{field}.bandwidth": min(_CALM, _CALM / zeta, 2.0 * zeta) / T}
        servos.append(("shared joint", field, repr(name), w * w, 2.0 * zeta * w, calm))
    for name, base in scenario.cell.wheels.items():
        w, k, field = base.bandwidth, base.position_gain, f"cell.arms.{name}.mobile_base"
        gains = {"bandwidth": w, "position_gain": k}
        calm = {f"{field}.{gain}": _CALM / T for gain, value in gains.items() if value * T > _CALM}
        servos.append(("rolling base", field, f"the base of {name!r}", w * k, w + k, calm))
    for kind, field, name, stiffness, damping, remedy in servos:
        A, b = np.array([[1.0, T], [0.0, 1.0]]), np.array([[T * T / 2.0], [T]])
        radius = np.abs(np.linalg.eigvals(A - b @ [[stiffness, damping]])).max()
        if radius > 1.0:
            sentence = f"the servo of {name} is unstable at {1.0 / T:g} Hz: spectral radius {radius:.3g}"
            yield Finding(kind, field, "error", sentence, float(radius), 1.0, remedy)


def _ignorance_findings(scenario: Scenario) -> Iterator[Finding]:
    """Yield the moving joints under arms that these do not know.

    A joint that no arm is told of moves the payload with it, while every arm sees itself on its path and no
    internal force shows it; told to some arms alone, it makes internal forces.
    """
    cell = scenario.cell
    is_held = all(joint.follow == "hold" for joint in cell.shared_joints.values()) and not any(
        base.follow != "hold" for base in cell.wheels.values()
    )
    if is_held:
        return
    told = {
        name: scenario.sensors_of(name).shared_joints for carrier in cell.carriers for name in carrier.arms
    }
    kind: Kind = "rolling base" if cell.wheels else "shared joint"
    joints = [f"{name}.mobile_base" for name in cell.wheels] or [*cell.driven]
    paths = {name: f"arm_sensors.{name}" if name in scenario.arm_sensors else "sensors" for name in told}
    untold = [name for name in told if told[name].told == "nothing"]
    others = [name for name in told if name not in untold]
    if untold:
        effect = (
            f"while {others} are: internal forces, of hundreds of newtons on rigid grasps"
            if others
            else "the payload goes with it, every arm sees itself on its path, and no internal force shows it"
        )
        sentence = f"{untold} are not told that {joints} move; {effect}"
        cure = {f"{paths[name]}.shared_joints.told": "all" for name in untold}
        yield Finding(kind, "sensors.shared_joints", "error", sentence, len(untold), 0, cure)
    late = {sensor.delay for sensor in told.values()}
    if not untold and (len(late) > 1 or any(sensor.told == "position" for sensor in told.values())):
        sentence = (
            f"the arms are told of {joints} with different delays, {sorted(late)} ticks, or without the rate:"
            " internal forces while it moves"
        )
        yield Finding(kind, "sensors.shared_joints", "warning", sentence, max(late), min(late))


def _wheel_findings(scenario: Scenario) -> Iterator[Finding]:
    """Yield ways that wheels cannot go: sideways or backwards at once, too fast, or without grip."""
    g = float(np.linalg.norm(scenario.cell.gravity))
    for name, base in scenario.cell.wheels.items():
        field, course = f"cell.arms.{name}.mobile_base", rolling_course(scenario, name)
        turned, aside = float(np.abs(course.turn).max()), float(course.off.max())
        if aside > _ASIDE and base.follows_payload:
            sentence = (
                f"the payload leads the base of {name!r} up to {np.degrees(aside):.0f} degrees off its"
                " heading, where wheels do not roll: it swings round, and turns by up to"
                f" {np.degrees(turned):.0f} degrees under its arm; point its x axis along its way"
            )
            way = _along_way(scenario, name, course)
            yield Finding("rolling base", field, "warning", sentence, aside, _ASIDE, way)
        rates = float(np.abs(course.rates @ base.to_wheels.T).max())
        if rates > base.wheel_speed:
            sentence = f"the wheels of {name!r} turn at up to {rates:.3g} rad/s of {base.wheel_speed:g}"
            yield Finding("rolling base", field, "warning", sentence, rates, base.wheel_speed)
        grip = float(np.abs(course.side).max()) / g if g else 0.0
        if grip > base.friction:
            sentence = (
                f"the base of {name!r} needs {grip:.3g} of its weight across its wheels on its way, and their"
                f" friction is {base.friction:g}: it would slide, which is not modelled"
            )
            yield Finding("rolling base", field, "warning", sentence, grip, base.friction)


def _apart_findings(scenario: Scenario) -> Iterator[Finding]:
    """Yield bases whose arms the analyses see on another one's way."""
    for name in scenario.cell.wheels:
        field, apart, start = f"cell.arms.{name}.mobile_base", 0.0, scenario.cell.arms[name].base.matrix
        for time in np.linspace(0.0, scenario.duration, _INSTANTS).tolist():
            ways = [(displacement(scenario, time, arm) @ start)[:3, 3] for arm in ("", name)]
            apart = max(apart, float(np.linalg.norm(ways[1] - ways[0])))
        if apart > _TOGETHER:
            sentence = (
                f"reach, torques and distances of {name!r} are those on the way of another base, which"
                f" has a way of its own: this one is up to {apart:.3g} m off it; look at the run"
            )
            yield Finding("rolling base", field, "warning", sentence, apart, _TOGETHER)


def _along_way(scenario: Scenario, name: str, course: RollingCourse) -> dict[str, object]:
    """Return the pose of a base that heads along its first way, its arm where it is; none if it does so."""
    first = int(np.argmax(course.off > 0.0))
    if course.off[first] <= _ASIDE:
        return {}
    base, X_WB = scenario.cell.wheels[name], scenario.cell.arms[name].base.matrix
    motion, time = scenario.payload_motion, float(course.time[first])
    x, y = base.reference(time, X_WB, motion.at(time), motion.at(0.0).X_WP_d)[1]
    turned, lever = np.eye(4), np.array((base.ahead, 0.0, 0.0))
    turned[:3, :3] = exp3(np.array((0.0, 0.0, np.arctan2(y, x))))
    turned[:3, 3] = lever - turned[:3, :3] @ lever
    pose, path = scenario.start.from_matrix(X_WB @ turned), f"cell.arms.{name}.base"
    return {f"{path}.xyz": list(pose.xyz), f"{path}.rpy": list(pose.rpy)}
