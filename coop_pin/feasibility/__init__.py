"""Feasibility: whether a cell can do its motion, without a run and whatever the law.

Open first: ``reachability`` (reach, singular poses, joint limits and speeds of all arms along the motion),
``statics`` (torque of every drive at rest against its limit), ``motion_feasibility`` (all of it at once).

- Paths: ``path_following`` (poses of the payload, one arm along them), ``carried_motion`` (on shared joints),
  ``distances`` of bodies along them.
- Forces: ``least_squeeze`` (of friction), ``table_force``, ``internal_moment``.
- ``task_inertia``: inertia and wrenches of the motion. ``cell_summary``: what a cell consists of.

Whether the law holds is in ``stability``; proposals are in ``design``.

Imports ``base``, ``control``, ``description``, ``grasps``, ``model``, ``reference`` and ``simulation``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names
from coop_pin.feasibility.carried_motion import seen_by_arms
from coop_pin.feasibility.cell_distances import CellDistances, Exemption
from coop_pin.feasibility.cell_summary import CellSummary, cell_summary, maximum_reach
from coop_pin.feasibility.distances import Distances, Nearest, distances
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
    "CellDistances",
    "CellSummary",
    "Distances",
    "DriveTorque",
    "Exemption",
    "FastestJoint",
    "InternalMoment",
    "JointLimitMargin",
    "LeastSqueeze",
    "MotionWrenches",
    "Nearest",
    "NearlySingular",
    "Reachability",
    "StaticTorques",
    "TableForce",
    "TaskInertia",
    "Unreachable",
    "cell_summary",
    "closure_problem",
    "distances",
    "force_reserve",
    "internal_moment",
    "least_squeeze",
    "loads_without_an_arm",
    "maximum_reach",
    "motion_wrenches",
    "positional_torques",
    "reachability",
    "seen_by_arms",
    "start_torques",
    "static_torques",
    "statics_along",
    "table_force",
    "task_inertia",
]
_, __getattr__, __dir__ = lazy_names(__name__, dict.fromkeys(__all__, ""))
