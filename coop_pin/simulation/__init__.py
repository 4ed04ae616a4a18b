"""Simulation of a scenario: plant, sensing, actuation, events and recording."""

from coop_pin.simulation.realtime import RealtimePacer
from coop_pin.simulation.simulate import simulate
from coop_pin.simulation.simulation import Simulation

__all__ = ["RealtimePacer", "Simulation", "simulate"]
