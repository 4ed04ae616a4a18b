"""Findings of a payload of several links: modes near the control rate, and links that nobody holds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.results.finding import Finding
from coop_pin.simulation.simulation import Simulation

_NEAR, _LIGHT = (0.25, 2.0), 0.05
"""Frequencies over the control rate that held torques excite, and the damping ratio below which they do."""
_STILL = 1e-3
"""Pole below which nothing returns a joint, 1/s."""
_SWINGS = 0.02
"""Damping ratio below which a link that nobody holds swings on after the motion."""


def payload_findings(simulation: Simulation) -> Iterator[Finding]:
    """Yield what is known of the modes of the payload with its grasps held still, at the start.

    Nothing for a payload of one body.
    """
    chain, q = simulation.chain, simulation.plant.q
    if chain.joints is None:
        return
    poles, shapes = chain.payload_modes(q)
    swings = np.flatnonzero(poles.imag > 0.0)
    rate = simulation.scenario.clock.rate_hz
    names = chain.joints.linked.joint_names
    free = _unheld(simulation.scenario)
    modes = [_mode(poles[k], shapes[:, k], names) for k in swings]
    stay = {names[np.argmax(np.abs(shapes[:, k]))] for k in np.flatnonzero(np.abs(poles) < _STILL)}
    near = [mode for mode in modes if _NEAR[0] <= mode[0] / rate <= _NEAR[1] and mode[1] < _LIGHT]
    if modes:
        slowest, worst = min(modes), min(near, key=lambda mode: mode[1], default=None)
        yield Finding(
            "payload mode",
            "cell.payload",
            "note" if worst is None else "warning",
            _sentence(slowest if worst is None else worst, rate, worst is not None),
            (worst or slowest)[0],
            rate,
        )
    for joint, link in free.items():
        of_joint = [mode for mode in modes if mode[2] == joint]
        if not of_joint and joint not in stay:  # another joint moves most in each of its modes
            continue
        if not of_joint:
            sentence = f"nobody holds link {link!r}, and nothing returns joint {joint!r}"
            yield Finding("unheld link", f"cell.payload.links.joints.{joint}", "warning", sentence)
            continue
        frequency, damping, _ = min(of_joint)
        swing = f"at {joint!r} it swings with {frequency:.3g} Hz, damping ratio {damping:.2g}"
        sentence = f"nobody holds link {link!r}: {swing}"
        severity: Any = "warning" if damping < _SWINGS else "note"
        field = f"cell.payload.links.joints.{joint}.damping"
        yield Finding("unheld link", field, severity, sentence, damping, _SWINGS)


def _mode(pole: complex, shape: Array, names: tuple[str, ...]) -> tuple[float, float, str]:
    """Return frequency, Hz, damping ratio, and the joint that moves most, of a pole, 1/s."""
    size = float(abs(pole))
    return size / (2.0 * np.pi), float(-pole.real) / size, names[int(np.argmax(np.abs(shape)))]


def _sentence(mode: tuple[float, float, str], rate: float, is_near: bool) -> str:
    frequency, damping, joint = mode
    text = f"a mode of the payload in still grasps, most at joint {joint!r}, has {frequency:.4g} Hz and"
    text = f"{text} the damping ratio {damping:.2g}"
    if not is_near:
        return f"{text}: the slowest"
    return f"{text}, near the control rate of {rate:g} Hz: torques that are held excite it"


def _unheld(scenario: Scenario) -> dict[str, str]:
    """Return joints with no grasp beyond them, or of a free payload none before them, and their links."""
    links = scenario.cell.payload.links
    assert links is not None
    robot, held = links.robot, scenario.cell.held_links
    sides = [robot.movers(held.get(name, links.link)) for name in scenario.cell.arms]
    ends = {robot.movers(link)[-1]: link for link in links.bodies if robot.movers(link)}
    beyond = {joint: sum(joint in side for side in sides) for joint in ends}
    return {
        joint: ends[joint]
        for joint, count in beyond.items()
        if count == 0 or (count == len(sides) and links.base is None)
    }
