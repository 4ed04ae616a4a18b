"""Forward dynamics of a cell: accelerations, energies, interaction wrenches, and what is observed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_array, require_finite, shaped
from coop_pin.base.spatial import exp3
from coop_pin.grasps.cell_kinematics import CellKinematics
from coop_pin.grasps.contact_patches import ContactState
from coop_pin.grasps.observation import Observation, PayloadState, payload_quantities
from coop_pin.grasps.spring_damper import SpringState

_NO_WRENCH = np.zeros(6)


class CellDynamics(CellKinematics):
    """Forward dynamics of a cell: its closed chain, springs and contacts under given forces."""

    @cached_property
    def _free_data(self) -> pin.Data:
        return self.model.model.createData()

    @cached_property
    def _has_elements(self) -> bool:
        """Whether springs or contacts act."""
        return bool(self.springs.arms) or len(self.patches) > 0

    @cached_property
    def _has_stops(self) -> bool:
        """Whether joints have end stops."""
        return bool(self.stops)

    @cached_property
    def _has_tools(self) -> bool:
        return bool(self.cell.tools)

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
        if closed.closures.rows:
            return closed.solver.acceleration(q, v, tau + elements.force(q)), power
        return pin.aba(closed.model, self._free_data, q, v, tau, elements.wrenches), power

    def payload_modes(self, q: Array, *, arms_move: bool = False) -> tuple[Array, Array]:
        """Return ``PayloadJoints.modes`` of a payload of several links at a configuration."""
        assert self.joints is not None
        q = self.mechanism.project_configuration(q)
        closures = self.mechanism.closures.state(q, np.zeros(self.mechanism.model.nv))
        return self.joints.modes(q, closures.jacobian, arms_move)

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
            q: configuration on the closures, shape (nq,).
            v: velocity, shape (nv,).
            tau: generalised force of everything but the grasps, including J_WP^T push, shape (nv,).
            push: wrench on the payload about P in world axes, N and N m, shape (6,).

        Raises:
            OpenClosureError: a rigid grasp is open at q.
        """
        q, v, tau = self.mechanism.closed(q), self._v("v", v), self._v("tau", tau)
        return self.unchecked_wrenches(q, v, tau, as_array("push", push, 6))

    def unchecked_wrenches(self, q: Array, v: Array, tau: Array, push: Array) -> Array:
        """Return the interaction wrenches of arguments that are valid arrays, as those of a plant at a tick.

        Raises:
            OutOfRangeError: a wrench is not finite.
        """
        elements = self._move(q, v, tau)
        wrenches = self._wrenches(self.mechanism.solver.forces, push, *elements)
        return require_finite("the interaction wrenches", wrenches)

    def moved_wrenches(
        self, q: Array, v: Array, a: Array, of_closures: Sequence[pin.Force], push: Array
    ) -> Array:
        """Return the interaction wrenches of a motion and wrenches on tips, as another engine has them.

        Args:
            q: configuration, shape (nq,).
            v: velocity, shape (nv,).
            a: acceleration, shape (nv,).
            of_closures: wrench on the tip of each rigid grasp that is a closure, about it in its axes; of a
                joint about C.
            push: wrench on the payload about P in world axes, shape (6,).

        Raises:
            OutOfRangeError: a wrench is not finite.
        """
        self._frames.move(q, v, a)
        return require_finite("the interaction wrenches", self._wrenches(of_closures, push))

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
        parts = list(map(self._observed, *states))
        observation = Observation(**{name: np.array([part[name] for part in parts]) for name in parts[0]})
        require_finite("the interaction wrenches", observation.interaction_wrench)
        return observation

    def _observed(self, q: Array, v: Array, tau: Array, push: Array) -> dict[str, Any]:
        """Return the quantities of an Observation at a state, those that the cell has."""
        elements, frames = self._move(q, v, tau), self._frames
        payload = PayloadState(
            frames.payload.homogeneous, frames.payload_twist(), push, self.model.surroundings
        )
        kinetic, potential = frames.energies()
        wrenches = self._wrenches(self.mechanism.solver.forces, push, *elements)
        quantities = payload_quantities(payload)
        quantities["kinetic_energy"], quantities["potential_energy"] = kinetic, potential
        quantities["tip_position"], quantities["interaction_wrench"] = frames.tip_positions(), wrenches
        if self._has_elements:
            quantities |= self._of_elements(*elements)
        if self._has_stops:
            quantities |= self.stops.quantities(q, v)
        if self.joints is not None:
            quantities |= self.joints.quantities(q, v)
        if self.model.shared:
            quantities |= self._of_shared(q, v, wrenches)
        if self._has_tools:
            quantities["tip_pose"] = np.array([tip.homogeneous for tip in frames.tips])
        return quantities

    def _of_shared(self, q: Array, v: Array, wrenches: Array) -> dict[str, Any]:
        """Return positions and rates of the joints under arms, and what the floor does to their robots.

        F_floor = sum_b d/dt h_b - sum_i F_i - weights, over the bodies of the robot and the arms that it has.
        """
        tree = self.model
        pin.rnea(tree.model, self._free_data, q, v, self._frames.acceleration)
        quantities: dict[str, Any] = {
            "shared_position": np.array([each.angles.of(q[each.q_slice])[0] for each in tree.shared]),
            "shared_velocity": np.array([v[each.v_slice.start] for each in tree.shared]),
        }
        if tree.carrier is not None:
            floor = self._on_floor(tree.shared[0].joint, tree.carrier.arms, wrenches)
            weight = pin.Force(tree.fixed.mass * tree.model.gravity.linear, np.zeros(3))
            floor -= pin.SE3(np.eye(3), tree.fixed.lever).act(weight)
            quantities["floor_wrench"] = floor.vector
        if tree.wheels:
            forces = []
            for name, (x, _, yaw) in tree.wheels.items():
                turned = exp3(np.array((0.0, 0.0, q[yaw.q_slice.start])))
                R = self.cell.arms[name].base.matrix[:3, :3] @ turned
                forces.append(R.T @ self._on_floor(x.joint, (name,), wrenches).linear)
            quantities["wheel_force"] = np.array(forces)
        return quantities

    def _on_floor(self, first: int, arms: Sequence[str], wrenches: Array) -> pin.Force:
        """Return the wrench of the floor on bodies from a first joint on, about the world's origin."""
        tree, P = self.model, self._frames.payload.translation
        floor = self._free_data.liMi[first].act(self._free_data.f[first])  # its parent is the world
        if {*tree.closed_by_tree} & {*arms}:  # the payload is in an arm's hand
            floor -= self._frames.payload.act(pin.Force(self._frames.payload_balance()))
        for arm, F in zip(tree.arms, wrenches, strict=True):
            if arm.name in arms:
                floor -= pin.SE3(np.eye(3), P).act(pin.Force(F))
        return floor

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
        grasps = self.springs.present() if self.springs.arms else None
        contacts = self.patches.present() if len(self.patches) else None
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
            X_EC = self.rigid.joints.get(index)
            X_WC = tips[index] if X_EC is None else tips[index] * X_EC
            in_payload[index] = X_WP.actInv(X_WC).act(F_E).vector
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
