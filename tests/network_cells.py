"""Cells whose arms send messages, and laws and samples for them."""

from __future__ import annotations

import numpy as np
from cells import ANCHORED, SCENARIOS, planar_three_arms

import coop_pin as cp
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.network import CellNetwork, NetworkSignals

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


def moved(data):
    """Data without what arms sent, in which laws that move alike may differ."""
    return data.drop_vars(["messages_sent", "bytes_sent"], errors="ignore")


def network_of(names, edges, delay):
    """Network whose edges, the arms' own among them, round and keep back nothing."""
    size = len(edges)
    ages = tuple(range(delay + 1))
    return CellNetwork(tuple(names), tuple(edges), np.zeros(size), (np.zeros(1),) * size, (0.0,) * size, ages)


def arriving(arrived, delay):
    """Signals of a tick at which all edges send, and messages of an age arrive on some; a mask."""
    arrives = np.zeros((len(arrived), delay + 1))
    arrives[:, delay] = arrived
    return NetworkSignals(np.ones(len(arrived)), arrives)


class Silent(cp.ArmController):
    """Says nothing, does nothing."""

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        return cp.ArmCommand(np.zeros(0), state)
