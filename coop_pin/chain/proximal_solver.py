"""Constrained forward dynamics by pinocchio.constraintDynamics: full and point closures, in microseconds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.chain.closure import Closure
from coop_pin.chain.closure_set import ClosureFrame
from coop_pin.description.baumgarte import Stabilisation

# mu = 0, Pinocchio's default, answers NaN on redundant rows; from 1e-8 on twenty steps reach 1e-14.
_ACCURACY, _MU, _STEPS = 1e-14, 1e-8, 20

_TYPES = {(True,) * 6: pin.ContactType.CONTACT_6D, (True,) * 3 + (False,) * 3: pin.ContactType.CONTACT_3D}


class ProximalSolver:
    """M a + h = tau + J^T lambda with J a + gamma + 2 zeta omega e' + omega^2 e = 0, solved proximally."""

    def __init__(self, model: pin.Model, closures: Sequence[Closure], stabilisation: Stabilisation) -> None:
        """Set up Pinocchio's constraints once; closures must be "full" or "point"."""
        self._model, self._data = model, model.createData()
        baumgarte = pin.BaumgarteCorrectorParameters(stabilisation.position_gain, stabilisation.velocity_gain)
        constraints = [_constraint(model, closure, baumgarte) for closure in closures]
        self._constraints = pin.StdVec_RigidConstraintModel(constraints)
        self._constraint_data = pin.StdVec_RigidConstraintData(
            [constraint.createData() for constraint in constraints]
        )
        self._settings = pin.ProximalSettings(_ACCURACY, _MU, _STEPS)
        self._solved = list(
            self._constraint_data
        )  # live references; Pinocchio's own iteration costs more than a solution
        pin.initConstraintDynamics(model, self._data, self._constraints, self._constraint_data)

    @staticmethod
    def can_solve(closures: Sequence[Closure]) -> bool:
        """Say whether Pinocchio's rigid constraints express these rows."""
        return all(closure.mask in _TYPES for closure in closures)

    def acceleration(self, q: Array, v: Array, tau: Array, most_rank: int | None = None) -> Array:
        """Return a, shape (nv,); the proximal method needs no rank."""
        a: Array = pin.constraintDynamics(
            self._model, self._data, q, v, tau, self._constraints, self._constraint_data, self._settings
        )
        return a

    def wrenches(self) -> Array:
        """Return the wrench on body a of each closure at a, in axes a, of the last solve, shape (closures, 6)."""
        return np.array([data.contact_force.vector for data in self._solved]).reshape(-1, 6)


def _constraint(
    model: pin.Model, closure: Closure, baumgarte: pin.BaumgarteCorrectorParameters
) -> pin.RigidConstraintModel:
    a, b = (
        ClosureFrame(model, closure.frame_a, closure.X_a),
        ClosureFrame(model, closure.frame_b, closure.X_b),
    )
    constraint = pin.RigidConstraintModel(
        _TYPES[closure.mask], model, a.joint, a.X_JC, b.joint, b.X_JC, pin.LOCAL
    )
    constraint.setBaumgarteCorrectorParameters(baumgarte)
    return constraint
