"""Kinematics of a cell: its tree, the grasps that hold in it, and where payload and tips are."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from functools import cached_property
from typing import Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_array, as_number, as_pose, require_finite, require_type
from coop_pin.base.errors import NameNotFoundError, OpenClosureError
from coop_pin.base.spatial import inverse_pose, rotate_vector6, shift_wrench, weight_wrench
from coop_pin.base.spatial.grasp_rows import GraspRows
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.chain.closure_set import ClosureError
from coop_pin.description.cell.cell import Cell
from coop_pin.description.events import Surroundings
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps.contact_equilibrium import started
from coop_pin.grasps.contact_patches import ContactPatches, PatchesState
from coop_pin.grasps.equilibrium import reached
from coop_pin.grasps.force_elements import ForceElements
from coop_pin.grasps.grasp_frames import GraspFrames
from coop_pin.grasps.grasp_springs import GraspsHeld, GraspSprings
from coop_pin.grasps.payload_joints import PayloadJoints
from coop_pin.grasps.rigid_grasps import ClosuresHeld, RigidGrasps
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.cell_model import CellModel
from coop_pin.model.inverse_kinematics import solve_ik
from coop_pin.model.joint_stops import CellStops
from coop_pin.model.pinocchio_model import frame_id, symmetric
from coop_pin.model.transmission import Transmission


class CellKinematics:
    """Tree of a cell with its grasps: configurations, and the places of payload and tips.

    The payload is welded to the tip of the first arm with a rigid grasp (that arm's wrench follows from the
    equations of motion of the payload), or free. Closures hold the other rigid grasps, springs and dampers
    the compliant ones. Both are the same mechanism.

    Attributes:
        cell: the description.
        model: the tree, with the positions of arms and payload in it; ``surround`` changes it in place.
        transmission: transmission between drives and joints, with their friction.
        stops: end stops of the joints of arms and payload.
        joints: joints of a payload of several links; None of one body.
        springs: the compliant grasps in it.
        rigid: the rigid grasps in it that are closures.
        patches: patches of arms and tables in it.
        elements: all force elements, the springs among them.
    """

    def __init__(self, cell: Cell, options: PlantOptions | None = None) -> None:
        """Build the chain.

        Args:
            cell: the description.
            options: payload welded or free, formulation and stabilisation; the defaults of PlantOptions when
                omitted.

        Raises:
            UrdfError, NameNotFoundError: an arm cannot be built.
        """
        options = PlantOptions() if options is None else options
        require_type("cell", cell, Cell)
        require_type("options", options, PlantOptions)
        self.cell = cell
        self.model = CellModel(cell, options.payload)
        self.transmission = Transmission(cell, self.model.arms, self.model.model.nv, self.model.shared)
        self.rigid = RigidGrasps(cell, self.model, options)
        self.stops = CellStops(cell, self.model)
        self.joints = None if cell.payload.links is None else PayloadJoints(cell, self.model, self.stops)
        self.elements = ForceElements(self.model)
        self.springs = GraspSprings(cell, self.model, self.elements)
        self.patches = ContactPatches(cell, self.model, self.elements)
        parts: tuple[GraspSprings | ContactPatches, ...] = self.springs, self.patches
        self.elements.elements = self._parts = [part for part in parts if len(part)]
        self._frames = GraspFrames(self.model)

    @property
    def mechanism(self) -> ClosedChain:
        """The tree with the closures that hold."""
        return self.rigid.mechanism

    @cached_property
    def _joint_rows(self) -> dict[str, GraspRows]:
        """Rows of the grasps that are joints, by arm."""
        rows = ((name, self.cell.grasp_rows(name)) for name in self.cell.jointed)
        return {name: each for name, each in rows if each is not None}

    @cached_property
    def arms(self) -> tuple[CellArm, ...]:
        """Model of each arm, without the payload."""
        return tuple(CellArm(self.cell, name) for name in self.cell.arms)

    def surround(self, surroundings: Surroundings) -> None:
        """Set the payload's inertia and gravity, from the next call on; the push is an argument of each."""
        require_type("surroundings", surroundings, Surroundings)
        self.model.surround(surroundings)

    def carrying(self, cell: Cell) -> Self:
        """Return the chain of a cell with another payload in rigid grasps, on the tree of this one.

        The tree carries the other payload from then on.
        """
        chain = copy.copy(self)
        chain.cell = cell
        chain.surround(cell.surroundings)
        return chain

    def damp(self, q: Array) -> None:
        """Set the damping that is stated as a ratio, by the mobility at a configuration."""
        for part in self._parts:
            part.damp(q)
        if self.stops:
            self.stops.damp(self.joint_mobility(q))

    def joint_mobility(self, q: Array) -> Array:
        """Return the speed of each joint after a unit impulse on it in the closed chain, shape (nv,).

        It is the diagonal of M^-1 - M^-1 J^T (J M^-1 J^T)^+ J M^-1.
        """
        model = self.model.model
        M_inverse = np.linalg.inv(symmetric(pin.crba(model, model.createData(), q)))
        return np.array([self.mechanism.project_velocity(q, v)[j] for j, v in enumerate(M_inverse)])

    def release(self, arm: int) -> None:
        """Open the grasp of an arm, by its index."""
        grasps, number = self._grasp_of(arm)
        grasps.release(number)

    def grasp(self, arm: int, q: Array, is_nominal: bool = False) -> None:
        """Close the grasp of an arm where its tip is at a configuration, or at the nominal pose."""
        grasps, number = self._grasp_of(arm)
        grasps.grasp(number, None if is_nominal else q)

    def gap(self, arm: int, q: Array) -> ClosureError:
        """Return distance and angle of an arm's tip from its nominal grasp."""
        frames = self._at(q)
        return self._gap(arm, frames.tips[arm], frames.grasps[arm])

    def _gap(self, arm: int, X_WE: pin.SE3, X_WG: pin.SE3) -> ClosureError:
        """Return the closure error between tip and grasp; of a joint in the rows that it holds."""
        if arm not in self.rigid.joints:
            return ClosureError.of(X_WG.actInv(X_WE))
        rows, X_EC = self._joint_rows[self.model.arms[arm].name], self.rigid.joints[arm]
        error = rows.expand(rows.pose_error((X_WE * X_EC).homogeneous, (X_WG * X_EC).homogeneous))
        return ClosureError(float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:])))

    def brake(self, arm: int, q: Array) -> None:
        """Hold the joints of an arm, by its index, at a configuration from now on."""
        self.rigid.brake(arm, q)

    def held(self) -> tuple[GraspsHeld, ClosuresHeld, PatchesState]:
        """Return which compliant grasps hold, at which poses, which closures, and the memory of contacts."""
        return self.springs.held(), self.rigid.held(), self.patches.state

    def hold(self, held: tuple[GraspsHeld, ClosuresHeld, PatchesState]) -> None:
        """Return to grasps, closures and contacts that held."""
        compliant, closures, self.patches.state = held
        self.springs.restore(compliant)
        if closures.grasps.holds is not self.rigid.holds or closures.brakes is not self.rigid.brakes:
            self.rigid.restore(closures)

    def _grasp_of(self, arm: int) -> tuple[GraspSprings | ContactPatches | RigidGrasps, int]:
        """Return the grasps to which that of an arm belongs, and its number among them."""
        grasps = next(each for each in (self.springs, self.patches, self.rigid) if arm in each.arms)
        return grasps, grasps.arms.index(arm)

    def configuration(self, X_WP: ArrayLike, squeeze: ArrayLike | None = None) -> Array:
        """Return the configuration that holds the payload at a pose, each arm near its posture.

        Compliant grasps are deflected: each carries its arm's share of the payload's weight. Patches are
        pressed.

        Args:
            X_WP: payload pose, shape (4, 4).
            squeeze: desired internal wrenches by which patches are pressed, in payload axes, N and N m, shape
                (m, 6); zero when omitted.

        Raises:
            UnreachablePoseError: an arm cannot reach its grasp; with the gap.
            FieldError: a compliant grasp is too soft for its share, or the joint of a payload with a base
                does not reach the pose.
        """
        X = as_pose("X_WP", X_WP)
        configurations = [solve_ik(arm, X, posture=arm.description.posture) for arm in self.arms]
        q = self.model.configuration(configurations, X)
        if self.joints is not None:
            self.joints.require_reached(q, X)
        return self.settled(q, squeeze)

    def settled(self, q: ArrayLike, squeeze: ArrayLike | None = None) -> Array:
        """Return a configuration on the rigid grasps near one, with the others deflected by the load.

        Args:
            q: configuration with the tips of other grasps at them.
            squeeze: Squeeze of ``configuration``.

        Raises:
            OpenClosureError: the rigid grasps cannot be closed.
            FieldError: a compliant grasp is too soft for its share of the load.
        """
        if self.joints is not None:
            q = self._linked(self.joints, as_array("q", q, self.mechanism.model.nq))
        q = self.mechanism.project_configuration(q)
        q = self.springs.deflected(q) if self.springs.arms else q
        if not len(self.patches):
            return q
        m = len(self.cell.arms)
        pressed = np.zeros((m, 6)) if squeeze is None else as_array("squeeze", squeeze, m, 6)
        return started(self.patches, q, pressed)

    def _linked(self, joints: PayloadJoints, q: Array) -> Array:
        """Return a configuration with the links of the payload at rest, and the arms at their grasps."""
        model, data, side = self.model.model, self.elements.data, self.elements.side
        q = joints.at_rest(q, self.payload_pose(q))
        for slot in self.model.arms:
            pin.forwardKinematics(model, data, q)
            target = side(frame_id(model, f"payload/{slot.name}")).pose
            q = reached(model, data, q, side(slot.tip), slot.v_slice, target)
        return q

    def loads(self, q: ArrayLike) -> Array:
        """Return the wrench on each arm at rest about P as the arm's own kinematics see it, shape (m, 6).

        Rigid grasps have their load shares, F_i = c_i [m_0 g, 0]; beside joints L_i [m_0 g, 0]. Of a payload
        of several links it is the weight of all at their places, see ``PayloadJoints.loads``.
        """
        weight = weight_wrench(self.cell.payload.mass, self.cell.gravity)
        loads = self.cell.shares[:, None] * weight
        if self.cell.jointed or self.joints is not None:
            frames = self._at(self._q(q))
            grasps = (inverse_pose(grasp.matrix)[:3, 3] for grasp in self.cell.grasps.values())
            seen = np.array([X_WE.act(p_EP) for X_WE, p_EP in zip(frames.tips, grasps, strict=True)])
            if self.joints is not None:
                loads = self.joints.loads(self._q(q), frames.payload.homogeneous)
            else:
                R, L = frames.payload.rotation, self.cell.loads_within([True] * len(loads))
                loads = rotate_vector6(R, L.dot(rotate_vector6(R.T, weight)))
            return shift_wrench(loads, frames.payload.translation - seen)
        for part in self._parts:
            loads = part.loads(self._q(q), loads)
        return loads

    def posed_configuration(self, angles: Mapping[str, ArrayLike], X_WP: ArrayLike) -> Array:
        """Return the configuration at stated joint angles of every arm, whether or not the grasps are closed.

        Args:
            angles: joint angles of every arm, rad, shape (k,) each.
            X_WP: payload pose, shape (4, 4); not used if the payload is welded to the first arm.
        """
        require_type("angles", angles, Mapping)
        for name in self.cell.arms:
            if name not in angles:
                raise NameNotFoundError("arm", name, map(str, angles), "the angles")
        stated = [
            arm.angles.configuration(
                as_array(f"angles of arm {arm.name!r}", angles[arm.name], len(arm.drive))
            )
            for arm in self.model.arms
        ]
        return self.model.configuration(stated, as_pose("X_WP", X_WP))

    def require_held(self, q: ArrayLike, X_WP: ArrayLike, allowed: float) -> None:
        """Raise an error if a tip is farther from its grasp on the payload at X_WP than allowed, m or rad.

        Raises:
            OpenClosureError: with the arm and its closure error.
        """
        frames, X_WP, allowed = self._at(self._q(q)), as_pose("X_WP", X_WP), as_number("allowed", allowed)
        for index, (arm, X_WE) in enumerate(zip(self.model.arms, frames.tips, strict=True)):
            gap = self._gap(index, X_WE, pin.SE3(X_WP @ self.cell.grasps[arm.name].matrix))
            if not max(gap) <= allowed:
                raise OpenClosureError(f"grasp of arm {arm.name}", gap.distance, gap.angle, allowed)

    def payload_pose(self, q: ArrayLike) -> Array:
        """Return X_WP, shape (4, 4)."""
        return self._at(self._q(q)).payload.homogeneous

    def payload_jacobian(self, q: ArrayLike) -> Array:
        """Return J_WP with V_WP = J_WP v for the velocity v of the tree, shape (6, nv)."""
        return self._frames.payload_jacobian(self._q(q))

    def payload_twist(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return V_WP, shape (6,)."""
        return require_finite("V_WP", self.payload_jacobian(q).dot(self._v("v", v)))

    def tip_positions(self, q: ArrayLike) -> Array:
        """Return the position of every tip in the world, m, shape (m, 3)."""
        return self._at(self._q(q)).tip_positions()

    def closure_errors(self, q: ArrayLike) -> list[ClosureError]:
        """Return the closure error between tip and grasp of each arm."""
        frames = self._at(self._q(q))
        errors = frames.closure_errors(self.rigid.closed)
        for arm, X_GE in self.rigid.closed.items() if self.rigid.joints else ():
            if arm in self.rigid.joints:
                X_WG = frames.grasps[arm] if X_GE is None else frames.grasps[arm] * X_GE
                errors[arm] = self._gap(arm, frames.tips[arm], X_WG)
        return errors

    def _q(self, q: ArrayLike) -> Array:
        return as_array("q", q, self.mechanism.model.nq)

    def _v(self, name: str, v: ArrayLike) -> Array:
        return as_array(name, v, self.mechanism.model.nv)

    def _at(self, q: Array, *rates: Array) -> GraspFrames:
        """Return the frames at (q, v, a), until the next call."""
        self._frames.move(q, *rates)
        return self._frames
