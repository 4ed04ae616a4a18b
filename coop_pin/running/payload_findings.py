"""Findings of a payload of several links: modes near the control rate, and links that nobody holds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

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
    chain, rate = simulation.chain, simulation.scenario.clock.rate_hz
    if chain.joints is None:
        return
    poles, shapes = chain.payload_modes(simulation.plant.q)
    names = chain.joints.linked.joint_names
    most = [names[index] for index in np.argmax(np.abs(shapes), axis=0)]
    modes = [
        (float(abs(s)) / (2.0 * np.pi), float(-s.real / abs(s)), joint)
        for s, joint in zip(poles, most, strict=True)
        if s.imag > 0.0
    ]
    near = [mode for mode in modes if _NEAR[0] <= mode[0] / rate <= _NEAR[1] and mode[1] < _LIGHT]
    if modes:
        frequency, damping, joint = min(near, key=lambda mode: mode[1]) if near else min(modes)
        severity: Any = "warning" if near else "note"
        text = f"a mode of the payload in still grasps, most at joint {joint!r}, has {frequency:.4g} Hz and"
        text = f"{text} the damping ratio {damping:.2g}"
        why = f", near the control rate of {rate:g} Hz: torques that are held excite it"
        yield Finding(
            "payload mode",
            "cell.payload",
            severity,
            text + (why if near else ": the slowest"),
            frequency,
            rate,
        )
    stay = {joint for s, joint in zip(poles, most, strict=True) if abs(s) < _STILL}
    for joint, link in _unheld(simulation.scenario).items():
        of_joint, field = [mode for mode in modes if mode[2] == joint], f"cell.payload.links.joints.{joint}"
        if of_joint:
            frequency, damping, _ = min(of_joint)
            swing = f"at {joint!r} it swings with {frequency:.3g} Hz, damping ratio {damping:.2g}"
            severity, text = (
                "warning" if damping < _SWINGS else "note",
                f"nobody holds link {link!r}: {swing}",
            )
            yield Finding("unheld link", f"{field}.damping", severity, text, damping, _SWINGS)
        elif joint in stay:  # else another joint moves most in each of its modes
            text = f"nobody holds link {link!r}, and nothing returns joint {joint!r}"
            yield Finding("unheld link", field, "warning", text)


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
