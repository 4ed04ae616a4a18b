"""Analysis of scenarios and cells without a run: reachability, sampled stability and summaries."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin.analysis.cell_summary import CellSummary, cell_summary, maximum_reach
from coop_pin.analysis.path_following import FastestJoint, JointLimitMargin, NearlySingular, Unreachable
from coop_pin.analysis.reachability import ArmReach, Reachability, reachability
from coop_pin.analysis.sampled_stability import SampledStability, sampled_stability

__all__ = [
    "ArmReach",
    "CellSummary",
    "FastestJoint",
    "JointLimitMargin",
    "NearlySingular",
    "Reachability",
    "SampledStability",
    "Unreachable",
    "cell_summary",
    "maximum_reach",
    "reachability",
    "sampled_stability",
]
