"""Joints between the links of a payload: springs, dampers, friction, and their angles at rest."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.spatial import rotate_vector6, shift_wrench
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.joint_friction import JointFriction
from coop_pin.model.cell_model import CellModel
from coop_pin.model.joint_stops import CellStops, StopState
from coop_pin.model.pinocchio_model import jacobian_matrix, symmetric

_RANK = 1e-9
"""Ratio below which singular values of closures are zero."""
_SWEEPS, _AT_REST = 100, 1e-11
"""Most steps of Newton's method for angles at rest, and the moment or force that is none, N m or N."""
_BENT = 1e-2
"""Angles or travels by which joints are moved, one more than the other, to see whether a rope is straight."""
_APART = 1e-6
"""Distance or angle from which on P is not where it is to be, m or rad."""
_NEUTRAL = 1e-9
"""Part of the largest stiffness below which a joint has none, and stays where it is."""


class PayloadJoints:
    """Undriven joints of a payload of several links, in the coordinates of the tree of a cell.

    With the angle q of a joint and its rate v, besides its stops::

        tau = -k (q - q_rest) - c v - mu tanh(v / v_c)

    Attributes:
        linked: the joints in the tree.
        stiffness: k, N m/rad or N/m, shape (n,).
        damping: c, N m s/rad or N s/m, shape (n,).
    """

    def __init__(self, cell: Cell, tree: CellModel, stops: CellStops) -> None:
        """Read the joints of a cell whose payload has several links."""
        links, linked = cell.payload.links, tree.linked
        assert links is not None
        assert linked is not None
        self._cell, self._tree, self._stops, self.linked = cell, tree, stops, linked
        model, stated = tree.model, [links.joint(name) for name in linked.joint_names]
        self.stiffness = np.array([joint.stiffness for joint in stated])
        self._rest = np.array([joint.rest for joint in stated])
        self.damping, self._coulomb = (
            np.array(
                [
                    of_urdf if value is None else value
                    for value, of_urdf in zip(rows, urdf[linked.v_slice], strict=True)
                ]
            )
            for rows, urdf in (
                ([joint.damping for joint in stated], model.damping),
                ([joint.friction for joint in stated], model.friction),
            )
        )

    def positions(self, q: Array) -> Array:
        """Return the angles and travels at a configuration of the tree, shape (n,)."""
        return self.linked.angles.of(q[self.linked.q_slice])

    def state(self, q: Array, v: Array) -> StopState:
        """Return force in the tree, shape (nv,), energy of springs, and the power that is lost."""
        force, rates, deflection = np.zeros(len(v)), v[self.linked.v_slice], self.positions(q) - self._rest
        spring = self.stiffness * deflection
        lost = self.damping * rates + self._coulomb * np.tanh(rates / JointFriction().coulomb_velocity)
        force[self.linked.v_slice] = -spring - lost
        return StopState(force, 0.5 * float(spring @ deflection), -float(lost @ rates))

    def quantities(self, q: Array, v: Array) -> dict[str, Any]:
        """Return what is observed of the joints at a state, by name."""
        state, at = self.state(q, v), self.linked.v_slice
        return {
            "payload_joint_position": self.positions(q),
            "payload_joint_velocity": v[at],
            "payload_joint_force": (state.force + self._stops.state(q, v).force)[at],
            "payload_joint_energy": state.energy,
        }

    def loads(self, q: Array, X_WP: Array) -> Array:
        """Return the wrench on each arm at rest about P in world axes, shape (m, 6).

        The whole payload hangs on the arms at the angles that it has: F_i = c_i W(q), of a free payload the
        weight of all links with its moment about P. With a base the arms hold what the joint that moves P
        does not: weight and spring. The ends of a rope are pulled, too, by what keeps its joints at rest.
        """
        loads = self._shared_loads(q, X_WP)
        if not self._cell.is_pulled:
            return loads
        A = self._internal_moments(q, X_WP)
        pull = np.linalg.lstsq(A, -self._moments(q, X_WP), rcond=_RANK)[0]
        return np.asarray(loads + self._opposed(np.asarray(pull), X_WP))

    def _shared_loads(self, q: Array, X_WP: Array) -> Array:
        """Return the arms' parts of the weight, shape (m, 6)."""
        links, linked, cell = self._cell.payload.links, self.linked, self._cell
        assert links is not None
        model, data, R = self._tree.model, self._tree.model.createData(), X_WP[:3, :3]
        pin.forwardKinematics(model, data, q)
        force = self._still(q)
        if linked.root:
            X_PR = pin.SE3(X_WP).actInv(data.oMi[linked.root])
            entry = int(model.idx_vs[linked.root])
            W = X_PR.act(pin.Force(force[entry : entry + 6])).vector
        else:  # any wrench that does the work of weight and spring: the split takes the least one
            s = links.freedom
            W = s * force[int(model.idx_vs[linked.joint])] / (s @ s)
        if not cell.splits_load:
            return np.outer(cell.shares, rotate_vector6(R, W))
        return rotate_vector6(R, cell.loads_within([True] * len(cell.arms)) @ W)

    def at_rest(self, q: Array, X_WP: Array) -> Array:
        """Return a configuration with P at a pose and the joints at rest under weights, springs and arms.

        The arms hold their parts of the weight, as of ``loads``. Joints that nothing returns stay. The ends
        of a rope keep the pose to one another at which they are held.

        Raises:
            FieldError: no angles at rest are near the start.
        """
        if self._cell.is_pulled:
            return self._pulled(q, X_WP)
        linked, v = self.linked, np.zeros(self._tree.model.nv)
        q = linked.configured(q, X_WP)
        free = np.ones(len(self.stiffness), dtype=bool)
        if not linked.root:  # P stands where it is to be
            free[linked.joints.index(linked.joint)] = False
        for _ in range(_SWEEPS):
            moment = self._moments(q, X_WP)[free]
            if np.abs(moment).max(initial=0.0) < _AT_REST:
                break
            slope = self._slope(q, X_WP, free)
            values, axes = np.linalg.eigh(-0.5 * (slope + slope.T))
            stiff = np.abs(values) > _NEUTRAL * np.abs(values).max()
            step = axes[:, stiff] @ ((axes[:, stiff].T @ moment) / np.abs(values[stiff]))
            v[np.flatnonzero(free) + linked.v_slice.start] = step * min(1.0, 0.3 / np.abs(step).max())
            q = linked.configured(pin.integrate(self._tree.model, q, v), X_WP)
            if np.abs(step).max() < 1e-15:
                break
        else:
            raise FieldError("has joints without angles at rest near their start", "cell.payload.links")
        return q

    def _pulled(self, q: Array, X_WP: Array) -> Array:
        """Return the configuration of ``at_rest`` of a rope by Newton's method.

        ::

            m(q) + A l = 0,    d_i(q) = d_m(q)

        with the moments m of weights, A l of opposed wrenches l of the arms on its ends, and the displacement
        d_i of grasp i from where it is stated, about P.
        """
        linked, n = self.linked, len(self.stiffness)
        q, v = linked.configured(q, X_WP), np.zeros(self._tree.model.nv)
        pull = np.zeros(6 * (len(self._tree.arms) - 1))
        for _ in range(_SWEEPS):
            A, gap = self._internal_moments(q, X_WP), self._gap(q, X_WP)
            moment = self._moments(q, X_WP, pull)
            if max(np.abs(moment).max(), np.abs(gap).max()) < _AT_REST:
                v[linked.v_slice] = _BENT * np.arange(n)
                bent = self._internal_moments(pin.integrate(self._tree.model, q, v), X_WP)
                if np.linalg.matrix_rank(A, _RANK) == np.linalg.matrix_rank(bent, _RANK):
                    return q
                break
            slope = self._slope(q, X_WP, np.ones(n, dtype=bool), pull)
            system = np.block([[slope, A], [A.T, np.zeros((len(gap), len(gap)))]])
            step = np.linalg.lstsq(system, np.concatenate((-moment, gap)), rcond=_RANK)[0]
            part = min(1.0, 0.3 / np.abs(step[:n]).max())
            v[linked.v_slice], pull = part * step[:n], pull + part * step[n:]
            q = linked.configured(pin.integrate(self._tree.model, q, v), X_WP)
        detail = (
            "has no angles at rest between its arms: straight, its pull is unbounded; state a shorter span"
        )
        raise FieldError(f"{detail} by start angles of its joints", "cell.payload.links")

    def _opposed(self, pull: Array, X_WP: Array) -> Array:
        """Return wrenches on the arms about P in world axes, of those on all but the last in payload axes."""
        on_arms = pull.reshape(-1, 6)
        return rotate_vector6(X_WP[:3, :3], np.vstack((on_arms, -on_arms.sum(axis=0))))

    def _internal_moments(self, q: Array, X_WP: Array) -> Array:
        """Return A, the moments on the joints by ``_opposed`` wrenches, shape (n, 6 (m - 1))."""
        size = 6 * (len(self._tree.arms) - 1)
        return np.array([self._pushed(q, X_WP, self._opposed(pull, X_WP)) for pull in np.eye(size)]).T

    def _gap(self, q: Array, X_WP: Array) -> Array:
        """Return the displacements d_i - d_m of the grasps, shape (6 (m - 1),)."""
        model, data, moved = self._tree.model, self._tree.model.createData(), list[Array]()
        pin.framesForwardKinematics(model, data, q)
        for slot in self._tree.arms:
            X_PG = pin.SE3(X_WP).actInv(data.oMf[model.getFrameId(f"payload/{slot.name}")])
            stated = pin.SE3(self._cell.grasps[slot.name].matrix)
            moved.append(pin.log6(X_PG * stated.inverse()).vector)
        return np.concatenate([each - moved[-1] for each in moved[:-1]])

    def require_reached(self, q: Array, X_WP: Array) -> None:
        """Refuse a pose of P that the joint of a payload with a base does not reach.

        Raises:
            FieldError: with the distance or angle.
        """
        data = self._tree.model.createData()
        pin.forwardKinematics(self._tree.model, data, q)
        gap = pin.log6((data.oMi[self.linked.joint] * self.linked.X_JP).actInv(pin.SE3(X_WP))).vector
        if (size := float(np.abs(gap).max())) > _APART:
            detail = f"is {size:.2g} m or rad from where the payload's joint on its base can be"
            raise FieldError(detail, "start")

    def _slope(self, q: Array, X_WP: Array, free: Array, pull: Array | None = None) -> Array:
        """Return the derivatives of the moments by the free angles, by central differences."""
        along = np.eye(self._tree.model.nv)[:, self.linked.v_slice][:, free]

        def moments(near: Array) -> Array:
            return self._moments(self.linked.configured(near, X_WP), X_WP, pull)[free]

        return self._derivative(moments, q, along)

    def _derivative(self, force: Callable[[Array], Array], q: Array, along: Array) -> Array:
        """Return the derivatives of a force by motions of the tree, shape (nv, k), by central differences."""
        h, shape = 1e-6, (along.shape[1], len(force(q)))
        ends = [
            np.array([force(pin.integrate(self._tree.model, q, sign * v)) for v in along.T]).reshape(shape)
            for sign in (h, -h)
        ]
        return np.asarray((ends[0] - ends[1]).T / (2.0 * h))

    def _moments(self, q: Array, X_WP: Array, pull: Array | None = None) -> Array:
        """Return the moments on the joints at rest of springs, weights and arms, shape (n,)."""
        loads = self._shared_loads(q, X_WP)
        loads = loads if pull is None else loads + self._opposed(pull, X_WP)
        return self._still(q)[self.linked.v_slice] + self._pushed(q, X_WP, loads)

    def _pushed(self, q: Array, X_WP: Array, loads: Array) -> Array:
        """Return the moments on the joints by wrenches on the arms about P in world axes, shape (n,)."""
        model, data, tau = self._tree.model, self._tree.model.createData(), np.zeros(self._tree.model.nv)
        pin.framesForwardKinematics(model, data, q)
        for slot, F in zip(self._tree.arms, loads, strict=True):
            frame = model.getFrameId(f"payload/{slot.name}")
            lever = X_WP[:3, 3] - data.oMf[frame].translation
            J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
            tau -= jacobian_matrix(J).T @ shift_wrench(F, lever)
        return tau[self.linked.v_slice]

    def modes(self, q: Array, closures: Array, arms_move: bool) -> tuple[Array, Array]:
        """Return the poles of the payload without a law, 1/s, and how the joints move in each.

        ::

            N^T M N y'' + N^T C N y' + N^T K N y = 0,    J N = 0

        Args:
            q: configuration of the tree, shape (nq,).
            closures: J, shape (r, nv).
            arms_move: whether the arms move with it; else its grasps stand still.

        Returns:
            Poles, shape (2 k,), and motions of the joints of the payload, shape (n, 2 k).
        """
        model, at = self._tree.model, self.linked.v_slice
        first = 0 if arms_move else at.start - (6 if self.linked.root else 0)
        moves, J = slice(first, at.stop), closures[:, first : at.stop]
        _, sizes, V = np.linalg.svd(J)
        N = V[int((sizes > _RANK * sizes[0]).sum()) :].T
        k, along = N.shape[1], np.zeros((model.nv, N.shape[1]))
        along[moves], M = N, symmetric(pin.crba(model, model.createData(), q))[moves, moves]
        C = np.zeros(len(M))
        C[at.start - first : at.stop - first] = self.damping
        K = -self._derivative(self._still, q, along)[moves]
        inverse = np.linalg.inv(N.T @ M @ N)
        A = np.block([[np.zeros((k, k)), np.eye(k)], [-inverse @ N.T @ K, -inverse @ N.T @ (C[:, None] * N)]])
        poles, vectors = np.linalg.eig(A)
        return poles, (N @ vectors[:k])[at.start - first :]

    def _still(self, q: Array) -> Array:
        """Return the generalised force of springs, stops and weights at rest, shape (nv,)."""
        model = self._tree.model
        g = pin.computeGeneralizedGravity(model, model.createData(), q)
        rest = np.zeros(model.nv)
        return np.asarray(self.state(q, rest).force + self._stops.state(q, rest).force - g)
