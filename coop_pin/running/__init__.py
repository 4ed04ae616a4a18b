"""One run of a scenario: warnings before it, choice of the engine, and its result."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
