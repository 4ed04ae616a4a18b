"""The symmetric law over rho: internal force of one box that both arms hold, errors of two things."""

from __future__ import annotations

from typing import Any

import numpy as np

import coop_pin as cp

BIAS, PUSH = 1e-3, 3.0
"""Bias of one tip, m; push on the part that the left arm holds, N."""
HELD, APART = (1.0, 0.1, 0.0), (1.0, 3.0, 6.0)
"""Values of rho for one box, and for two things."""
_DOWN, _LEFT = [3.141592653589793, -1.5707963267948966, 0.0], [0.0, -1.5707963267948966, 0.0]


def one_box(rho: float, *, compensated: bool = True, moves: bool = False) -> cp.Scenario:
    """Return two Pandas that hold a box with the law as a PD, with a bias at rest, or without one on the way.

    Args:
        rho: rho.
        compensated: Whether each robot carries its own weight.
        moves: Whether the box moves, without a bias.
    """
    base = cp.Scenario.load("two-pandas-box")
    gains = base.controller.gains.replace(sign_gain=0.0, leak=0.0, anchor_gain=0.0)
    changes: dict[str, Any] = {
        "controller": {"kind": "symmetric", "relative_gain": rho, "gains": gains.model_dump()},
        "actuators.gravity_compensation": {} if compensated else None,
    }
    if not moves:
        changes |= {"motion": {"kind": "hold", "pose": base.start.model_dump()}, "duration": 4.0}
        changes["cell.arms.left.calibration_error.tip.xyz"] = [BIAS, 0.0, 0.0]
    return base.override(changes)


def two_things(rho: float) -> cp.Scenario:
    """Return two Pandas of which the left holds a part, and the right draws a circle on its face."""
    tip = {"xyz": [0.06, 0.0, 0.0], "rpy": _LEFT}
    circle = {"kind": "circle", "pose": tip, "radius": 0.03, "angular_rate": 3.14159, "ramp": 0.5}
    arms = {
        name: {
            "urdf": "panda",
            "tip": "panda_hand_tcp",
            "posture": [0.0, -0.2, 0.0, -2.3, 0.0, 3.6, 0.785],
            "locked": {"panda_finger_joint1": 0.03},
            "base": base,
        }
        for name, base in (
            ("left", {"xyz": [-0.63, 0.0, 0.0]}),
            ("right", {"xyz": [0.61, 0.0, 0.0], "rpy": [0.0, 0.0, 3.141592653589793]}),
        )
    }
    grasps = {
        "left": {"xyz": [-0.06, 0.0, 0.0], "rpy": _DOWN},
        "right": {"kind": "tool", **tip, "motion": circle | {"normal": [1.0, 0.0, 0.0]}},
    }
    part = {"kind": "box", "mass": 0.5, "size": [0.12, 0.12, 0.12]}
    push = {"kind": "wrench-pulse", "time": 1.0, "duration": 1.0, "wrench": [0.0, PUSH, 0.0, 0.0, 0.0, 0.0]}
    return cp.Scenario.draft(
        name="two-things",
        duration=2.0,
        cell={"arms": arms, "grasps": grasps, "payload": part},
        start={"xyz": [0.0, 0.0, 0.5]},
        motion={"kind": "hold", "pose": {"xyz": [0.0, 0.0, 0.5]}},
        clock={"rate_hz": 1000.0, "steps_per_tick": 2},
        actuators={"gravity_compensation": {}},
        controller={"kind": "symmetric", "relative_gain": rho, "gains": _UNIT},
        events=[push],
    )


_UNIT = {"pose_gain": 1.0, "sliding_gain": 1.0, "sign_gain": 0.0, "transient_rate": 5.0}


def as_pd(scenario: cp.Scenario, rho: float, pose_gain: float) -> cp.Scenario:
    """Return a scenario with another rho, with the same K, as a PD."""
    gains = {"sign_gain": 0.0, "pose_gain": pose_gain}
    changes = {
        f"controller.arm_gains.{arm}.{name}": value
        for arm in scenario.cell.arms
        for name, value in gains.items()
    }
    return scenario.override(changes | {"controller.relative_gain": rho})


def internal_force(scenario: cp.Scenario) -> float:
    """Return the error of the internal force of the first arm at the end of a run, N."""
    data = cp.run(scenario, warn=False).data
    return float(np.linalg.norm((data.internal_wrench - data.desired_internal_wrench).values[-1, 0, :3]))


def errors(scenario: cp.Scenario) -> tuple[float, float]:
    """Return the largest relative and absolute position error in the last half second of the push, mm."""
    data = cp.run(scenario, warn=False).data
    late = data.time.values > 1.5
    relative, absolute = data.relative_error.values[late, 1, :3], data.absolute_error.values[late, :3]
    return tuple(1e3 * float(np.linalg.norm(part, axis=1).max()) for part in (relative, absolute))


def main() -> None:
    """Print the tables."""
    for rho in HELD:
        print(f"one box, 1 mm of bias, rho {rho:g}: {internal_force(one_box(rho)):.3f} N", flush=True)
    for rho in (1.0, 0.0):
        left = internal_force(one_box(rho, compensated=False, moves=True))
        print(f"one box, moved, arms carried by the law alone, rho {rho:g}: {left:.2f} N", flush=True)
    stiff = cp.suggest(two_things(APART[-1])).scenario
    for rho in APART:
        relative, absolute = errors(as_pd(stiff, rho, 10.0))
        print(
            f"two things, one K, PD, rho {rho:g}: relative {relative:.2f} mm, absolute {absolute:.2f} mm",
            flush=True,
        )
    suggested = cp.suggest(two_things(APART[0])).scenario
    for name, scenario in (("PD", as_pd(suggested, 1.0, 10.0)), ("as suggested", suggested)):
        relative, absolute = errors(scenario)
        print(
            f"two things, gains for rho 1, {name}: relative {relative:.3f} mm, absolute {absolute:.3f} mm",
            flush=True,
        )


if __name__ == "__main__":
    main()
