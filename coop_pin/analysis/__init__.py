"""Analysis of scenarios and cells: reachability, sampled stability, step size and summaries."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names
from coop_pin.analysis.admittance_stability import AdmittanceStability, admittance_stability
from coop_pin.analysis.carry_plan import CarryPlan, plan_carry
from coop_pin.analysis.cell_summary import CellSummary, cell_summary, maximum_reach
from coop_pin.analysis.closed_loop import ClosedLoop, eigenvalues
from coop_pin.analysis.feasibility import closure_problem
from coop_pin.analysis.grasp_stability import GraspStability, grasp_stability
from coop_pin.analysis.internal_moment import InternalMoment, internal_moment, positional_torques
from coop_pin.analysis.least_squeeze import LeastSqueeze, least_squeeze
from coop_pin.analysis.loop_stability import LoopStability, loop_stability
from coop_pin.analysis.modes import Mode
from coop_pin.analysis.new_cell import new_cell
from coop_pin.analysis.own_inertia import OwnInertia, deflection_bias, own_inertia, own_inertia_proposal
from coop_pin.analysis.path_following import FastestJoint, JointLimitMargin, NearlySingular, Unreachable
from coop_pin.analysis.path_parameterization import PathLimits, fastest
from coop_pin.analysis.plausibility import (
    gains_are_known,
    implausible_numbers,
    large_record,
    run_warnings,
)
from coop_pin.analysis.reachability import ArmReach, Reachability, reachability
from coop_pin.analysis.reserves import force_reserve, loads_without_an_arm
from coop_pin.analysis.root_locus import RootLocus, root_locus
from coop_pin.analysis.sampled_motion import SampledMotion, sampled_motion
from coop_pin.analysis.sampled_stability import (
    SampledStability,
    motion_stability,
    sampled_stability,
    start_stability,
)
from coop_pin.analysis.statics import (
    ArmStatics,
    DriveTorque,
    StaticTorques,
    start_torques,
    static_torques,
    statics_along,
)
from coop_pin.analysis.steady_errors import SteadyErrors, anchor_biases, steady_errors
from coop_pin.analysis.step_size import StepSize, fewest_steps
from coop_pin.analysis.step_stability import StepStability, step_stability
from coop_pin.analysis.suggestion import Suggestion, suggest
from coop_pin.analysis.table_force import TableForce, table_force
from coop_pin.analysis.task_inertia import MotionWrenches, TaskInertia, motion_wrenches, task_inertia
from coop_pin.analysis.tuning_rule import GainProposal, gain_proposal

__all__ = [
    "AdmittanceStability",
    "ArmReach",
    "ArmStatics",
    "CarryPlan",
    "CellSummary",
    "ClosedLoop",
    "DriveTorque",
    "FastestJoint",
    "GainProposal",
    "GraspStability",
    "InternalMoment",
    "JointLimitMargin",
    "LeastSqueeze",
    "LoopStability",
    "Mode",
    "MotionWrenches",
    "NearlySingular",
    "OwnInertia",
    "PathLimits",
    "Reachability",
    "RootLocus",
    "SampledMotion",
    "SampledStability",
    "StaticTorques",
    "SteadyErrors",
    "StepSize",
    "StepStability",
    "Suggestion",
    "TableForce",
    "TaskInertia",
    "Unreachable",
    "admittance_stability",
    "anchor_biases",
    "anchor_bounded_time",
    "cell_summary",
    "closure_problem",
    "deflection_bias",
    "eigenvalues",
    "fastest",
    "fewest_steps",
    "force_reserve",
    "gain_proposal",
    "gains_are_known",
    "grasp_stability",
    "implausible_numbers",
    "internal_moment",
    "large_record",
    "least_squeeze",
    "loads_without_an_arm",
    "loop_stability",
    "maximum_reach",
    "motion_stability",
    "motion_wrenches",
    "new_cell",
    "own_inertia",
    "own_inertia_proposal",
    "plan_carry",
    "positional_torques",
    "reachability",
    "root_locus",
    "run_warnings",
    "sampled_motion",
    "sampled_stability",
    "start_stability",
    "start_torques",
    "static_torques",
    "statics_along",
    "steady_errors",
    "step_stability",
    "suggest",
    "table_force",
    "task_inertia",
    "theorem_monitor",
]

__getattr__, __dir__ = lazy_names(__name__, dict.fromkeys(__all__, "coop_pin.analysis.proof"))
"""The names that are not imported above are those of the monitors, which are slow to load."""
