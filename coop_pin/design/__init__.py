"""Design of a cell: proposed gains, squeeze and postures, new cells from arms, planned carries."""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names
from coop_pin.design.own_inertia import OwnInertia, deflection_bias, own_inertia, own_inertia_proposal
from coop_pin.design.suggestion import Suggestion
from coop_pin.design.tuning_rule import GainProposal, gain_proposal

__all__ = [
    "GainProposal",
    "OwnInertia",
    "Suggestion",
    "deflection_bias",
    "gain_proposal",
    "own_inertia",
    "own_inertia_proposal",
]
__getattr__, __dir__ = lazy_names(__name__)
