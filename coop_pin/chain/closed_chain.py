"""Closed chain: dynamics, linear model and motion of a tree with loop closures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Self, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, Mask, require_known, require_type
from coop_pin.base.errors import ArgumentError
from coop_pin.chain.closed_kinematics import CLOSED, OPEN_ALLOWED, ClosedKinematics
from coop_pin.chain.closure_set import Rolling
from coop_pin.chain.dynamics import (
    ChainDynamics,
    InverseDynamics,
    checked_dynamics,
    over_states,
    torque_of_motion,
)
from coop_pin.chain.kkt_solver import KKTSolver
from coop_pin.chain.linearisation import Linearisation, equilibrium, linearised
from coop_pin.chain.minimal_coordinates import ReducedDynamics
from coop_pin.chain.proximal_solver import DynamicsDerivatives, ProximalSolver, require_full_rows
from coop_pin.chain.trajectory import ChainState, Propagator, TorqueLaw, Trajectory, time_grid
from coop_pin.description.cell.closure import Closure
from coop_pin.description.plant import Formulation, Stabilisation
from coop_pin.model.mechanism_model import mechanism_model


class ClosedChain(ClosedKinematics):
    """Mechanism with loop closures: any URDF tree, and closures between its frames.

    ::

        chain = ClosedChain.from_urdf("four_bar.urdf", [Closure("coupler_end", "rocker_tip", "point")])
        start = chain.assemble(chain.configuration({"crank": 1.2}), chain.velocity({"crank": 2.0}))
        motion = chain.integrate(*start, duration=10.0, step=1e-3, torque=lambda t, q, v: -0.1 * v)

    Every method with dynamics refuses a configuration whose loop is open, by OpenClosureError: ``assemble``
    closes it. Redundant rows and singular poses are allowed. Joint limits, friction and effort limits of the
    URDF are not applied; such forces can be added in ``torque``, a function of time and state.

    Solver and data are working memory: methods return copies, but ``solver.wrenches()`` refers to the last
    ``solver.acceleration``, and two threads must not use one chain at once.

    Attributes:
        model: the tree; ``model.names`` has its joints in the order of v.
        closures: the closures with their frames.
        stabilisation: Baumgarte frequency and damping ratio.
        formulation: formulation of the constrained dynamics.
        solver: solver of the constrained dynamics of a state.
    """

    def __init__(
        self,
        model: pin.Model,
        closures: Sequence[Closure],
        *,
        stabilisation: Stabilisation | None = None,
        formulation: Formulation = "auto",
        open_allowed: float = OPEN_ALLOWED,
        rolling: Sequence[Rolling] = (),
    ) -> None:
        """Close a Pinocchio tree.

        Args:
            model: the tree; it is kept, not copied.
            closures: closures between its frames.
            stabilisation: Baumgarte's; 10 rad/s and critical damping when omitted.
            formulation: "proximal" (pinocchio.constraintDynamics: microseconds, "full" and "point" rows
                only), "kkt" (a KKT system by truncated SVD, any rows), or "auto": "proximal" for the dynamics
                of one state if it can express the rows, else and for ``integrate`` "kkt". Steps leave the
                closures slightly, and "proximal" then takes redundant rows for independent ones and stops.
            open_allowed: closure error beyond which dynamics are refused at a configuration, m and rad. With
                a large one, accelerations off the closures are the stabilisation's.
            rolling: wheels that roll without sliding sideways; their rows need "kkt".

        Raises:
            NameNotFoundError: a frame or a joint does not exist.
            FieldError: rows are neither a known name nor six booleans.
            ArgumentError: there is no such formulation, or "proximal" cannot express the rows.
        """
        super().__init__(model, closures, open_allowed, rolling)
        self.stabilisation = Stabilisation() if stabilisation is None else stabilisation
        require_type("stabilisation", self.stabilisation, Stabilisation)
        self.formulation = formulation
        if not isinstance(formulation, str) or formulation not in get_args(Formulation):
            raise ArgumentError(f"formulation is {formulation!r}; it must be 'auto', 'proximal' or 'kkt'")
        can_be_proximal = ProximalSolver.can_solve(closures) and not rolling
        if formulation == "proximal" and not can_be_proximal:
            raise ArgumentError("formulation is 'proximal', of only 'full' and 'point' rows; use 'kkt'")
        kind = ProximalSolver if can_be_proximal and formulation != "kkt" else KKTSolver
        self.solver: ProximalSolver | KKTSolver = kind(model, self.closures, self.stabilisation)

    @classmethod
    def from_urdf(
        cls,
        path_or_xml: str | Path,
        closures: Sequence[Closure] = (),
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        stabilisation: Stabilisation | None = None,
        formulation: Formulation = "auto",
        open_allowed: float = OPEN_ALLOWED,
        mimic: Literal["refuse", "ignore"] = "refuse",
        package_dirs: Sequence[str] = (),
        xacro_args: Mapping[str, str] = MappingProxyType({}),
    ) -> Self:
        """Close the tree of a URDF with its root link fixed in the world.

        Its loops become closures with their names in the file; coop_pin.description.urdf.loops has the forms.

        Args:
            path_or_xml: path of a URDF or xacro file, name of a known robot, or the XML text itself.
            closures: closures between its frames, after those of the file.
            gravity: m/s^2, in world axes, shape (3,).
            stabilisation: stabilisation, as for the constructor.
            formulation: formulation, as for the constructor.
            open_allowed: largest closure error, as for the constructor.
            mimic: "refuse" a URDF with mimic joints, or "ignore" their coupling.
            package_dirs: folders that are searched first for packages.
            xacro_args: values of the arguments of a xacro file.

        Raises:
            MissingExtraError: it is a xacro file without xacrodoc; MimicJointError: mimic joints.
            UrdfError: no such file, structural defects, an unreadable loop.
            ShapeError, OutOfRangeError: gravity is not three finite numbers.
            NameNotFoundError, FieldError, ArgumentError: as for the constructor.
        """
        require_type("closures", closures, Sequence)
        require_known("mimic", mimic, ("refuse", "ignore"), "from_urdf")
        model, loops = mechanism_model(path_or_xml, gravity, mimic == "ignore", package_dirs, xacro_args)
        options: Any = {"formulation": formulation, "open_allowed": open_allowed}
        return cls(model, [*loops, *closures], stabilisation=stabilisation, **options)

    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> ChainDynamics:
        """Return accelerations and closure wrenches, with rank and residual computed from their definitions.

        Args:
            q: configuration on the closures, shape (nq,).
            v: velocity, shape (nv,).
            tau: generalised force, shape (nv,).

        Raises:
            ConstraintSolveError: the residual is too large.
            MassMatrixError: the mass matrix is not positive definite.
        """
        q, v, tau = self.closed(q), self._v("v", v), self._v("tau", tau)
        state = self.closures.state(q, v)
        a = np.array(self.solver.acceleration(q, v, tau))
        svd, residual = self._projection.svd(q, state), state.stabilised(a, self.stabilisation)
        return checked_dynamics(state, svd, a, self.solver.wrenches(), residual)

    def inverse_dynamics(
        self,
        q: ArrayLike,
        v: ArrayLike,
        a: ArrayLike,
        *,
        closure_wrenches: ArrayLike | None = None,
        motors: Sequence[str] | None = None,
        applied: ArrayLike | None = None,
    ) -> InverseDynamics:
        """Return torques of the motors that cause a motion, ``tau + applied + J^T lambda = M a + h``.

        With stated closure wrenches they are the torques of this motion and these wrenches; otherwise those
        of least tau^T tau, with the wrenches that follow. At rest they are equilibrium torques. All arrays
        are of one state, or of n states with n as their first size.

        Args:
            q: configuration on the closures, shape (nq,).
            v: velocity, shape (nv,).
            a: acceleration that keeps the closures closed, J a + gamma = 0, shape (nv,).
            closure_wrenches: wrench on body a of each closure at frame a, in axes of a, N and N m, shape
                (closures, 6).
            motors: names of the joints with motors, for the least torque; all when omitted.
            applied: generalised force of all but motors and closures, such as friction, shape (nv,), or zero.

        Raises:
            ArgumentError: the acceleration opens the closures, the closures do not transmit such a wrench,
                or the motors cannot cause the motion.
            NameNotFoundError: a joint does not exist.
        """
        nq, nv = self.model.nq, self.model.nv
        powered = np.full(nv, motors is None)
        powered[[] if motors is None else self.minimal_form.indices(motors)] = True
        return over_states(
            lambda *state: self._inverse_dynamics(*state, motors=powered),
            ("q", q, (nq,)),
            ("v", v, (nv,)),
            ("a", a, (nv,)),
            ("closure_wrenches", closure_wrenches, (len(self.closures.closures), 6)),
            ("applied", applied, (nv,)),
        )

    def _inverse_dynamics(
        self, q: Array, v: Array, a: Array, wrenches: Array | None, applied: Array | None, *, motors: Mask
    ) -> InverseDynamics:
        """Return the torques at one state."""
        state = self.closures.state(self.closed(q), v)
        force = np.array(pin.rnea(self.model, self._data, q, v, a))
        rank = self._projection.svd(q, state).rank
        return torque_of_motion(state, a, force, wrenches, applied, motors, rank)

    def derivatives(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> DynamicsDerivatives:
        """Return the derivatives of accelerations and closure wrenches by q, v and tau.

        The stabilisation is in them: off the closures they are those of the simulated plant.

        Args:
            q: configuration on the closures, shape (nq,).
            v: velocity, shape (nv,).
            tau: generalised force, shape (nv,).

        Raises:
            ArgumentError: a closure has other rows than "full", or rows that joints move are redundant: the
                derivatives of least multipliers are not Pinocchio's. ``linearise`` takes any.
        """
        q, v, tau = self.closed(q), self._v("v", v), self._v("tau", tau)
        state = self.closures.state(q, v)
        require_full_rows(self.closures, state, self._projection.svd(q, state).rank)
        return ProximalSolver(self.model, self.closures, self.stabilisation).derivatives(q, v, tau)

    def reduced_dynamics(
        self, q: ArrayLike, v: ArrayLike, joints: Sequence[str] | None = None
    ) -> ReducedDynamics:
        """Return mass matrix and bias in minimal coordinates, ``M_r nu' + b_r = N^T tau``.

        Args:
            q: configuration on the closures, shape (nq,).
            v: velocity that keeps them closed, shape (nv,).
            joints: independent joints, as for minimal_coordinates.
        """
        return self.minimal_form.dynamics(self.closed(q), self._v("v", v), joints)

    def linearise(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, joints: Sequence[str] | None = None
    ) -> Linearisation:
        """Return the linear model about a state, in minimal coordinates.

        The plant is that of the closures held exactly: its Baumgarte modes are not in the model. The output y
        has the deviations of all joints, then of their velocities, shape (2 nv,).

        Args:
            q: configuration on the closures, shape (nq,).
            v: velocity that keeps them closed, shape (nv,).
            tau: generalised force, shape (nv,).
            joints: independent joints, as for minimal_coordinates.

        Raises:
            ArgumentError: the chain is singular at q, or a free-floating body remains unconstrained.
        """
        q, v, tau = self.closed(q), self._v("v", v), self._v("tau", tau)

        def output(near: Array, velocity: Array) -> Array:
            return np.concatenate((pin.difference(self.model, q, near), velocity))

        return linearised(self.minimal_form, self.solver, ChainState(q, v), tau, joints, output)

    def equilibrium(
        self, q_guess: ArrayLike, tau: ArrayLike | None = None, joints: Sequence[str] | None = None
    ) -> Array:
        """Return a configuration at rest in which a constant generalised force keeps the chain, shape (nq,).

        Newton's steps on the acceleration of independent joints at rest; eigenvalues of ``linearise`` tell
        whether it is stable.

        Args:
            q_guess: configuration near it, shape (nq,).
            tau: generalised force, shape (nv,); zero when omitted.
            joints: independent joints, as for minimal_coordinates.

        Raises:
            ArgumentError: none was reached, with the acceleration that remains.
        """
        tau = np.zeros(self.model.nv) if tau is None else self._v("tau", tau)
        return equilibrium(self.minimal_form, self.solver, self.project_configuration(q_guess), tau, joints)

    def integrate(
        self,
        q: ArrayLike,
        v: ArrayLike,
        *,
        duration: float,
        step: float,
        torque: TorqueLaw | None = None,
        project: bool = True,
    ) -> Trajectory:
        """Return the motion from a state, by Runge-Kutta 4 with the KKT solver ("proximal": with that one).

        Args:
            q: configuration at t = 0, on the closures, shape (nq,).
            v: velocity at t = 0, shape (nv,).
            duration: s.
            step: s; the last one is shorter if it does not divide duration.
            torque: generalised force as a function of (t, q, v), shape (nv,), N m and N; zero when omitted.
            project: whether q and v are projected onto the closures, at the start and after every step.
                Otherwise only the stabilisation counteracts drift, and a mechanism may break down at singular
                poses.

        Raises:
            OpenClosureError: the closures are not closed at the start.
            IntegrationError: the motion diverges: the step is too long, or torque grows without bound.
            ArgumentError, ShapeError, OutOfRangeError: torque is no function, or values have wrong sizes.
        """
        start, model = ChainState(self._q(q), self._v("v", v)), self.model
        time, is_auto = time_grid(duration, step, 8 * (model.nq + model.nv)), self.formulation == "auto"
        solver = KKTSolver(model, self.closures, self.stabilisation) if is_auto else self.solver
        require_type("project", project, bool, np.bool_)
        propagator = Propagator(model, solver, torque, self._projection if project else None)
        self.closed(start.q)
        if not project:
            return propagator.run(start, None, time)
        *closed, rank = self._projection.state(*start, CLOSED)
        return propagator.run(ChainState(*closed), rank, time)
