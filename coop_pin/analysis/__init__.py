"""What can be said about a scenario beyond running it."""

from coop_pin.analysis.sampled_damping import sampled_damping

__all__ = ["sampled_damping"]
