"""What the user says, as frozen values; and the URDF files that it names."""

from coop_pin.description.arm import Arm, JointFriction
from coop_pin.description.catalogue import scenario_names
from coop_pin.description.cell import Cell
from coop_pin.description.clock import Clock, PlantOptions, Stabilisation
from coop_pin.description.controller import PayloadSpace, RedundantSlidingMode, SlidingMode, UserController
from coop_pin.description.event import PayloadChange, WrenchPulse
from coop_pin.description.force_path import LateForcePath, LowPassForcePath, NoForcePath
from coop_pin.description.gains import PayloadSpaceGains, PostureGains, SlidingModeGains
from coop_pin.description.motion import ExponentialMotion, HoldMotion
from coop_pin.description.payload import Payload
from coop_pin.description.pose import Pose
from coop_pin.description.scenario import Scenario
from coop_pin.description.switching import Saturation, Sign, Tanh

__all__ = [
    "Arm",
    "Cell",
    "Clock",
    "ExponentialMotion",
    "HoldMotion",
    "JointFriction",
    "LateForcePath",
    "LowPassForcePath",
    "NoForcePath",
    "Payload",
    "PayloadChange",
    "PayloadSpace",
    "PayloadSpaceGains",
    "PlantOptions",
    "Pose",
    "PostureGains",
    "RedundantSlidingMode",
    "Saturation",
    "Scenario",
    "Sign",
    "SlidingMode",
    "SlidingModeGains",
    "Stabilisation",
    "Tanh",
    "UserController",
    "WrenchPulse",
    "scenario_names",
]
