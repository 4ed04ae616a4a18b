"""Proximal solver for constrained forward dynamics with full and point closures, by Pinocchio."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.errors import ArgumentError
from coop_pin.chain.closure_set import ClosureSet, ClosureState
from coop_pin.description.cell.closure import Closure
from coop_pin.description.plant import Stabilisation

# mu = 0, Pinocchio's default, gives NaN on redundant rows; from 1e-8 on twenty steps reach 1e-14.
_ACCURACY, _MU, _STEPS = 1e-14, 1e-8, 20

_TYPES = {(True,) * 6: pin.ContactType.CONTACT_6D, (True,) * 3 + (False,) * 3: pin.ContactType.CONTACT_3D}

_MOVED = 1e-12
"""Entry of the constraint Jacobian that is rounding: such rows are moved by no joint."""


class DynamicsDerivatives(NamedTuple):
    """Partial derivatives of accelerations and closure wrenches at a state.

    Attributes:
        acceleration_q: derivative of a by a change of q in the tangent space, shape (nv, nv).
        acceleration_v: derivative of a by v, shape (nv, nv).
        acceleration_tau: derivative of a by tau, shape (nv, nv).
        wrench_q: derivative of the closure wrenches by q, shape (closures, 6, nv).
        wrench_v: derivative of the closure wrenches by v, likewise.
        wrench_tau: derivative of the closure wrenches by tau, likewise.
    """

    acceleration_q: Array
    acceleration_v: Array
    acceleration_tau: Array
    wrench_q: Array
    wrench_v: Array
    wrench_tau: Array


class ProximalSolver:
    """M a + h = tau + J^T lambda with J a + gamma + 2 zeta omega e' + omega^2 e = 0, solved proximally.

    A solution takes microseconds. The solver keeps the last one for wrenches().
    """

    def __init__(self, model: pin.Model, closures: ClosureSet, stabilisation: Stabilisation) -> None:
        """Set up Pinocchio's constraints; the rows of all closures must be "full" or "point"."""
        self._model, self._data = model, model.createData()
        baumgarte = pin.BaumgarteCorrectorParameters(stabilisation.position_gain, stabilisation.velocity_gain)
        self._constraints = pin.StdVec_RigidConstraintModel()
        for closure, (a, b) in zip(closures.closures, closures.sides, strict=True):
            kind = _TYPES[closure.mask]
            constraint = pin.RigidConstraintModel(kind, model, a.joint, a.X_JC, b.joint, b.X_JC, pin.LOCAL)
            constraint.setBaumgarteCorrectorParameters(baumgarte)
            self._constraints.append(constraint)
        self._constraint_data = pin.StdVec_RigidConstraintData(
            [constraint.createData() for constraint in self._constraints]
        )
        # Live references, because iterating over Pinocchio's vector takes longer than a solution.
        self.forces: list[pin.Force] = [data.contact_force for data in self._constraint_data]
        self._settings = pin.ProximalSettings(_ACCURACY, _MU, _STEPS)
        pin.initConstraintDynamics(model, self._data, self._constraints, self._constraint_data)

    @staticmethod
    def can_solve(closures: Sequence[Closure]) -> bool:
        """Return whether Pinocchio's rigid constraints can express the rows of all closures."""
        return all(closure.mask in _TYPES for closure in closures)

    def acceleration(self, q: Array, v: Array, tau: Array) -> Array:
        """Return a, shape (nv,).

        Args:
            q: configuration, shape (nq,).
            v: velocity, shape (nv,).
            tau: generalised force, shape (nv,).
        """
        return pin.constraintDynamics(
            self._model, self._data, q, v, tau, self._constraints, self._constraint_data, self._settings
        )

    def wrenches(self) -> Array:
        """Return the closure wrenches (see ChainDynamics) of the last solution, shape (closures, 6)."""
        return np.array([force.vector for force in self.forces]).reshape(-1, 6)

    def derivatives(self, q: Array, v: Array, tau: Array) -> DynamicsDerivatives:
        """Return derivatives at a state by Pinocchio's computeConstraintDynamicsDerivatives.

        They are right for "full" rows that are independent; the caller sees to it.
        """
        self.acceleration(q, v, tau)
        parts = pin.computeConstraintDynamicsDerivatives(
            self._model, self._data, self._constraints, self._constraint_data, self._settings
        )
        a, w = [np.array(part) for part in parts[:3]], [part.reshape(-1, 6, len(v)) for part in parts[3:]]
        return DynamicsDerivatives(*a, *map(np.array, w))


def require_full_rows(closures: ClosureSet, state: ClosureState, rank: int) -> None:
    """Raise an error if the derivatives of a state are not those of Pinocchio.

    Args:
        closures: closures of the chain.
        state: their state.
        rank: number of independent closure rows.

    Raises:
        ArgumentError: a closure has other rows than "full", or rows that joints move are redundant.
    """
    if closures.rolling:
        raise ArgumentError("wheels roll, whose rows are not those of closures; use forward_dynamics")
    partial = [closure.name for closure in closures.closures if not all(closure.mask)]
    if partial:
        raise ArgumentError(f"the rows of closure {partial[0]!r} are not 'full'; use linearise")
    moved = int(np.count_nonzero(np.abs(state.jacobian).max(axis=1, initial=0.0) > _MOVED))
    if rank < moved:
        raise ArgumentError(f"{moved - rank} of {moved} closure rows are redundant here; use linearise")
