"""Controllers that see only measurements. Importing this package imports neither Pinocchio nor a model."""

from coop_pin.control.interface import (
    ArmCommand,
    ArmController,
    ArmMeasurement,
    ArmReference,
    CellCommand,
    CellController,
    DecentralisedController,
)
from coop_pin.control.payload_space import PayloadSpaceController, PayloadSpaceState
from coop_pin.control.sliding_mode import (
    RedundantSlidingModeController,
    SlidingModeController,
    SlidingModeState,
)
from coop_pin.control.switching import Saturation, Sign, Switching, Tanh
from coop_pin.control.terms import Posture, force_gain_bound

__all__ = [
    "ArmCommand",
    "ArmController",
    "ArmMeasurement",
    "ArmReference",
    "CellCommand",
    "CellController",
    "DecentralisedController",
    "PayloadSpaceController",
    "PayloadSpaceState",
    "Posture",
    "RedundantSlidingModeController",
    "Saturation",
    "Sign",
    "SlidingModeController",
    "SlidingModeState",
    "Switching",
    "Tanh",
    "force_gain_bound",
]
