"""Design of a cell: proposed gains, squeeze and postures, new cells from arms, planned carries."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin.design.carry_plan import CarryPlan, plan_carry
from coop_pin.design.new_cell import new_cell
from coop_pin.design.own_inertia import OwnInertia, deflection_bias, own_inertia, own_inertia_proposal
from coop_pin.design.path_parameterization import PathLimits, fastest
from coop_pin.design.suggestion import Suggestion, suggest
from coop_pin.design.tuning_rule import GainProposal, gain_proposal

__all__ = [
    "CarryPlan",
    "GainProposal",
    "OwnInertia",
    "PathLimits",
    "Suggestion",
    "deflection_bias",
    "fastest",
    "gain_proposal",
    "new_cell",
    "own_inertia",
    "own_inertia_proposal",
    "plan_carry",
    "suggest",
]
