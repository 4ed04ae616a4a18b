"""Kinematics of a closed chain: named joints, assembly, projection onto the closures, and energy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_array, as_number, require_type
from coop_pin.chain.closure_set import ClosureError, ClosureSet, Rolling
from coop_pin.chain.minimal_coordinates import MinimalCoordinates, MinimalForm
from coop_pin.chain.projection import STEP_ALLOWED, Projection
from coop_pin.chain.trajectory import ChainState, Energy
from coop_pin.description.cell.closure import Closure
from coop_pin.model.mechanism_model import velocity_at
from coop_pin.model.pinocchio_model import frame_id, kinetic_energy

CLOSED = 1e-9
"""Closure error after a projection of a configuration, m and rad."""
OPEN_ALLOWED = 1e-3
"""Closure error up to which a stated configuration is closed, m and rad: one in rounded numbers."""


class ClosedKinematics:
    """Tree with loop closures, by position and velocity.

    Attributes:
        model: the tree; ``model.names`` has its joints in the order of v.
        closures: the closures with their frames.
        open_allowed: closure error beyond which a configuration is refused, m and rad.
        minimal_form: minimal coordinates of the chain.
    """

    def __init__(
        self,
        model: pin.Model,
        closures: Sequence[Closure],
        open_allowed: float = OPEN_ALLOWED,
        rolling: Sequence[Rolling] = (),
    ) -> None:
        """Close a Pinocchio tree; arguments and errors as of ClosedChain."""
        self.closures, self.model = ClosureSet(model, closures, rolling), model
        self.open_allowed = as_number("open_allowed", open_allowed)
        self._data = model.createData()
        self._projection = Projection(model, self.closures)
        self.minimal_form = MinimalForm(model, self.closures, self._projection)

    def configuration(self, angles: Mapping[str, float]) -> Array:
        """Return q with named joints at given positions (rad, m) and the others neutral, shape (nq,).

        Raises:
            NameNotFoundError: a joint does not exist.
            ArgumentError: a joint has more than one degree of freedom.
        """
        require_type("angles", angles, Mapping)
        return pin.integrate(self.model, pin.neutral(self.model), velocity_at(self.model, angles))

    def velocity(self, rates: Mapping[str, float]) -> Array:
        """Return v with named joints at given rates (rad/s, m/s) and the others at rest, shape (nv,).

        Raises:
            NameNotFoundError: a joint does not exist.
            ArgumentError: a joint has more than one degree of freedom.
        """
        return velocity_at(self.model, rates)

    def frame_pose(self, q: ArrayLike, frame: str) -> Array:
        """Return the pose X_WF of a frame in the world, shape (4, 4).

        Raises:
            NameNotFoundError: the frame does not exist.
        """
        index = frame_id(self.model, frame)
        pin.forwardKinematics(self.model, self._data, self._q(q))
        return np.array(pin.updateFramePlacement(self.model, self._data, index).homogeneous)

    def constraint_jacobian(self, q: ArrayLike) -> Array:
        """Return J of the closures, stacked in their order, in axes of their frames a, shape (r, nv)."""
        return self.closures.state(self._q(q), np.zeros(self.model.nv)).jacobian

    def minimal_coordinates(self, q: ArrayLike, joints: Sequence[str] | None = None) -> MinimalCoordinates:
        """Return independent joint velocities at a configuration, and the null space of J.

        Args:
            q: configuration on the closures, shape (nq,).
            joints: names of the joints to take, one degree of freedom each; of the best condition when
                omitted.

        Raises:
            OpenClosureError: a closure is open at q.
            ArgumentError: the joints do not determine the motion.
            NameNotFoundError: a joint does not exist.
        """
        return self.minimal_form.coordinates(self.closed(q), joints)

    def rank(self, q: ArrayLike) -> int:
        """Return the number of independent closure rows at a configuration, shape (nq,)."""
        q = self._q(q)
        return self._projection.svd(q, self.closures.state(q, np.zeros(self.model.nv))).rank

    def assemble(self, q_guess: ArrayLike, v_guess: ArrayLike | None = None) -> ChainState:
        """Return a closed state near a guess; its velocity is the nearest to the guess in kinetic energy.

        Args:
            q_guess: configuration, shape (nq,), with closure errors of any size.
            v_guess: velocity, shape (nv,); at rest when omitted.

        Raises:
            OpenClosureError: no closed configuration was found; with the remaining closure error.
        """
        q, v = self._q(q_guess), np.zeros(self.model.nv) if v_guess is None else self._v("v_guess", v_guess)
        near = self._projection.descend(q)
        self.require_closed(near, STEP_ALLOWED)
        return ChainState(*self._projection.state(near, v, CLOSED)[:2])

    def energy(self, q: ArrayLike, v: ArrayLike) -> Energy:
        """Return kinetic and potential energy, J."""
        q, v = self._q(q), self._v("v", v)
        pin.forwardKinematics(self.model, self._data, q, v)
        kinetic = kinetic_energy(self.model, self._data, v, has_rotors=bool(self.model.armature.any()))
        return Energy(kinetic, float(pin.computePotentialEnergy(self.model, self._data, q)))

    def closure_errors(self, q: ArrayLike) -> list[ClosureError]:
        """Return the closure error of each closure."""
        return self.closures.closure_errors(self._q(q))

    def project_configuration(self, q: ArrayLike) -> Array:
        """Return the configuration on the closures reached from q by mass-weighted Newton steps.

        dq = -M^-1 J^T (J M^-1 J^T)^+ e

        Raises:
            OpenClosureError: the steps do not converge to a closed configuration.
        """
        return self._projection.state(self._q(q), np.zeros(self.model.nv), CLOSED).q

    def project_velocity(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the velocity nearest in kinetic energy that keeps the closures closed, shape (nv,).

        v - M^-1 J^T (J M^-1 J^T)^+ J v
        """
        return self._projection.velocity(self._q(q), self._v("v", v))

    def require_closed(self, q: ArrayLike, allowed: float) -> None:
        """Raise an error if a closure error exceeds what is allowed (m, rad).

        Raises:
            OpenClosureError: with the largest closure error.
        """
        self._projection.require_closed(self._q(q), as_number("allowed", allowed))

    def closed(self, q: ArrayLike) -> Array:
        """Return a stated configuration whose closures are closed, shape (nq,).

        Raises:
            OpenClosureError: a closure error exceeds ``open_allowed``.
        """
        q = self._q(q)
        self._projection.require_closed(q, self.open_allowed)
        return q

    def _q(self, q: ArrayLike) -> Array:
        return as_array("q", q, self.model.nq)

    def _v(self, name: str, v: ArrayLike) -> Array:
        return as_array(name, v, self.model.nv)
