"""Chain: any mechanism from URDF with loop closures: constrained dynamics, projection, integration.

Open first: ``closed_chain`` (the class: assembly, motion, energy; ``closed_kinematics`` its kinematics),
``dynamics`` (accelerations, closure wrenches, torques of a motion), ``integrators`` (Runge-Kutta methods).

- ``closure_set``: error, Jacobian and drift of one closure, and of all; wheels that roll.
- Solvers of J a + gamma = 0: ``kkt_solver`` (truncated SVD), ``proximal_solver`` (Pinocchio's).
- ``projection`` onto the closures; ``trajectory`` (a motion, step by step).
- ``minimal_coordinates``: independent joints, reduced mass matrix and bias.
- ``linearisation`` about a state.
- ``free_flyer``: pose of a free body and its increments.

It knows no cell, arm or payload; what holds a payload is in ``grasps``.

Imports ``base``, ``description``, ``model`` and ``tracing``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "ChainDynamics": "chain.dynamics",
        "ChainState": "chain.trajectory",
        "ClosureError": "chain.closure_set",
        "Energy": "chain.trajectory",
        "Rolling": "chain.closure_set",
        "Trajectory": "chain.trajectory",
    },
)
