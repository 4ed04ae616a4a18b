"""Design: proposals for a cell: gains, postures and squeeze, a new cell of given arms, a planned carry.

Open first: ``suggestion`` (rate, gains, postures and squeeze; ``tuning_rule`` computes the gains),
``new_cell`` (a cell from the names of arms: ``named_arms``; ``placing`` puts them),
``carry_plan`` (a carry along a line in least time).

- Of a carry: ``carried_path`` (joint paths and torques), ``carry_limits`` (limits along it),
  ``path_parameterization`` (least time under them, TOPP-RA).
- Of gains: ``posture_gains``, ``proposal_limits``, ``stable_gains`` (those that hold); ``own_inertia`` for
  grasps however soft.

Public names of carries are in ``cp.carry``; ``suggest`` and ``new_cell`` are in ``cp``.

Imports ``base``, ``control``, ``description``, ``feasibility``, ``grasps``, ``model``, ``reference``,
``results``, ``running``, ``simulation`` and ``stability``.
"""

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
_, __getattr__, __dir__ = lazy_names(__name__, dict.fromkeys(__all__, ""))
