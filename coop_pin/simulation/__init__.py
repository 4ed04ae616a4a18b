"""Simulation of a scenario: plant, sensing, actuation, events and recording."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
