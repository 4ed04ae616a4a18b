"""A cell as a closed chain: its arms hold the payload, and their wrenches can be read."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.chain.closing import closing_angles
from coop_pin.chain.closure import Closure
from coop_pin.chain.closures import Gap
from coop_pin.description.cell import Cell
from coop_pin.description.clock import PlantOptions
from coop_pin.description.payload import Payload
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.cell_model import CELL_MODELS

_NO_WRENCH = np.zeros(6)


class CellChain:
    """The plant of a cell.

    The payload is rooted at the first arm's tip (its wrench follows from the payload's own balance), or floats free and is
    held by m closures. Both are the same mechanism.

    Attributes:
        cell: the description.
        tree: where arms and payload sit in the Pinocchio tree.
        chain: the closed chain.
    """

    def __init__(self, cell: Cell, options: PlantOptions | None = None) -> None:
        """Build the plant.

        Raises:
            UrdfNotFoundError, UrdfError, FrameNotFoundError: an arm cannot be built.
        """
        options = PlantOptions() if options is None else options
        self.cell = cell
        self.tree = CELL_MODELS[options.payload](cell)
        held = [name for name in cell.arms if name not in self.tree.closed_by_tree]
        closures = [Closure(f"{name}/grasp", f"payload/{name}") for name in held]
        chain = ClosedChain(self.tree.model, closures, options.stabilisation)
        self.chain = chain.with_rank_cut() if options.formulation == "rank-cut" else chain
        self._data = self.tree.model.createData()
        self._held = [index for index, name in enumerate(cell.arms) if name in held]

    def set_payload(self, payload: Payload) -> None:
        """Give the payload another mass and inertia, at once."""
        self.tree.set_payload(payload)

    def configuration(self, X_WP: Array) -> Array:
        """Return the configuration that holds the payload at a pose, each arm near its posture.

        Raises:
            UnreachablePoseError: an arm cannot reach; with the gap.
        """
        angles = []
        for name, arm in self.cell.arms.items():
            model = ArmModel(arm, self.cell.grasps[name].matrix)
            angles.append(closing_angles(name, model, X_WP, arm.posture))
        return self.chain.project_configuration(self.tree.configuration(angles, X_WP))

    def payload_pose(self, q: Array) -> Array:
        """Return X_WP, shape (4, 4)."""
        pin.forwardKinematics(self.tree.model, self._data, q)
        return np.array(pin.updateFramePlacement(self.tree.model, self._data, self.tree.payload_frame).homogeneous)

    def payload_jacobian(self, q: Array) -> Array:
        """Return J_WP of the tree with V_WP = J_WP v, shape (6, nv)."""
        J: Array = pin.computeFrameJacobian(self.tree.model, self._data, q, self.tree.payload_frame, pin.LOCAL_WORLD_ALIGNED)
        return J

    def payload_twist(self, q: Array, v: Array) -> Array:
        """Return V_WP, shape (6,)."""
        return self.payload_jacobian(q) @ v

    def tip_positions(self, q: Array) -> Array:
        """Return the position of every tip in the world, m, shape (m, 3)."""
        pin.framesForwardKinematics(self.tree.model, self._data, q)
        return np.array([self._data.oMf[arm.tip].translation for arm in self.tree.arms])

    def gaps(self, q: Array) -> list[Gap]:
        """Return for each arm how far its tip stands from its grasp."""
        gaps = [Gap(0.0, 0.0)] * len(self.cell.arms)
        for index, gap in zip(self._held, self.chain.gaps(q), strict=True):
            gaps[index] = gap
        return gaps

    def interaction_wrenches(self, q: Array, v: Array, tau: Array, external: Array = _NO_WRENCH) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes: F_ce of eq. (6), shape (m, 6).

        Args:
            q: configuration.
            v: velocity.
            tau: generalised force of everything but the closures, including J_WP^T external, shape (nv,).
            external: wrench on the payload about P in world axes, N and N m, shape (6,).
        """
        a = self.chain.solver.acceleration(q, v, tau)
        model, data = self.tree.model, self._data
        pin.forwardKinematics(model, data, q, v, a)
        pin.updateFramePlacements(model, data)
        wrenches = np.zeros((len(self.cell.arms), 6))
        p_WP = data.oMf[self.tree.payload_frame].translation
        for index, local in zip(self._held, self.chain.solver.wrenches(), strict=True):
            X_WE = data.oMf[self.tree.arms[index].tip]
            force, moment = X_WE.rotation @ local[:3], X_WE.rotation @ local[3:]
            wrenches[index, :3], wrenches[index, 3:] = force, moment + np.cross(X_WE.translation - p_WP, force)
        if self.tree.closed_by_tree:
            wrenches[0] = external - self._payload_balance() - wrenches.sum(axis=0)
        return wrenches

    def _payload_balance(self) -> Array:
        """Return M_0 xddot + Q_0 xdot + W_0 of eq. (5): the wrench that the payload's motion takes, about P in world axes."""
        model, data, frame = self.tree.model, self._data, self.tree.payload_frame
        X_WP, inertia = data.oMf[frame], self.tree.payload_inertia
        V = pin.getFrameVelocity(model, data, frame, pin.LOCAL)
        A = pin.getFrameAcceleration(model, data, frame, pin.LOCAL)
        A.linear -= X_WP.rotation.T @ model.gravity.linear
        wrench = inertia * A + V.cross(inertia * V)
        return np.concatenate((X_WP.rotation @ wrench.linear, X_WP.rotation @ wrench.angular))
