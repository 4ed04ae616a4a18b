"""From a scenario and a controller to a recorded run: sensing, actuation, events and the loop."""

from coop_pin.simulation.realtime import RealtimePacer
from coop_pin.simulation.simulate import simulate
from coop_pin.simulation.simulation import Simulation

__all__ = ["RealtimePacer", "Simulation", "simulate"]
