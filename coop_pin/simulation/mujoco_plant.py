"""Plant by MuJoCo: the same tree, drives, friction and pushes as Pinocchio's, and grasps that are soft welds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError, needs_extra
from coop_pin.base.spatial import shift_wrench
from coop_pin.description.cell.cell import Cell
from coop_pin.description.events import Surroundings
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.grasps.observation import Observation
from coop_pin.model.mujoco_model import Weld, mjcf, set_inertias, unlike_mujoco
from coop_pin.simulation.pinocchio_plant import PinocchioPlant

_EVENTS = "payload-change", "wrench-pulse", "gravity-turn", "partner"


def mujoco_reason(cell: Cell, options: PlantOptions, events: Sequence[Any]) -> str:
    """Return what of a scenario MuJoCo's plant does not have; empty if it has all."""
    if cell.has_force_elements:
        return "its grasps give, and only rigid ones are welds"
    if options.payload == "free":
        return "its payload is free (plant.payload)"
    return next((f"it has an event {event.kind!r}" for event in events if event.kind not in _EVENTS), "")


class MujocoPlant(PinocchioPlant):
    """Cell in motion by MuJoCo, a ``Plant``: accelerations and forces of welds are MuJoCo's.

    The tree has the payload in the first arm's hand. Torques, friction and the push act as generalised
    forces that are held over a step, by RK4. A weld is a stiff, critically damped constraint: a rigid grasp
    to within its ``gap``, and the energy balance lacks what it stores and loses.
    """

    engine = "mujoco"

    def __init__(self, chain: CellChain, options: PlantOptions, q: Array) -> None:
        """Start at rest, without torques.

        Args:
            chain: Closed chain of the cell.
            options: Steps and stiffness of the welds.
            q: Configuration on the closures, shape (nq,).

        Raises:
            MissingExtraError: mujoco is not installed.
            FieldError: a joint of the tree is neither a single turn nor a slide.
        """
        with needs_extra("mujoco", "mujoco", "the engine 'mujoco'"):
            import mujoco
        tree, closed = chain.model.model, chain.rigid.mechanism.closures.closures
        if name := unlike_mujoco(tree):
            raise FieldError(f"is 'mujoco', which has no joint as {name!r}; choose 'pinocchio'", "engine")
        frames = [
            [tree.getFrameId(each) for each in (closure.frame_a, closure.frame_b)] for closure in closed
        ]
        welds = [
            Weld(
                tuple(tree.frames[f].parentJoint for f in pair), tuple(tree.frames[f].placement for f in pair)
            )
            for pair in frames
        ]
        self._mujoco, self._tree, self._frames = mujoco, tree, frames
        text = mjcf(tree, welds, time_constant=1.0, impedance=options.mujoco.impedance)
        self._model = mujoco.MjModel.from_xml_string(text)
        self._data, self._pin = mujoco.MjData(self._model), tree.createData()
        self._options, self._neutral = options.mujoco, pin.neutral(tree)
        self._first = next(
            i for i, arm in enumerate(chain.model.arms) if arm.name in chain.model.closed_by_tree
        )
        super().__init__(chain, options, q)

    def surround(self, surroundings: Surroundings) -> None:
        """Replace the surroundings from now on; the energy that this adds counts as work."""
        super().surround(surroundings)
        set_inertias(self._model, self._tree)

    def advance(self, t: float, h: float) -> None:
        """Integrate from time t over h seconds."""
        steps, data, model = self._options.steps, self._data, self._model
        model.opt.timestep = h / steps
        model.eq_solref[:, 0] = self._options.time_constant * h / steps
        for step in range(steps):
            x = self._set_state(self.q, self.v, self._force(t + step * h / steps, self.q, self.v))
            self._mujoco.mj_step(model, data)
            self.work[: len(self._forces)] += self._forces @ (data.qpos - x)
            self.q, self.v = pin.integrate(self._tree, self._neutral, data.qpos), data.qvel.copy()
        self.time = t + h

    def interaction_wrenches(self) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes, shape (m, 6)."""
        push = self.payload_wrench(self.q, self.v, self.time)
        return self._wrenches(self.q, self.v, self.generalised_force(), push)

    def observe(self, q: Array, v: Array, force: Array, time: Array) -> Observation:
        """Return what is recorded of n states in the present surroundings, as of Plant."""
        observation = super().observe(q, v, force, time)
        wrenches = []
        for state in zip(q, v, force, time.tolist(), observation.external_wrench, strict=True):
            configuration, velocity, held, _, push = state
            tau = held + self.transmission.friction(velocity)
            tau = tau + self.chain.payload_jacobian(configuration).T @ push
            wrenches.append(self._wrenches(configuration, velocity, tau, push))
        return observation._replace(interaction_wrench=np.array(wrenches))

    def _set_state(self, q: Array, v: Array, tau: Array) -> Array:
        """Set MuJoCo's state and forces; return its positions, shape (nv,)."""
        x = pin.difference(self._tree, self._neutral, q)
        self._data.qpos[:], self._data.qvel[:], self._data.qfrc_applied[:] = x, v, tau
        return x

    def _wrenches(self, q: Array, v: Array, tau: Array, push: Array) -> Array:
        """Return interaction wrenches: of welds by MuJoCo's multipliers, of the first arm by balance.

        A weld's rows are A (J_E - J_G) with the Jacobians of tip and grasp, and its wrench is A^T f about
        the tip; the sum of all is M_0 xddot + Q_0 xdot + W_0 - push of the payload, with the other sign.
        """
        tree, data, model = self._tree, self._data, self._model
        self._set_state(q, v, tau)
        self._mujoco.mj_forward(model, data)
        rows = data.efc_J.reshape(-1, model.nv)
        pin.computeJointJacobians(tree, self._pin, q)
        pin.forwardKinematics(tree, self._pin, q, v, data.qacc)
        pin.updateFramePlacements(tree, self._pin)
        P, wrenches = self.chain.model.payload_frame, np.zeros((len(self.chain.model.arms), 6))
        p_WP = self._pin.oMf[P].translation
        for weld, (pair, arm) in enumerate(zip(self._frames, self.chain.rigid.closed, strict=True)):
            J_E, J_G = (pin.getFrameJacobian(tree, self._pin, f, pin.LOCAL_WORLD_ALIGNED) for f in pair)
            at = slice(6 * weld, 6 * weld + 6)
            on_tip = np.linalg.lstsq((J_E - J_G).T, rows[at].T @ data.efc_force[at], rcond=1e-9)[0]
            wrenches[arm] = shift_wrench(on_tip, self._pin.oMf[pair[0]].translation - p_WP)
        spatial = pin.getFrameClassicalAcceleration(tree, self._pin, P, pin.LOCAL_WORLD_ALIGNED)
        payload, R = self.chain.model.payload_inertia, self._pin.oMf[P].rotation
        inertia = R @ payload.inertia @ R.T
        omega = pin.getFrameVelocity(tree, self._pin, P, pin.LOCAL_WORLD_ALIGNED).angular
        moved = np.concatenate(
            (
                payload.mass * (spatial.linear - tree.gravity.linear),
                inertia @ spatial.angular + np.cross(omega, inertia @ omega),
            )
        )
        wrenches[self._first] = push - moved - wrenches.sum(axis=0)
        return wrenches
