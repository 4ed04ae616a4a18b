"""Pinocchio models made from descriptions; the only room that knows Pinocchio's silent failures."""

import coop_pin.model.require_pinocchio  # noqa: F401  first, so that a missing Pinocchio is told in words
from coop_pin.model.arm_model import ArmModel

__all__ = ["ArmModel"]
