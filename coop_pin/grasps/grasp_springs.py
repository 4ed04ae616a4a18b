"""Springs and dampers of compliant grasps: force elements between the tips of arms and the payload.

``GraspSprings`` has the places of ``spring_state`` in the tree of a cell. The steps of a run ask for it some
thousand times a second: ``_write_wrenches`` is compiled for the joints of its tree. Without llvmlite
numpy runs the same function, and a run takes some six times as long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.disk_cache import DiskCache
from coop_pin.base.spatial import weight_wrench
from coop_pin.description.cell.cell import Cell
from coop_pin.grasps.equilibrium import MOST_STEPS, SETTLED, at_rest, reached
from coop_pin.grasps.force_elements import ForceElements, own_loads
from coop_pin.grasps.spring_damper import MovingFrame, SpringDamper, SpringState, spring_state
from coop_pin.model.cell_model import CellModel
from coop_pin.model.pinocchio_model import frame_id, symmetric
from coop_pin.tracing.kernel import Kernel, Layout, Program
from coop_pin.tracing.llvm_machine import LlvmMachine, can_compile


class _Slots(NamedTuple):
    """Slots of a block that code reads and writes by numpy, as of a kernel.

    Attributes:
        views: views of the slots, by name.
    """

    views: dict[str, Array]

    def read(self, name: str) -> Array:
        """Return a field of the block."""
        return self.views[name]

    def write(self, name: str, values: Any) -> None:
        """Write a field of the block."""
        self.views[name][...] = values


def _write_wrenches(kernel: Kernel | _Slots, joints: Sequence[Sequence[int]]) -> None:
    """Write the states of grasps between frames E of the arms and G of the payload; add to F_J of the joints.

    A pose is [R^T; p^T], shape (4, 3). A wrench on the body of a joint is about its origin in its axes.
    """
    X_WJ, V_J, F_J = (kernel.read(name).copy() for name in ("X_WJ", "V_J", "F_J"))
    frames, stiffness, damping = (kernel.read(name) for name in ("frames", "stiffness", "damping"))
    states = list[SpringState]()
    for i, pair in enumerate(joints):
        spring = SpringDamper.of(stiffness[i][None], damping[i][None])
        E, G = (_moving(X_WJ[joint], frames[i][side], V_J[joint]) for side, joint in enumerate(pair))
        states.append(spring_state(spring, E, G))
        for sign, joint in zip((1.0, -1.0), pair, strict=True):
            f, m = sign * states[i].on_body[:3], sign * states[i].on_body[3:]
            R_JW, p = X_WJ[joint][:3], X_WJ[joint][3]
            F_J[joint] = F_J[joint] + np.concatenate((R_JW @ f, R_JW @ (m - np.cross(p, f))))
    kernel.write("F_J", F_J)
    kernel.write("dissipated", sum(state.power for state in states))
    for name, values in zip(SpringState._fields, zip(*states, strict=True), strict=True):
        kernel.write(name, np.stack(values))


def _moving(X_WJ: Array, X_JF: Array, V_J: Array) -> MovingFrame:
    """Return a frame on a joint: poses as [R^T; p^T], twist in axes of the joint, shape (2, 3)."""
    R_JW, p_WJ = X_WJ[:3], X_WJ[3]
    v, w = V_J[0] @ R_JW, V_J[1] @ R_JW
    V = np.concatenate((v + np.cross(p_WJ, w), w))
    return MovingFrame((X_JF[:3] @ R_JW).T, X_JF[3] @ R_JW + p_WJ, V)


@cache
def _compiled(joints: tuple[tuple[int, int], ...], count: int) -> tuple[Layout, LlvmMachine | None]:
    """Return the slots of grasps between pairs of a tree's joints, and their code; None without llvmlite."""
    lanes, n = Layout(), len(joints)
    lanes.add(X_WJ=(count, 4, 3), V_J=(count, 2, 3), F_J=(count, 6), dissipated=())
    lanes.add(frames=(n, 2, 4, 3), stiffness=(n, 6), damping=(n, 6))
    lanes.add(on_body=(n, 6), wrench=(n, 6), power=(n,), position=(n, 3), rotation=(n, 3, 3))
    if not can_compile():
        return lanes, None
    kernel = Kernel("grasps", lanes, Layout())
    _write_wrenches(kernel, joints)
    return lanes, LlvmMachine(Program([kernel], lanes, 0, 0, np.array([(0, 0)])), 1, DiskCache())


class GraspsHeld(NamedTuple):
    """Which compliant grasps hold, and their poses; the arrays are not written to.

    Attributes:
        holds: mask of the grasps that hold, shape (n,).
        poses: poses on the payload at which their springs rest, shape (n, 4, 4).
    """

    holds: Mask
    poses: Array


def changed(values: Any, index: int, value: Any) -> Any:
    """Return a copy of an array with another entry."""
    values = values.copy()
    values[index] = value
    return values


class GraspSprings:
    """Compliant grasps in the tree of a cell.

    Attributes:
        arms: indices of their arms.
        springs: their springs and dampers. A damping ratio gives no damping before ``damp`` is called.
        holds: grasps that hold, shape (n,); the others have no wrench.
    """

    def __init__(self, cell: Cell, tree: CellModel, bodies: ForceElements) -> None:
        """Find the frames of the compliant grasps.

        Args:
            cell: Description.
            tree: Tree of the cell, which is kept.
            bodies: Joints of the tree and the wrenches on them, to which the springs add theirs.
        """
        names, grasps, model = list(cell.arms), cell.compliant, tree.model
        self.arms = [names.index(name) for name in grasps]
        self._cell, self._tree, self._grasps = cell, tree, grasps
        self._bodies, self._data, self._rest = bodies, bodies.data, np.zeros(model.nv)
        self._sides = [
            (bodies.side(tree.arms[index].tip), bodies.side(frame_id(model, f"payload/{name}")))
            for index, name in zip(self.arms, grasps, strict=True)
        ]
        self._X_JP = model.frames[tree.payload_frame].placement.copy()
        self._poses = np.array([grasp.matrix for grasp in grasps.values()]).reshape(-1, 4, 4)
        if grasps:
            pairs = tuple((arm.joint, payload.joint) for arm, payload in self._sides)
            lanes, machine = _compiled(pairs, model.njoints)
            block = np.zeros(lanes.size)
            self._at = lanes.views(block)
            by_numpy: list[Callable[[], object]] = [partial(_write_wrenches, _Slots(self._at), pairs)]
            (self._call,) = machine.single(block, np.zeros((1, 0))) if machine else by_numpy
            self._rows = [self._at[name].reshape(-1).data for name in ("X_WJ", "V_J", "F_J", "dissipated")]
        stiffness = np.array([grasp.stiffness for grasp in grasps.values()]).reshape(-1, 6)
        damping = [np.zeros(6) if g.damping is None else np.array(g.damping) for g in grasps.values()]
        self.springs = SpringDamper.of(stiffness, np.array(damping).reshape(-1, 6))
        self.holds = np.ones(len(grasps), dtype=bool)
        self._load()

    def __len__(self) -> int:
        """Return the number of compliant grasps."""
        return len(self.arms)

    def act(self) -> float:
        """Add the wrenches at the state of the joints to theirs; return the power of the dampers, W."""
        (X_WJ, V_J, F_J, dissipated), (poses, twists, wrenches) = self._rows, self._bodies.rows
        X_WJ[:] = poses
        V_J[:] = twists
        F_J[:] = wrenches
        self._call()
        wrenches[:] = F_J
        return dissipated[0]

    def of_arms(self, values: Array) -> Array:
        """Return values of grasps, shape (..., n, k), as those of all arms, NaN of others, (..., m, k)."""
        table = np.full((*values.shape[:-2], len(self._tree.arms), values.shape[-1]), np.nan)
        table[..., self.arms, :] = values
        return table

    def present(self) -> SpringState:
        """Return the grasps at the state at which they acted last."""
        return SpringState(*(self._at[name].copy() for name in SpringState._fields))

    def at(self, q: Array, v: Array) -> SpringState:
        """Return the grasps at a state."""
        self._bodies.move(q, v)
        self.act()
        return self.present()

    def energy(self, state: SpringState) -> float:
        """Return the energy in all springs at a state, J."""
        return float(self.springs.energy(state.position, state.rotation)[self.holds].sum())

    def jacobians(self, q: Array) -> Array:
        """Return B with V = B v, the twists of SpringDamper, shape (n, 6, nv)."""
        model, data = self._bodies.model, self._data
        pin.computeJointJacobians(model, data, q)
        return np.array(
            [
                pin.SE3(payload.pose.rotation, arm.pose.translation).toActionMatrixInverse()
                @ (self._bodies.jacobian(arm) - self._bodies.jacobian(payload))
                for arm, payload in self._sides
            ]
        ).reshape(-1, 6, model.nv)

    def matrices(self, q: Array) -> tuple[Array, Array]:
        """Return stiffness B^T K B and damping B^T D B at undeflected grasps, shape (nv, nv) each."""
        B, springs = self.jacobians(q)[self.holds], SpringDamper(*(part[self.holds] for part in self.springs))
        return tuple(np.einsum("nji,nj,njk->ik", B, part, B) for part in (springs.stiffness, springs.damping))

    def damp(self, q: Array) -> None:
        """Set the damping that is stated as a ratio, by the mobility at a configuration."""
        tree, damping = self._tree, self.springs.damping.copy()
        M, B = symmetric(pin.crba(tree.model, tree.model.createData(), q)), self.jacobians(q)
        inertia = tree.payload_inertia.matrix()
        for number, (index, grasp) in enumerate(zip(self.arms, self._grasps.values(), strict=True)):
            joints, (tip, payload) = tree.arms[index].v_slice, self._sides[number]
            J, X_PG = B[number][:, joints], pin.SE3(grasp.matrix)
            p_GE = payload.pose.actInv(tip.pose).translation
            A = (X_PG * pin.SE3(np.eye(3), p_GE)).toActionMatrixInverse()
            mobility = J @ np.linalg.solve(M[joints, joints], J.T) + A @ np.linalg.solve(inertia, A.T)
            if grasp.damping is None:
                critical = 2.0 * np.sqrt(self.springs.stiffness[number] / np.diagonal(mobility))
                damping[number] = grasp.damping_ratio * critical
        self.springs = self.springs._replace(damping=damping)
        self._load()

    def _load(self) -> None:
        """Write frames, stiffness and damping to the code's slots."""
        for number, (sides, acting) in enumerate(zip(self._sides, self.acting(), strict=True)):
            self._at["frames"][number] = [side.X_JF.homogeneous[:3].T for side in sides]
            self._at["stiffness"][number] = acting.stiffness
            self._at["damping"][number] = acting.damping

    def acting(self) -> list[SpringDamper]:
        """Return spring and damper of each grasp, n = 1; zero where it is open."""
        return [
            SpringDamper(*(holds * part[None, number] for part in self.springs))
            for number, holds in enumerate(self.holds)
        ]

    def release(self, number: int) -> None:
        """Open a grasp."""
        self.restore(GraspsHeld(changed(self.holds, number, False), self._poses))

    def grasp(self, number: int, q: Array | None = None) -> None:
        """Close a grasp at its nominal pose, or at that of its tip at a configuration."""
        pose = list(self._grasps.values())[number].matrix
        if q is not None:
            state = self.at(q, self._rest)
            X_GE = pin.SE3(state.rotation[number], state.position[number])
            pose = (pin.SE3(self._poses[number]) * X_GE).homogeneous
        self.restore(GraspsHeld(changed(self.holds, number, True), changed(self._poses, number, pose)))

    def held(self) -> GraspsHeld:
        """Return which grasps hold, and at which poses."""
        return GraspsHeld(self.holds, self._poses)

    def restore(self, held: GraspsHeld) -> None:
        """Return to grasps that held."""
        for number, (tip, payload) in enumerate(self._sides):
            self._sides[number] = tip, payload._replace(X_JF=self._X_JP * pin.SE3(held.poses[number]))
        self.holds, self._poses = held
        self._load()

    def deflected(self, q: Array) -> Array:
        """Return the configuration at rest at which each compliant grasp carries its arm's share of the load.

        The arms move, as far as they can; then a payload that no rigid grasp holds moves into balance.

        Args:
            q: Configuration with all tips at their grasps.

        Raises:
            FieldError: a spring is too soft for the moment of its share.
        """
        model, data, tree = self._tree.model, self._data, self._tree
        pin.forwardKinematics(model, data, q)
        X_WP = data.oMi[tree.payload_joint] * model.frames[tree.payload_frame].placement
        weight = weight_wrench(self._cell.payload.mass, self._cell.gravity)[:3]
        for index, (name, grasp), (tip, payload) in zip(
            self.arms, self._grasps.items(), self._sides, strict=True
        ):
            slot, X_PG = tree.arms[index], pin.SE3(grasp.matrix)
            load = pin.Force(slot.share * (X_WP.rotation.T @ weight), np.zeros(3))
            target = payload.pose * at_rest(np.array(grasp.stiffness), X_PG.actInv(load).vector, name)
            q = reached(model, data, q, tip, slot.v_slice, target)
            pin.forwardKinematics(model, data, q)
        return q if tree.closed_by_tree or len(self) < len(tree.arms) else self._balanced(q, weight)

    def payload_poses(self, q: Array) -> list[pin.SE3]:
        """Return X_WP as each arm sees it by its own kinematics at a configuration."""
        self._bodies.move(q, self._rest)
        grasps = self._grasps.values()
        return [
            tip.pose * pin.SE3(grasp.matrix).inverse()
            for (tip, _), grasp in zip(self._sides, grasps, strict=True)
        ]

    def loads(self, q: Array, loads: Array) -> Array:
        """Return the wrenches on the arms at rest about P as their own kinematics see it, shape (m, 6).

        A deflected grasp moves that point.

        Args:
            q: Configuration.
            loads: Wrenches of the arms with rigid grasps, about P in world axes, shape (m, 6).
        """
        return own_loads(loads, self.arms, self.payload_poses(q), self.at(q, self._rest).on_body)

    def _balanced(self, q: Array, weight: Array) -> Array:
        """Return q with the payload moved until springs and weight balance."""
        model, joint = self._tree.model, self._tree.payload_joint
        entries = slice(int(model.idx_vs[joint]), int(model.idx_vs[joint]) + 6)
        for _ in range(MOST_STEPS):
            state, B = self.at(q, self._rest), self.jacobians(q)[:, :, entries]
            R = self._data.oMi[joint].rotation
            force = np.einsum("nij,ni->j", B, state.wrench)
            missing = force + np.concatenate((R.T @ weight, np.zeros(3)))
            step = np.zeros(model.nv)
            step[entries] = np.linalg.solve(
                np.einsum("nji,nj,njk->ik", B, self.springs.stiffness, B), missing
            )
            q = pin.integrate(model, q, step)
            if np.abs(step).max() < SETTLED:
                break
        return q
