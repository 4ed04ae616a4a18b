"""Closed chain of a cell: arms that hold a payload, torques of a motion, least squeeze, linear model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, shaped
from coop_pin.base.errors import ArgumentError
from coop_pin.base.spatial.pose import spatial_inertia
from coop_pin.chain.dynamics import Count, over_states
from coop_pin.chain.linearisation import Linearisation, linearised
from coop_pin.chain.trajectory import ChainState
from coop_pin.description.cell.shared_joint import about
from coop_pin.grasps.cell_dynamics import CellDynamics
from coop_pin.grasps.friction_cones import Squeeze, friction_squeeze
from coop_pin.model.pinocchio_model import symmetric

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


class CellChain(CellDynamics):
    """Closed chain of a cell: its model, loop closures and interaction wrenches.

    Kinematics and grasps are those of CellKinematics, forward dynamics those of CellDynamics; here are the
    torques of a motion, the least squeeze and linear models.
    """

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
            resultant, largest = np.abs(internal.sum(axis=0)).max(), np.abs(internal).max(initial=0.0)
            if not resultant <= _SUM_ALLOWED * (1.0 + largest):
                raise ArgumentError(
                    f"the internal wrenches add up to {resultant:.3g} N or N m about P; internal wrenches add"
                    " up to zero: make a wrench internal by cp.spatial.internal_wrenches"
                )
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

    def shared_statics(self, q: Array, loads: Array) -> tuple[Array, Array]:
        """Return tau_0, which holds the joints under arms at rest, and the inertia I that each moves, (n,).

        tau_0 = g - sum_i J_s^T F_i and I = M + sum_i c_i J_s^T M_0 J_s, over the arms that they carry.

        Args:
            q: configuration, shape (nq,).
            loads: F_i on each arm at rest about P in world axes, shape (m, 6).
        """
        tree, carriers, X_WP = self.model, self.cell.carriers, self.payload_pose(q)
        alone, rows = tree.model.copy(), [slot.v_slice.start for slot in tree.shared]
        alone.inertias[tree.payload_joint] = tree.carrier_inertia
        data, payload = alone.createData(), self.cell.payload
        g = pin.computeGeneralizedGravity(alone, data, q)[rows]
        M = np.diag(symmetric(pin.crba(alone, data, q)))[rows]
        M_0 = spatial_inertia(payload.mass, payload.inertia_matrix, X_WP[:3, :3])
        held, added = [], []
        for carrier in carriers:
            J = about(X_WP[:3, 3], carrier.screws)
            carries = np.array([name in carrier.arms for name in self.cell.arms], dtype=float)
            held.append(J @ (carries @ loads))
            added.append(self.cell.shares @ carries * np.einsum("ni,ij,nj->n", J, M_0, J))
        return g - np.concatenate(held), M + np.concatenate(added)

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
