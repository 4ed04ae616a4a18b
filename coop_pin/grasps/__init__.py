"""Grasps: what holds the payload of a cell, as closures or as force elements, and the cell's closed chain.

Open first: ``cell_chain`` (closed chain of a cell; ``cell_dynamics`` has its interaction wrenches),
``force_elements`` (wrenches between frames: what a new kind of grasp that gives would be), ``rigid_grasps``
(closures that come and go, hinges and balls among them).

- Springs: ``grasp_springs`` (compliant grasps), ``spring_damper`` (law, also of a partner's hand).
- Friction: ``contact_points`` (friction force of a point that sticks or slides), ``contact_patches`` (palms
  and tables made of such points).
- ``friction_cones``: least internal wrenches with which pads hold the payload.
- At rest: ``equilibrium``, ``contact_equilibrium``.
- Kinematics: ``cell_kinematics`` (payload, tips, grasps), ``grasp_frames`` (their motion).
- ``observation``: the quantities that a plant computes at a state, for all engines.

What a user writes of grasps is in ``description/cell``.

Imports ``base``, ``chain``, ``description``, ``model`` and ``tracing``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "CellChain": "grasps.cell_chain",
        "JointGrasp": "description.cell.grasp",
        "ToolTip": "description.cell.grasp",
        "grasps_from_configuration": "description.cell.grasp",
    },
)
