"""Pinocchio models made from descriptions; the only room that knows Pinocchio's silent failures."""

from coop_pin.model.arm_model import ArmModel

__all__ = ["ArmModel"]
