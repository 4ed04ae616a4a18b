"""Cells whose arms send messages, and laws and samples for them."""

from __future__ import annotations

import numpy as np
from cells import ANCHORED, SCENARIOS, planar_three_arms

import coop_pin as cp
from coop_pin.simulation.build_controller import build_controller

SHARES = (0.2, 0.3, 0.5)

BIASED = "cell.arms.{}.calibration_error.tip.xyz"


def two_arms(cell):
    return SCENARIOS[cell]().override({"events": [], "duration": 0.4}), ANCHORED[cell]


def three_arms(cell):
    """The planar cell with a third arm, or three UR5 at a plate; shares are unequal."""
    if cell == "planar":
        return planar_three_arms("adept-anchored").replace(duration=0.4), ANCHORED[cell]
    plate = cp.Scenario.load("three-ur5-plate", {"events": [], "duration": 0.2})
    shares = dict(zip(plate.cell.arms, SHARES, strict=True))
    return plate.override({"cell.load_shares": shares}), plate.controller


CELLS = {
    f"{count} {cell}": (of, cell)
    for cell in SCENARIOS
    for count, of in (("two", two_arms), ("three", three_arms))
}


def samples(scenario, controller=None):
    return cp.simulate(scenario, build_controller(scenario) if controller is None else controller).data


class Silent(cp.ArmController):
    """Says nothing, does nothing."""

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        return cp.ArmCommand(np.zeros(0), state)
