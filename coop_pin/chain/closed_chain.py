"""A tree with closures: its forward dynamics, motion, assembly, closure errors, projection and energy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array
from coop_pin.chain.chain_dynamics import ChainDynamics, ChainState, Energy
from coop_pin.chain.closure import Closure
from coop_pin.chain.closure_set import ClosureError, ClosureSet, ClosureState
from coop_pin.chain.kkt_solver import ConstraintSVD, KKTSolver
from coop_pin.chain.projection import Projected, Projection
from coop_pin.chain.proximal_solver import ProximalSolver
from coop_pin.chain.trajectory import Propagator, TorqueLaw, Trajectory, time_grid
from coop_pin.description.plant import Stabilisation
from coop_pin.errors import ArgumentError, ConstraintSolveError
from coop_pin.model.pinocchio_model import configuration_at, frame_id, mechanism_model, velocity_at

Formulation = Literal["auto", "proximal", "kkt"]

_RESIDUAL_ALLOWED = 1e-6
_CLOSED = 1e-9
_START_ALLOWED = 1e-3
_STEP_ALLOWED = 1e-6


class ClosedChain:
    """A tree whose closures hold frames together: any URDF with kinematic loops, no arms or payload needed.

    ::

        chain = ClosedChain.from_urdf("four_bar.urdf", [Closure("coupler_end", "rocker_tip", "point")],
        gravity=(0, 0, -9.81)) start = chain.assemble(chain.configuration({"crank": 1.2}),
        chain.velocity({"crank": 2.0})) motion = chain.integrate(*start, duration=10.0, step=1e-3,
        torque=lambda t, q, v: -0.1 * v)

    Redundant rows and singular poses are allowed. Joint limits, friction and effort of the URDF are not
    applied: torque, a function of time and state, is the place for such forces.

    Attributes:
        model: the tree; ``model.names`` has its joints in the order of v.
        closures: the closures, resolved.
        stabilisation: Baumgarte frequency and damping ratio.
        solver: what solves the constrained dynamics of a state.
    """

    solver: ProximalSolver | KKTSolver

    def __init__(
        self,
        model: pin.Model,
        closures: Sequence[Closure],
        stabilisation: Stabilisation | None = None,
        formulation: Formulation = "auto",
    ) -> None:
        """Close a Pinocchio tree.

        Args:
            model: the tree; it is kept, not copied.
            closures: what closes it.
            stabilisation: Baumgarte's, with 10 rad/s and critical damping when omitted.
            formulation: "proximal" (pinocchio.constraintDynamics: microseconds, "full" and "point" rows
                only), "kkt" (a KKT system cut at its rank, any rows), or "auto": the first for the dynamics
                of one state where it can express the rows, the second elsewhere and for motions. A motion
                leaves the closures a little within each step; the proximal method then takes redundant rows
                of a spatial loop for independent ones and stops the mechanism.

        Raises:
            NameNotFoundError: a frame does not exist.
            FieldError: rows are neither a known name nor six booleans.
            ArgumentError: there is no such formulation, or "proximal" cannot express the rows.
        """
        self.model = model
        self.stabilisation = Stabilisation() if stabilisation is None else stabilisation
        self.closures = ClosureSet(model, closures)
        self._data = model.createData()
        self._projection = Projection(model, self.closures)
        self.solver = self._new_solver(formulation)
        self._mover = (
            KKTSolver(model, self.closures, self.stabilisation) if formulation == "auto" else self.solver
        )

    @classmethod
    def from_urdf(
        cls,
        path_or_xml: str | Path,
        closures: Sequence[Closure] = (),
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        stabilisation: Stabilisation | None = None,
        formulation: Formulation = "auto",
        mimic: Literal["refuse", "ignore"] = "refuse",
    ) -> Self:
        """Close the tree of a URDF, whose root link stands in the world.

        Args:
            path_or_xml: path of a URDF, name of a bundled or example-robot-data robot, or the XML text
                itself.
            closures: what closes it.
            gravity: m/s^2, in world axes, shape (3,).
            stabilisation: as for the constructor.
            formulation: as for the constructor.
            mimic: what to do about joints that mimic others: "refuse" the URDF, or "ignore" the coupling.

        Raises:
            UrdfError: there is no such file; the URDF has structural defects; MimicJointError: joints mimic
                others.
            ShapeError, OutOfRangeError: gravity is not three finite numbers.
            NameNotFoundError, FieldError, ArgumentError: as for the constructor.
        """
        return cls(
            mechanism_model(path_or_xml, gravity, mimic == "ignore"), closures, stabilisation, formulation
        )

    def with_kkt(self) -> ClosedChain:
        """Return the same chain (sharing the tree) solved by the rank-cut KKT."""
        return ClosedChain(self.model, self.closures.closures, self.stabilisation, "kkt")

    def configuration(self, angles: Mapping[str, float]) -> Array:
        """Return the configuration with some joints at given angles (rad, m) and the others neutral, shape (nq,).

        Raises:
            NameNotFoundError: a joint does not exist.
            ArgumentError: a joint has more than one angle.
        """
        return configuration_at(self.model, angles)

    def velocity(self, rates: Mapping[str, float]) -> Array:
        """Return the velocity with some joints at given rates (rad/s, m/s) and the others at rest, shape (nv,).

        Raises:
            NameNotFoundError: a joint does not exist.
            ArgumentError: a joint has more than one rate.
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

    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> ChainDynamics:
        """Return acceleration and closure wrenches, with rank and residual recomputed from the definitions.

        Args:
            q: configuration, shape (nq,).
            v: velocity, shape (nv,).
            tau: generalised force, shape (nv,).

        Raises:
            ConstraintSolveError: the residual is too large.
            MassMatrixError: the mass matrix is not positive definite.
        """
        q, v, tau = self._q(q), self._v("v", v), self._v("tau", tau)
        state = self.closures.state(q, v)
        weighted = self._projection.weighted(q, state)
        a = np.array(self.solver.acceleration(q, v, tau))
        residual = float(np.abs(self._stabilised(state, a)).max(initial=0.0))
        allowed = self._residual_allowed(weighted, a)
        if not residual <= allowed:
            raise ConstraintSolveError(residual, allowed)
        return ChainDynamics(a, self.solver.wrenches(), weighted.rank, residual)

    def integrate(
        self,
        q: ArrayLike,
        v: ArrayLike,
        duration: float,
        step: float,
        torque: TorqueLaw | None = None,
        project: bool = True,
    ) -> Trajectory:
        """Return the motion from a state, by Runge-Kutta 4.

        Args:
            q: configuration at t = 0, shape (nq,), closed to a millimetre and a milliradian: see
                ``assemble``.
            v: velocity at t = 0, shape (nv,).
            duration: s.
            step: s; the last one is shorter where it does not divide duration.
            torque: generalised force as a function of (t, q, v), shape (nv,), N m and N; none when omitted.
            project: whether q and v are projected onto the closures, at the start and after every step.
                Without it the closures drift, held by the stabilisation alone, and a mechanism may not
                survive its singular poses.

        Raises:
            OpenClosureError: the closures are open at the start.
            IntegrationError: the motion breaks down: the step is too long, or torque runs away.
            ArgumentError: torque cannot be called.
            ShapeError, OutOfRangeError: an argument is not what it must be, the value of
                torque included.
        """
        start, time = ChainState(self._q(q), self._v("v", v)), time_grid(duration, step)
        propagator = Propagator(
            self.model, self._mover.acceleration, torque, self._after_step if project else None
        )
        self.require_closed(start.q, _START_ALLOWED)
        if not project:
            return propagator.run(start, None, time)
        *closed, rank = self._projection.state(*start, _CLOSED)
        return propagator.run(ChainState(*closed), rank, time)

    def assemble(self, q_guess: ArrayLike, v_guess: ArrayLike | None = None) -> ChainState:
        """Return a state on the closures: a configuration near a guess, and the velocity nearest to a guess in kinetic energy.

        Args:
            q_guess: configuration, shape (nq,), however far the closures are open.
            v_guess: velocity, shape (nv,); at rest when omitted.

        Raises:
            OpenClosureError: no closed configuration was found from the guess; with the gap that is left.
        """
        q, v = self._q(q_guess), np.zeros(self.model.nv) if v_guess is None else self._v("v_guess", v_guess)
        near = self._projection.descend(q)
        self.require_closed(near, _STEP_ALLOWED)
        projected = self._projection.state(near, v, _CLOSED)
        return ChainState(projected.q, projected.v)

    def energy(self, q: ArrayLike, v: ArrayLike) -> Energy:
        """Return kinetic and potential energy, J."""
        q, v = self._q(q), self._v("v", v)
        kinetic = pin.computeKineticEnergy(self.model, self._data, q, v)
        return Energy(float(kinetic), float(pin.computePotentialEnergy(self.model, self._data, q)))

    def closure_errors(self, q: Array) -> list[ClosureError]:
        """Return how far each closure stands open."""
        return self.closures.closure_errors(q)

    def project_configuration(self, q: ArrayLike) -> Array:
        """Return the configuration on the closures that mass-weighted Newton steps reach from q.

        dq = -M^-1 J^T (J M^-1 J^T)^+ e

        Raises:
            OpenClosureError: the closures cannot be closed from here.
        """
        return self._projection.state(self._q(q), np.zeros(self.model.nv), _CLOSED).q

    def project_velocity(self, q: Array, v: Array) -> Array:
        """Return v - M^-1 J^T (J M^-1 J^T)^+ J v: the nearest velocity, in kinetic energy, that keeps the closures."""
        return self._projection.velocity(q, v)

    def require_closed(self, q: Array, allowed: float) -> None:
        """Refuse a configuration whose closures are open by more than allowed (m, rad).

        Raises:
            OpenClosureError: naming the widest gap.
        """
        self._projection.require_closed(q, allowed)

    def _new_solver(self, formulation: Formulation) -> ProximalSolver | KKTSolver:
        can_be_proximal = ProximalSolver.can_solve(self.closures.closures)
        if formulation not in ("auto", "proximal", "kkt"):
            raise ArgumentError(f"formulation is {formulation!r}; it must be 'auto', 'proximal' or 'kkt'")
        if formulation == "proximal" and not can_be_proximal:
            raise ArgumentError(
                "formulation is 'proximal', which has only 'full' and 'point' rows; use 'auto' or 'kkt'"
            )
        if can_be_proximal and formulation != "kkt":
            return ProximalSolver(self.model, self.closures.closures, self.stabilisation)
        return KKTSolver(self.model, self.closures, self.stabilisation)

    def _after_step(self, q: Array, v: Array, rank: int | None) -> Projected:
        return self._projection.state(q, v, _STEP_ALLOWED, rank)

    def _stabilised(self, state: ClosureState, a: Array) -> Array:
        """Return J a + gamma + 2 zeta omega e' + omega^2 e, which a solution makes zero."""
        gains = self.stabilisation
        return (
            state.jacobian @ a
            + state.drift
            + gains.velocity_gain * state.velocity
            + gains.position_gain * state.position
        )

    def _residual_allowed(self, weighted: ConstraintSVD, a: Array) -> float:
        """Return the largest residual that a solution may leave; rows dropped next to a singular pose still see the motion."""
        seen = weighted.dropped * float(np.linalg.norm(weighted.factor.T @ a))
        return _RESIDUAL_ALLOWED * (1.0 + float(np.abs(a).max(initial=0.0))) + 10.0 * seen

    def _q(self, q: ArrayLike) -> Array:
        return as_array("q", q, self.model.nq)

    def _v(self, name: str, v: ArrayLike) -> Array:
        return as_array(name, v, self.model.nv)
