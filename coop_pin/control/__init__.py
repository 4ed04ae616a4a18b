"""Controllers that see only measurements. Importing this package imports neither Pinocchio nor a model."""

from coop_pin.control.bounds import anchor_gain_bound, force_gain_bound
from coop_pin.control.calibration import ZeroedController
from coop_pin.control.interface import (
    ArmCommand,
    ArmController,
    ArmMeasurement,
    ArmReference,
    CellCommand,
    CellController,
    DecentralisedController,
)
from coop_pin.control.leader_follower import LeaderFollowerController
from coop_pin.control.payload_space import PayloadSpaceController, PayloadSpaceState
from coop_pin.control.prescribed_performance import PrescribedPerformanceController
from coop_pin.control.sliding_mode import (
    RedundantSlidingModeController,
    SlidingModeController,
    SlidingModeState,
)
from coop_pin.control.switching import Saturation, Sign, Switching, Tanh
from coop_pin.control.terms import Posture

__all__ = [
    "ArmCommand",
    "ArmController",
    "ArmMeasurement",
    "ArmReference",
    "CellCommand",
    "CellController",
    "DecentralisedController",
    "LeaderFollowerController",
    "PayloadSpaceController",
    "PayloadSpaceState",
    "Posture",
    "PrescribedPerformanceController",
    "RedundantSlidingModeController",
    "Saturation",
    "Sign",
    "SlidingModeController",
    "SlidingModeState",
    "Switching",
    "Tanh",
    "ZeroedController",
    "anchor_gain_bound",
    "force_gain_bound",
]
