"""Closed chain of a cell: arms that hold a payload, and the interaction wrenches between them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_array, require_finite, shaped
from coop_pin.base.errors import ArgumentError
from coop_pin.chain.dynamics import Count, over_states
from coop_pin.chain.linearisation import Linearisation, linearised
from coop_pin.chain.trajectory import ChainState
from coop_pin.grasps.cell_kinematics import CellKinematics
from coop_pin.grasps.contact_patches import ContactState
from coop_pin.grasps.friction_cones import Squeeze, friction_squeeze
from coop_pin.grasps.observation import Observation, PayloadState, payload_quantities
from coop_pin.grasps.spring_damper import SpringState

_NO_WRENCH = np.zeros(6)
_SINGULAR = 1e10
_SUM_ALLOWED = 1e-6


class CellTorques(NamedTuple):
    """Torques and wrenches of a motion of a cell, of one state or of n states.

    Attributes:
        torque: joint torques in the coordinates of the tree, N m, shape (..., nv); zero at a free payload.
            The torque of an arm's drives is T^-T times its part.
        interaction_wrench: wrench on each arm by the payload, about P in world axes, shape (..., m, 6).
        rank: number of independent closure rows, as of InverseDynamics.
    """

    torque: Array
    interaction_wrench: Array
    rank: Count


class CellChain(CellKinematics):
    """Closed chain of a cell: its model, loop closures and interaction wrenches.

    Kinematics and grasps are those of CellKinematics; here are the dynamics.
    """

    @cached_property
    def _free_data(self) -> pin.Data:
        return self.model.model.createData()

    def acceleration(self, q: Array, v: Array, tau: Array) -> tuple[Array, float]:
        """Return a, shape (nv,), and the power that the force elements dissipate, W.

        Without closures the inertia of arms and payload is block-diagonal, and no constraint is solved.

        Args:
            q: configuration, shape (nq,).
            v: velocity, shape (nv,).
            tau: generalised force of everything but grasps and force elements, shape (nv,).
        """
        elements, closed = self.elements, self.rigid.mechanism
        if not elements.elements:
            return closed.solver.acceleration(q, v, tau), 0.0
        power = elements.act(q, v)
        if closed.closures.closures:
            return closed.solver.acceleration(q, v, tau + elements.force(q)), power
        return pin.aba(closed.model, self._free_data, q, v, tau, elements.wrenches), power

    def energy(self, q: Array, v: Array) -> float:
        """Return the energy of bodies, springs and contacts, J."""
        total, springs = self.mechanism.energy(q, v).total, self.springs
        if len(self.patches):
            total += self.patches.at(q, v).energy
        return total + springs.energy(springs.at(q, v)) if springs.arms else total

    def interaction_wrenches(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, push: ArrayLike = _NO_WRENCH
    ) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes: F_ce of eq. (6), shape (m, 6).

        Args:
            q: configuration.
            v: velocity.
            tau: generalised force of everything but the grasps, including J_WP^T push, shape (nv,).
            push: wrench on the payload about P in world axes, N and N m, shape (6,).
        """
        q, v, tau = self._q(q), self._v("v", v), self._v("tau", tau)
        return self.unchecked_wrenches(q, v, tau, as_array("push", push, 6))

    def unchecked_wrenches(self, q: Array, v: Array, tau: Array, push: Array) -> Array:
        """Return the interaction wrenches of arguments that are valid arrays, as those of a plant at a tick.

        Raises:
            OutOfRangeError: a wrench is not finite.
        """
        elements = self._move(q, v, tau)
        wrenches = self._wrenches(self.mechanism.solver.forces(), push, *elements)
        return require_finite("the interaction wrenches", wrenches)

    def observe(self, q: Array, v: Array, tau: Array, push: Array) -> Observation:
        """Return poses, wrenches and energy at n states.

        Args:
            q: configurations, shape (n, nq).
            v: velocities, shape (n, nv).
            tau: generalised forces, as of interaction_wrenches, shape (n, nv).
            push: wrenches on the payload, likewise, shape (n, 6).

        Raises:
            ShapeError: a shape differs.
            OutOfRangeError: a wrench is not finite.
        """
        nq, nv = self.mechanism.model.nq, self.mechanism.model.nv
        n = len(shaped("q", q, nq))
        arguments = (("q", q, nq), ("v", v, nv), ("tau", tau, nv), ("push", push, 6))
        states = (as_array(name, value, n, size) for name, value, size in arguments)
        parts = zip(*map(self._observed, *states), strict=True)
        values: list[Any] = [None if part[0] is None else np.array(part) for part in parts]
        observation = Observation(*values)
        require_finite("the interaction wrenches", observation.interaction_wrench)
        return observation

    def inverse_dynamics(
        self,
        q: ArrayLike,
        v: ArrayLike,
        a: ArrayLike,
        *,
        internal: ArrayLike | None = None,
        push: ArrayLike = _NO_WRENCH,
        friction: ArrayLike | None = None,
    ) -> CellTorques:
        """Return the joint torques of a motion and an internal wrench.

        F_i = c_i (push - M_0 xddot - Q_0 xdot - W_0) + f_i
        tau = M a + h - J^T lambda - J_WP^T push - friction

        with the load shares c_i and the internal wrenches f_i, for example those of ``friction_squeeze``;
        without f_i the torques are those of least tau^T tau. At rest they are equilibrium torques. All arrays
        are of one state, or of n states with n as their first size.

        Args:
            q: configuration on the closures, shape (nq,).
            v: velocity that keeps them closed, shape (nv,).
            a: acceleration that keeps them closed, shape (nv,).
            internal: f_i on each arm by the payload, about P in world axes, N and N m, shape (m, 6); their
                sum is zero.
            push: wrench on the payload about P in world axes, shape (6,).
            friction: generalised force that the torques overcome, ``chain.friction(v)`` or another, N m,
                shape (nv,); zero when omitted.

        Raises:
            ArgumentError: the internal wrenches do not add up to zero, a opens the closures, or a grasp is
                compliant.
        """
        self.cell.require_rigid("inverse dynamics")
        (nq, nv), m = (self.mechanism.model.nq, self.mechanism.model.nv), len(self.model.arms)
        return over_states(
            self._inverse_dynamics,
            ("q", q, (nq,)),
            ("v", v, (nv,)),
            ("a", a, (nv,)),
            ("internal", internal, (m, 6)),
            ("push", push, (6,)),
            ("friction", friction, (nv,)),
        )

    def _inverse_dynamics(
        self, q: Array, v: Array, a: Array, internal: Array | None, push: Array, friction: Array | None
    ) -> CellTorques:
        """Return the torques at one state."""
        motors = [name for name in list(self.model.model.names)[1:] if name != "payload"]
        applied, wrenches = self.payload_jacobian(q).T @ push, None
        applied += 0.0 if friction is None else friction
        frames = self._at(q, v, a)
        X_WP = frames.payload
        W = np.kron(np.eye(2), X_WP.rotation)
        if internal is not None:
            _require_internal(internal)
            F = np.outer(self.cell.shares, push - W @ frames.payload_balance()) + internal
            wrenches = np.array(
                [
                    X_WP.actInv(frames.tips[index]).actInv(pin.Force(W.T @ F[index])).vector
                    for index in self.rigid.closed
                ]
            ).reshape(-1, 6)
        solution = self.mechanism.inverse_dynamics(
            q, v, a, closure_wrenches=wrenches, motors=motors, applied=applied
        )
        F = self._wrenches([pin.Force(wrench) for wrench in solution.closure_wrenches], push)
        return CellTorques(solution.torque, F, solution.rank)

    def friction(self, v: ArrayLike) -> Array:
        """Return the generalised force of joint friction at velocities, N m, shape (..., nv).

        Args:
            v: velocities, shape (..., nv).
        """
        velocities = shaped("v", v, self.mechanism.model.nv)
        return np.apply_along_axis(self.transmission.friction, -1, velocities)

    def friction_squeeze(
        self, q: ArrayLike, v: ArrayLike, a: ArrayLike, *, push: ArrayLike = _NO_WRENCH
    ) -> Squeeze:
        """Return the internal wrenches of least normal force with which friction at the pads holds a motion.

        The pads are those of ``cell.pads``, the cones those of ``friction_cones``, and the load is shared by
        c_i. Where rigid bodies do not determine a row of the wrenches, f_i has none. All arrays are of one
        state, or of n states with n as their first size.

        Args:
            q: configuration on the closures, shape (nq,).
            v: velocity that keeps them closed, shape (nv,).
            a: acceleration that keeps them closed, shape (nv,).
            push: wrench on the payload about P in world axes, shape (6,).

        Raises:
            ArgumentError: an arm has no pad, a grasp is compliant, or friction holds no such motion.
        """
        self.cell.require_rigid("the least squeeze of pads")
        if without := [name for name in self.cell.arms if name not in self.cell.pads]:
            raise ArgumentError(f"arm {without[0]!r} has no pad; state it in cell.pads")
        (nq, nv) = (self.mechanism.model.nq, self.mechanism.model.nv)
        return over_states(
            self._friction_squeeze, ("q", q, (nq,)), ("v", v, (nv,)), ("a", a, (nv,)), ("push", push, (6,))
        )

    def _friction_squeeze(self, q: Array, v: Array, a: Array, push: Array) -> Squeeze:
        """Return the least squeeze at one state."""
        rows = self.rigid.determinate_rows(q)
        frames = self._at(q, v, a)
        load = push - np.kron(np.eye(2), frames.payload.rotation) @ frames.payload_balance()
        return friction_squeeze(self.cell, frames.payload.homogeneous, np.outer(self.cell.shares, load), rows)

    def effective_inertia(self, q: ArrayLike) -> Array:
        """Return the inertia of the whole cell at P, as a wrench on the payload feels it, on the task rows.

        Lambda = (J_WP N (N^T M N)^-1 N^T J_WP^T)^-1, kg, kg m and kg m^2, shape (k, k).

        Args:
            q: configuration on the closures, shape (nq,).

        Raises:
            ArgumentError: the payload cannot move in all task rows, or a grasp is compliant.
        """
        self.cell.require_rigid("the effective inertia")
        q = self._q(q)
        reduced = self.mechanism.reduced_dynamics(q, np.zeros(self.mechanism.model.nv))
        rows = list(self.cell.task_rows.indices)
        JN = self.payload_jacobian(q)[rows] @ reduced.coordinates.null_space
        mobility = JN @ np.linalg.solve(reduced.mass_matrix, JN.T)
        if not np.linalg.cond(mobility) <= _SINGULAR:
            raise ArgumentError(
                f"the payload cannot move in all {len(rows)} task rows at q (condition number"
                f" {np.linalg.cond(mobility):.3g}, allowed {_SINGULAR:.3g})"
            )
        return np.asarray(np.linalg.inv(mobility))

    def linearise(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, joints: Sequence[str] | None = None
    ) -> Linearisation:
        """Return the linear model about a state; its output is the payload's motion, shape (12,).

        y has the displacement of P and the small rotation of the payload in world axes (m, rad), then the
        deviation of V_WP. State, input and errors are those of ``ClosedChain.linearise``.
        """
        self.cell.require_rigid("the linear model")
        q, v, tau = self._q(q), self._v("v", v), self._v("tau", tau)
        X_WP = pin.SE3(self.payload_pose(q))

        def output(near: Array, velocity: Array) -> Array:
            twist = self.payload_jacobian(near) @ velocity
            X = pin.SE3(self.payload_pose(near))
            turn = pin.log3(X.rotation @ X_WP.rotation.T)
            return np.concatenate((X.translation - X_WP.translation, turn, twist))

        chain = self.mechanism
        return linearised(chain.minimal_form, chain.solver, ChainState(q, v), tau, joints, output)

    def _observed(self, q: Array, v: Array, tau: Array, push: Array) -> Observation:
        """Return the Observation at a state."""
        elements, frames = self._move(q, v, tau), self._frames
        payload = PayloadState(
            frames.payload.homogeneous, frames.payload_twist(), push, self.model.surroundings
        )
        kinetic, potential = frames.energies()
        energies: dict[str, Any] = {"kinetic_energy": kinetic, "potential_energy": potential}
        return Observation(
            **payload_quantities(payload),
            **energies,
            tip_position=frames.tip_positions(),
            interaction_wrench=self._wrenches(self.mechanism.solver.forces(), push, *elements),
            **self._of_elements(*elements),
        )

    def _of_elements(self, grasps: SpringState | None, contacts: ContactState | None) -> dict[str, Any]:
        """Return the quantities of compliant grasps and contacts by name; none without any."""
        quantities: dict[str, Any] = {}
        if grasps is not None:
            quantities["elastic_energy"] = self.springs.energy(grasps)
            quantities["grasp_deflection"] = self.springs.of_arms(grasps.deflection)
            quantities["grasp_wrench"] = self.springs.of_arms(grasps.wrench)
        if contacts is not None:
            quantities["elastic_energy"] = quantities.get("elastic_energy", 0.0) + contacts.energy
            quantities["patch_wrench"], quantities["patch_points"] = contacts.wrench, contacts.touching
            quantities["patch_slip"] = self.patches.state.slip
        return quantities

    def _move(self, q: Array, v: Array, tau: Array) -> tuple[SpringState | None, ContactState | None]:
        """Move the frames under a generalised force; return compliant grasps and contacts, None without."""
        a = self.acceleration(q, v, tau)[0]
        grasps = self.springs.seen() if self.springs.arms else None
        contacts = self.patches.seen() if len(self.patches) else None
        self._frames.move(q, v, a)
        return grasps, contacts

    def _wrenches(
        self,
        of_closures: Sequence[pin.Force],
        push: Array,
        grasps: SpringState | None = None,
        contacts: ContactState | None = None,
    ) -> Array:
        """Return the interaction wrenches, about P in world axes, of those of closures and elements."""
        X_WP, tips, welded = self._frames.payload, self._frames.tips, self._frames.welded
        in_payload = np.zeros((len(tips), 6))
        for index, F_E in zip(self.rigid.closed, of_closures, strict=False):
            in_payload[index] = X_WP.actInv(tips[index]).act(F_E).vector
        if grasps is not None:
            in_payload[self.springs.arms] = [X_WP.actInv(pin.Force(F)).vector for F in grasps.on_body]
        by_tables = _NO_WRENCH
        if contacts is not None:
            about_P = np.array([X_WP.actInv(pin.Force(F)).vector for F in contacts.on_bodies])
            arms_touch = len(self.patches.arms)
            in_payload[self.patches.arms] = about_P[:arms_touch]
            by_tables = about_P[arms_touch:].sum(axis=0)
        for index in welded:
            in_payload[index] = by_tables - self._frames.payload_balance() - np.add.reduce(in_payload)
        wrenches: Array = in_payload.reshape(-1, 3).dot(X_WP.rotation.T).reshape(-1, 6)
        for index in welded:
            wrenches[index] += push
        return wrenches


def _require_internal(f: Array) -> None:
    resultant, largest = float(np.abs(f.sum(axis=0)).max()), float(np.abs(f).max(initial=0.0))
    if not resultant <= _SUM_ALLOWED * (1.0 + largest):
        raise ArgumentError(
            f"the internal wrenches add up to {resultant:.3g} N or N m about P; internal wrenches add up to"
            " zero: make a wrench internal by cp.spatial.internal_wrenches"
        )
