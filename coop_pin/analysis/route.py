"""The path of the payload that a scenario asks for, sampled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array, frozen
from coop_pin.description.scenario import Scenario

_APPROACH = 21


class Route(NamedTuple):
    """The payload's way from the start of a scenario to the beginning of its reference, and along it.

    Attributes:
        times: s, shape (n,); 0 for all poses on the way to the reference.
        poses: X_WP, shape (n, 4, 4).
        twists: V_WP_d, shape (n, 6); zero on the way to the reference.
    """

    times: Array
    poses: Array
    twists: Array


def route_of(scenario: Scenario, poses: int) -> Route:
    """Return the route of a scenario: straight to the reference, then along it through poses evenly spaced in time."""
    reference = scenario.motion.build()
    times = np.linspace(0.0, scenario.duration, poses)
    targets = [reference.at(float(time)) for time in times]
    start, begin = pin.SE3(scenario.start.matrix), pin.SE3(np.array(targets[0].X_WP_d))
    approach = [pin.SE3.Interpolate(start, begin, float(part)).homogeneous for part in np.linspace(0.0, 1.0, _APPROACH)[:-1]]
    return Route(
        frozen(np.concatenate((np.zeros(len(approach)), times))),
        frozen(np.stack((*approach, *(target.X_WP_d for target in targets)))),
        frozen(np.concatenate((np.zeros((len(approach), 6)), [target.V_WP_d for target in targets]))),
    )
