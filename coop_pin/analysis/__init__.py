"""What can be said about a scenario beyond running it."""

import coop_pin.model.require_pinocchio  # noqa: F401  first, so that a missing Pinocchio is told in words
from coop_pin.analysis.arm_reach import ArmReach, FastestJoint, JointLimitMargin, NearlySingular, Unreachable
from coop_pin.analysis.cell_summary import CellSummary, cell_summary
from coop_pin.analysis.reachability import Reachability, reachability
from coop_pin.analysis.sampled_damping import sampled_damping
from coop_pin.analysis.sampled_stability import SampledStability, sampled_stability

__all__ = [
    "ArmReach",
    "CellSummary",
    "FastestJoint",
    "SampledStability",
    "JointLimitMargin",
    "NearlySingular",
    "Unreachable",
    "Reachability",
    "cell_summary",
    "sampled_stability",
    "reachability",
    "sampled_damping",
]
