"""Feasibility of a scenario: reach, limits, static torques, least squeeze, task inertia along its motion."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names
from coop_pin.feasibility.cell_summary import CellSummary, cell_summary, maximum_reach
from coop_pin.feasibility.internal_moment import InternalMoment, internal_moment, positional_torques
from coop_pin.feasibility.least_squeeze import LeastSqueeze, least_squeeze
from coop_pin.feasibility.motion_feasibility import closure_problem
from coop_pin.feasibility.path_following import FastestJoint, JointLimitMargin, NearlySingular, Unreachable
from coop_pin.feasibility.reachability import ArmReach, Reachability, reachability
from coop_pin.feasibility.reserves import force_reserve, loads_without_an_arm
from coop_pin.feasibility.statics import (
    ArmStatics,
    DriveTorque,
    StaticTorques,
    start_torques,
    static_torques,
    statics_along,
)
from coop_pin.feasibility.table_force import TableForce, table_force
from coop_pin.feasibility.task_inertia import MotionWrenches, TaskInertia, motion_wrenches, task_inertia

__all__ = [
    "ArmReach",
    "ArmStatics",
    "CellSummary",
    "DriveTorque",
    "FastestJoint",
    "InternalMoment",
    "JointLimitMargin",
    "LeastSqueeze",
    "MotionWrenches",
    "NearlySingular",
    "Reachability",
    "StaticTorques",
    "TableForce",
    "TaskInertia",
    "Unreachable",
    "cell_summary",
    "closure_problem",
    "force_reserve",
    "internal_moment",
    "least_squeeze",
    "loads_without_an_arm",
    "maximum_reach",
    "motion_wrenches",
    "positional_torques",
    "reachability",
    "start_torques",
    "static_torques",
    "statics_along",
    "table_force",
    "task_inertia",
]
__getattr__, __dir__ = lazy_names(__name__)
