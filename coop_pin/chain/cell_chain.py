"""A cell as a closed chain: its arms hold the payload, and their wrenches can be read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, Mask, as_array
from coop_pin.chain.chain_dynamics import Energy
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.chain.closure import Closure
from coop_pin.chain.closure_set import ClosureError
from coop_pin.chain.inverse_kinematics import solve_ik
from coop_pin.chain.kkt_solver import constraint_svd
from coop_pin.description.cell import Cell
from coop_pin.description.payload import Payload
from coop_pin.description.plant import PlantOptions
from coop_pin.errors import OpenClosureError
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.cell_model import CELL_MODELS
from coop_pin.model.pinocchio_model import frame_id, symmetric
from coop_pin.spatial import rotate_vector6, shift_wrench

_NO_WRENCH = np.zeros(6)
_CLOSED_BY_TREE = ClosureError(0.0, 0.0)


class Observation(NamedTuple):
    """What can be read off a closed chain that moves under given forces.

    Attributes:
        payload_pose: X_WP, shape (4, 4).
        payload_twist: V_WP, shape (6,).
        tip_positions: of every tip in the world, m, shape (m, 3).
        closure_errors: for each arm how far its tip stands from its grasp.
        interaction_wrenches: on each arm by the payload, about P in world axes, N and N m, shape (m, 6).
        energy: kinetic and potential, J.
    """

    payload_pose: Array
    payload_twist: Array
    tip_positions: Array
    closure_errors: list[ClosureError]
    interaction_wrenches: Array
    energy: Energy


class CellChain:
    """The plant of a cell.

    The payload is welded at the first arm's tip (its wrench follows from the payload's own balance), or
    floats free and is held by m closures. Both are the same mechanism.

    Attributes:
        cell: the description.
        tree: where arms and payload sit in the Pinocchio tree.
        chain: the closed chain.
    """

    def __init__(self, cell: Cell, options: PlantOptions | None = None) -> None:
        """Build the plant.

        Args:
            cell: the description.
            options: payload welded or free, formulation and stabilisation; those of PlantOptions when
                omitted.

        Raises:
            UrdfError, NameNotFoundError: an arm cannot be built.
        """
        options = PlantOptions() if options is None else options
        self.cell = cell
        self.tree = CELL_MODELS[options.payload](cell)
        held = [name for name in cell.arms if name not in self.tree.closed_by_tree]
        closures = [Closure(f"{name}/grasp", f"payload/{name}") for name in held]
        chain = ClosedChain(self.tree.model, closures, options.stabilisation)
        self.chain = chain.with_kkt() if options.formulation == "kkt" else chain
        self._data = self.tree.model.createData()
        self._held = [index for index, name in enumerate(cell.arms) if name in held]
        self._grasps = [frame_id(self.tree.model, f"payload/{name}") for name in cell.arms]

    def set_payload(self, payload: Payload) -> None:
        """Give the payload another mass and inertia, at once."""
        self.tree.set_payload(payload)

    def configuration(self, X_WP: ArrayLike) -> Array:
        """Return the configuration that holds the payload at a pose, each arm near its posture.

        Raises:
            UnreachablePoseError: an arm cannot reach; with the gap.
        """
        X, configurations = as_array("X_WP", X_WP, 4, 4), []
        for name, arm in self.cell.arms.items():
            model = ArmModel(arm, self.cell.grasps[name].matrix)
            configurations.append(solve_ik(name, model, X, arm.posture))
        return self.chain.project_configuration(self.tree.configuration(configurations, X))

    def posed_configuration(self, angles: Mapping[str, ArrayLike], X_WP: ArrayLike) -> Array:
        """Return the configuration with every arm at stated joint angles, wherever that leaves its grasp.

        Args:
            angles: of every arm, rad, shape (k,) each.
            X_WP: payload pose; a payload welded at the first arm stands where that arm holds it instead.
        """
        stated = [
            arm.angles.configuration(
                as_array(f"angles of arm {arm.name!r}", angles[arm.name], len(arm.drive))
            )
            for arm in self.tree.arms
        ]
        return self.tree.configuration(stated, as_array("X_WP", X_WP, 4, 4))

    def require_held(self, q: Array, X_WP: Array, allowed: float) -> None:
        """Refuse a configuration in which an arm's tip stands off its grasp on a payload at X_WP by more than allowed, m or rad.

        Raises:
            OpenClosureError: naming the arm, with its gap.
        """
        frames = self._at(q)
        for arm in self.tree.arms:
            X_EG = frames[arm.tip].actInv(pin.SE3(X_WP @ self.cell.grasps[arm.name].matrix))
            gap = ClosureError(
                float(np.linalg.norm(X_EG.translation)), float(np.linalg.norm(pin.log3(X_EG.rotation)))
            )
            if not max(gap) <= allowed:
                raise OpenClosureError(f"grasp of arm {arm.name}", gap.distance, gap.angle, allowed)

    def payload_pose(self, q: ArrayLike) -> Array:
        """Return X_WP, shape (4, 4)."""
        return self._at(self._q(q))[self.tree.payload_frame].homogeneous

    def payload_jacobian(self, q: ArrayLike) -> Array:
        """Return J_WP of the tree with V_WP = J_WP v, shape (6, nv)."""
        J: Array = pin.computeFrameJacobian(
            self.tree.model, self._data, self._q(q), self.tree.payload_frame, pin.LOCAL_WORLD_ALIGNED
        )
        return J

    def payload_twist(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return V_WP, shape (6,)."""
        return self.payload_jacobian(q).dot(self._v("v", v))

    def tip_positions(self, q: ArrayLike) -> Array:
        """Return the position of every tip in the world, m, shape (m, 3)."""
        return self._tips(self._at(self._q(q)))

    def closure_errors(self, q: ArrayLike) -> list[ClosureError]:
        """Return for each arm how far its tip stands from its grasp."""
        return self._closure_errors(self._at(self._q(q)))

    def interaction_wrenches(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, external: ArrayLike = _NO_WRENCH
    ) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes: F_ce of eq. (6), shape (m, 6).

        Args:
            q: configuration.
            v: velocity.
            tau: generalised force of everything but the closures, including J_WP^T external, shape (nv,).
            external: wrench on the payload about P in world axes, N and N m, shape (6,).
        """
        q, v, tau = self._q(q), self._v("v", v), self._v("tau", tau)
        return self._wrenches(
            self._at(q, v, self.chain.solver.acceleration(q, v, tau)), as_array("external", external, 6)
        )

    def observe(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, external: ArrayLike = _NO_WRENCH
    ) -> Observation:
        """Return all of this at once, from one pass over the tree; arguments as of interaction_wrenches."""
        model, data, payload = self.tree.model, self._data, self.tree.payload_frame
        q, v, tau, external = (
            self._q(q),
            self._v("v", v),
            self._v("tau", tau),
            as_array("external", external, 6),
        )
        frames = self._at(q, v, self.chain.solver.acceleration(q, v, tau))
        return Observation(
            payload_pose=frames[payload].homogeneous,
            payload_twist=pin.getFrameVelocity(model, data, payload, pin.LOCAL_WORLD_ALIGNED).vector,
            tip_positions=self._tips(frames),
            closure_errors=self._closure_errors(frames),
            interaction_wrenches=self._wrenches(frames, external),
            energy=Energy(pin.computeKineticEnergy(model, data), pin.computePotentialEnergy(model, data)),
        )

    def _q(self, q: ArrayLike) -> Array:
        return as_array("q", q, self.tree.model.nq)

    def _v(self, name: str, v: ArrayLike) -> Array:
        return as_array(name, v, self.tree.model.nv)

    def _at(self, q: Array, *rates: Array) -> Any:
        """Move the tree to (q, v, a) and return its frames; they are Pinocchio's own and change with the next move."""
        pin.forwardKinematics(self.tree.model, self._data, q, *rates)
        pin.updateFramePlacements(self.tree.model, self._data)
        return self._data.oMf

    def _tips(self, frames: Any) -> Array:
        return np.array([frames[arm.tip].translation for arm in self.tree.arms])

    def _closure_errors(self, frames: Any) -> list[ClosureError]:
        closure_errors = [_CLOSED_BY_TREE] * len(self.tree.arms)
        for index in self._held:
            error = pin.log6(
                frames[self.tree.arms[index].tip].actInv(frames[self._grasps[index]])
            ).vector.tolist()
            closure_errors[index] = ClosureError(math.hypot(*error[:3]), math.hypot(*error[3:]))
        return closure_errors

    def _wrenches(self, frames: Any, external: Array) -> Array:
        """Return the wrenches of the solver's last solution: moved from each tip to P in payload axes, and turned at the end."""
        X_WP = frames[self.tree.payload_frame]
        R_WP, in_payload = X_WP.rotation, np.zeros((len(self.tree.arms), 6))
        for index, F_E in zip(self._held, self.chain.solver.wrenches(), strict=True):
            X_PE = X_WP.actInv(frames[self.tree.arms[index].tip])
            in_payload[index] = X_PE.act(pin.Force(F_E)).vector
        if self.tree.closed_by_tree:
            in_payload[0] = -self._payload_balance(X_WP) - in_payload.sum(axis=0)
        wrenches: Array = in_payload.reshape(-1, 3).dot(R_WP.T).reshape(-1, 6)
        if self.tree.closed_by_tree:
            wrenches[0] += external
        return wrenches

    def _payload_balance(self, X_WP: pin.SE3) -> Array:
        """Return M_0 xddot + Q_0 xdot + W_0 of eq. (5): the wrench that the payload's motion takes, about P in payload axes."""
        model, data, frame, inertia = (
            self.tree.model,
            self._data,
            self.tree.payload_frame,
            self.tree.payload_inertia,
        )
        V = pin.getFrameVelocity(model, data, frame, pin.LOCAL)
        A = pin.getFrameAcceleration(model, data, frame, pin.LOCAL) - X_WP.actInv(model.gravity)
        balance: Array = (inertia * A + V.cross(inertia * V)).vector
        return balance


_UNDETERMINED = 1e-6


def determinate_rows(chain: CellChain, q: Array) -> Mask:
    """Say which rows of the interaction wrenches (about P, in world axes) the closed chain determines, shape (6,).

    Closure multipliers in the null space of J^T move no joint. Rows that they reach are shared between the
    arms' structures in a way that rigid bodies do not tell: for example the weight of a bar between two
    planar arms.

    Args:
        chain: the closed cell.
        q: configuration, shape (nq,).
    """
    model, data = chain.tree.model, chain.tree.model.createData()
    closed = chain.chain.closures
    state = closed.state(q, np.zeros(model.nv))
    weighted = constraint_svd(symmetric(pin.crba(model, data, q)), state.jacobian)
    idle = np.eye(len(state.position)) - weighted.left @ weighted.left.T
    pin.framesForwardKinematics(model, data, q)
    p_WP = data.oMf[chain.tree.payload_frame].translation
    determined = np.ones(6, dtype=bool)
    for (tip, _), wrench_map in zip(closed.sides, state.wrench_map, strict=True):
        X_WE = data.oMf[tip.named]
        in_world = rotate_vector6(X_WE.rotation, (wrench_map @ idle).T)
        about_P = shift_wrench(in_world, X_WE.translation - p_WP)
        determined &= np.abs(about_P).max(axis=0, initial=0.0) < _UNDETERMINED
    return determined
