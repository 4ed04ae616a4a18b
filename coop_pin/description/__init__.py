"""Configuration classes (frozen, validated): scenario, cell, arm, payload, controller, events, plant."""

from coop_pin.base.schema.pose import Pose
from coop_pin.description.actuators import Actuators, GravityCompensation
from coop_pin.description.arm_events import LoseArm, UserEvent
from coop_pin.description.catalogue import scenario_names
from coop_pin.description.cell.arm import Arm, JointFriction, Miscalibration
from coop_pin.description.cell.cell import Cell, grasps_from_configuration
from coop_pin.description.cell.closure import Closure
from coop_pin.description.cell.contact import Pad, PatchGrasp, Table
from coop_pin.description.cell.grasp import CompliantGrasp
from coop_pin.description.cell.mobile_base import MobileBase
from coop_pin.description.cell.payload import Payload
from coop_pin.description.controller import UserController
from coop_pin.description.events import GravityTurn, Partner, PayloadChange, WrenchPulse
from coop_pin.description.grasp_events import HandOver, PutDown, Regrasp, Release
from coop_pin.description.model_laws import ModelFactors
from coop_pin.description.network import ArmClock, Channel, EdgeChannel, GraphChange, Network
from coop_pin.description.plant import Clock, PlantOptions, Stabilisation
from coop_pin.description.scenario import Scenario
from coop_pin.description.sensors import (
    DifferencedVelocity,
    Encoder,
    IdealVelocity,
    ObservedVelocity,
    Sensors,
    SlipSensor,
    WrenchParts,
    WristSensor,
)
from coop_pin.description.servo import SERVOS, Servo
from coop_pin.description.trust import TrustThresholds

__all__ = [
    "SERVOS",
    "Actuators",
    "Arm",
    "ArmClock",
    "Cell",
    "Channel",
    "Clock",
    "Closure",
    "CompliantGrasp",
    "DifferencedVelocity",
    "EdgeChannel",
    "Encoder",
    "GraphChange",
    "GravityCompensation",
    "GravityTurn",
    "HandOver",
    "IdealVelocity",
    "JointFriction",
    "LoseArm",
    "Miscalibration",
    "MobileBase",
    "ModelFactors",
    "Network",
    "ObservedVelocity",
    "Pad",
    "Partner",
    "PatchGrasp",
    "Payload",
    "PayloadChange",
    "PlantOptions",
    "Pose",
    "PutDown",
    "Regrasp",
    "Release",
    "Scenario",
    "Sensors",
    "Servo",
    "SlipSensor",
    "Stabilisation",
    "Table",
    "TrustThresholds",
    "UserController",
    "UserEvent",
    "WrenchParts",
    "WrenchPulse",
    "WristSensor",
    "grasps_from_configuration",
    "scenario_names",
]
