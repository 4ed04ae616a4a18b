"""Identification: who pulls the object apart, from a record of arms: which parameter, by how many newtons.

Open first: ``blame`` (``cp.blame``), ``closure`` (tips, bases, joints, links and clocks from the arms' views
of the payload), ``payload`` (its mass and the wrists' zeros), ``causes`` (what is not told apart, ranked).

- ``estimate``: parameters, priors and fit; ``friction`` of the drives; ``filtering`` of samples and springs;
  ``views`` of the payload and their derivatives.
- ``law_response``: internal force by what the arms see wrong; ``effects``: that of every parameter;
  ``resimulation``: the same by runs, where no formula covers the law; ``newtons`` chooses.
- ``answer`` has all of it; ``error_changes`` make the cell with the errors, ``excitation`` the motion that
  shows more; ``misuse`` tells swapped topics, signs and units.

Imports ``base``, ``compiled``, ``description``, ``grasps``, ``logs``, ``model``, ``results`` and
``simulation``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Blame": "identification.answer",
        "Cause": "identification.causes",
        "DriveFriction": "identification.friction",
        "Fit": "identification.estimate",
        "Parameter": "identification.estimate",
        "Priors": "identification.estimate",
    },
)
