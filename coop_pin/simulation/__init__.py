"""From a scenario and a controller to a recorded run: sensing, actuation, events and the loop."""

from coop_pin.simulation.loop import simulate

__all__ = ["simulate"]
