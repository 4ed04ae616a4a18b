"""Controllers that see only measurements: no Pinocchio, no model, no chain. Importing this room imports none of them."""

from coop_pin.control.bounds import force_gain_bound
from coop_pin.control.contract import ArmController, ArmReference, CellController, Command
from coop_pin.control.measurement import ArmMeasurement
from coop_pin.control.payload_space import PayloadSpaceController, PayloadSpaceState
from coop_pin.control.posture import Posture
from coop_pin.control.redundant_sliding_mode import RedundantSlidingModeController
from coop_pin.control.sliding_mode import SlidingModeController, SlidingModeState
from coop_pin.control.switching import Saturation, Sign, Switching, Tanh

__all__ = [
    "ArmController",
    "ArmMeasurement",
    "ArmReference",
    "CellController",
    "Command",
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
