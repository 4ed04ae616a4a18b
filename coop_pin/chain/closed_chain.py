"""A tree with closures: its forward dynamics, closure errors, projection and energy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array
from coop_pin.chain.closure import Closure
from coop_pin.chain.closures import Closures, ClosureState, Gap
from coop_pin.chain.proximal import ProximalSolver
from coop_pin.chain.rank_cut import MassWeightedClosure, RankCutSolver, mass_weighted
from coop_pin.description.clock import Stabilisation
from coop_pin.errors import ConstraintSolveError, OpenClosureError
from coop_pin.model.pinocchio_model import symmetric

_RESIDUAL_ALLOWED = 1e-6
_PROJECTION_STEPS = 60
_CLOSED = 1e-12


class ChainDynamics(NamedTuple):
    """Forward dynamics of a closed chain.

    Attributes:
        acceleration: a, shape (nv,).
        closure_wrenches: on body a of each closure, at a, in axes a, N and N m, shape (closures, 6).
        rank: number of independent closure rows.
        residual: largest entry of J a + gamma + stabilisation, m/s^2 or rad/s^2.
    """

    acceleration: Array
    closure_wrenches: Array
    rank: int
    residual: float


class Energy(NamedTuple):
    """Mechanical energy, J.

    Attributes:
        kinetic: J.
        potential: J.
    """

    kinetic: float
    potential: float

    @property
    def total(self) -> float:
        """Kinetic plus potential, J."""
        return self.kinetic + self.potential


class ClosedChain:
    """A Pinocchio tree whose closures hold frames together.

    Attributes:
        model: the tree.
        closures: the closures, resolved.
        stabilisation: Baumgarte frequency and damping ratio.
        solver: what solves the constrained dynamics.
    """

    solver: ProximalSolver | RankCutSolver

    def __init__(self, model: pin.Model, closures: Sequence[Closure], stabilisation: Stabilisation | None = None) -> None:
        """Close a tree; pinocchio.constraintDynamics solves it where it can express the rows, the rank-cut KKT elsewhere.

        Raises:
            FrameNotFoundError: a frame does not exist.
        """
        self.model = model
        self.stabilisation = Stabilisation() if stabilisation is None else stabilisation
        self.closures = Closures(model, closures)
        self._data = model.createData()
        if ProximalSolver.can_solve(self.closures.closures):
            self.solver = ProximalSolver(model, self.closures.closures, self.stabilisation)
        else:
            self.solver = RankCutSolver(model, self.closures, self.stabilisation)

    def with_rank_cut(self) -> ClosedChain:
        """Return the same chain (sharing the tree) solved by the rank-cut KKT."""
        chain = ClosedChain(self.model, self.closures.closures, self.stabilisation)
        chain.solver = RankCutSolver(self.model, self.closures, self.stabilisation)
        return chain

    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> ChainDynamics:
        """Return acceleration and closure wrenches, with rank and residual recomputed from the definitions.

        Args:
            q: configuration, shape (nq,).
            v: velocity, shape (nv,).
            tau: generalised force, shape (nv,).

        Raises:
            ConstraintSolveError: the residual is too large.
        """
        q, v, tau = self._q(q), as_array("v", v, self.model.nv), as_array("tau", tau, self.model.nv)
        a = np.array(self.solver.acceleration(q, v, tau))
        state = self.closures.state(q, v)
        residual = float(np.abs(self._stabilised(state, a)).max(initial=0.0))
        allowed = _RESIDUAL_ALLOWED * (1.0 + float(np.abs(a).max(initial=0.0)))
        if not residual <= allowed:
            raise ConstraintSolveError(residual, allowed)
        return ChainDynamics(a, self.solver.wrenches(), self._weighted(q, state).rank, residual)

    def _stabilised(self, state: ClosureState, a: Array) -> Array:
        """Return J a + gamma + 2 zeta omega e' + omega^2 e, which a solution makes zero."""
        gains = self.stabilisation
        return state.jacobian @ a + state.drift + gains.velocity_gain * state.velocity + gains.position_gain * state.position

    def gaps(self, q: Array) -> list[Gap]:
        """Return how far each closure stands open."""
        return self.closures.gaps(q)

    def project_configuration(self, q: ArrayLike) -> Array:
        """Return the configuration on the closures that mass-weighted Newton steps reach from q.

        dq = -M^-1 J^T (J M^-1 J^T)^+ e

        Raises:
            OpenClosureError: the closures cannot be closed from here.
        """
        closed = self._q(q)
        still = np.zeros(self.model.nv)
        for _ in range(_PROJECTION_STEPS):
            state = self.closures.state(closed, still)
            if np.abs(state.position).max(initial=0.0) < _CLOSED:
                break
            closed = pin.integrate(self.model, closed, self._weighted(closed, state).least_motion(-state.position))
        self.require_closed(closed, allowed=1e-9)
        return closed

    def project_velocity(self, q: Array, v: Array) -> Array:
        """Return v - M^-1 J^T (J M^-1 J^T)^+ J v: the nearest velocity, in kinetic energy, that keeps the closures."""
        state = self.closures.state(q, v)
        return v - self._weighted(q, state).least_motion(state.velocity)

    def require_closed(self, q: Array, allowed: float) -> None:
        """Refuse a configuration whose closures are open by more than allowed (m, rad).

        Raises:
            OpenClosureError: naming the widest gap.
        """
        for closure, gap in zip(self.closures.closures, self.gaps(q), strict=True):
            if not max(gap) <= allowed:
                raise OpenClosureError(closure.name, gap.distance, gap.angle, allowed)

    def energy(self, q: Array, v: Array) -> Energy:
        """Return kinetic and potential energy, J."""
        kinetic = pin.computeKineticEnergy(self.model, self._data, q, v)
        return Energy(float(kinetic), float(pin.computePotentialEnergy(self.model, self._data, q)))

    def _weighted(self, q: Array, state: ClosureState) -> MassWeightedClosure:
        return mass_weighted(symmetric(pin.crba(self.model, self._data, q)), state.jacobian)

    def _q(self, q: ArrayLike) -> Array:
        return as_array("q", q, self.model.nq)
