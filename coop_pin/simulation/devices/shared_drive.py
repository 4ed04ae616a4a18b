"""Shared joints and rolling bases in a run: drives with servos, and the arms' sensors of the joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from coop_pin.base.arrays import Array, frozen
from coop_pin.base.spatial import TaskRows
from coop_pin.description.cell.differential_base import DifferentialBase
from coop_pin.description.cell.shared_joint import SharedJoint, SharedJoints, about
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.arm_model import PayloadKinematics
from coop_pin.model.cell_model import SharedPlace
from coop_pin.reference.pose_reference import PoseTarget


class SharedDrives(NamedTuple):
    """Drives of the shared joints of a cell; the law of their servos is that of SharedJoint.

    Attributes:
        joints: descriptions, from the root of the robot on.
        places: positions in the tree.
        screws: axes at the start about the world's origin in world axes, shape (n, 6).
        holding: tau_0, force at rest at the start, N or N m, shape (n,).
        inertia: I, inertia that each moves there, kg or kg m^2, shape (n,).
        begin: desired pose of the payload at the start, shape (4, 4).
    """

    joints: tuple[SharedJoint, ...]
    places: tuple[SharedPlace, ...]
    screws: Array
    holding: Array
    inertia: Array
    begin: Array

    @classmethod
    def of(cls, scenario: Scenario, chain: CellChain, q: Array, loads: Array) -> Self | None:
        """Return the drives of a cell; None without shared joints.

        Args:
            scenario: Cell and motion.
            chain: Closed chain of the cell.
            q: Configuration at the start, shape (nq,).
            loads: F_i on each arm at rest about P in world axes, shape (m, 6).
        """
        cell, carrier = scenario.cell, scenario.cell.carrier
        if carrier is None:
            return None
        holding, inertia = chain.shared_statics(q, loads)
        joints = tuple(cell.shared_joints[name] for name in carrier.joints)
        begin = scenario.payload_motion.at(0.0).X_WP_d
        return cls(joints, chain.model.shared, carrier.screws, holding, inertia, begin)

    def force(self, time: float, q: Array, v: Array, target: PoseTarget) -> list[Array]:
        """Return the force of each drive from a tick on, N or N m, shape (1,) each.

        Args:
            time: Time of the tick, s.
            q: Configuration of the cell, shape (nq,).
            v: Velocity of the cell, shape (nv,).
            target: Desired motion of the payload.
        """
        forces = []
        rows = zip(self.joints, self.places, self.screws, self.holding, self.inertia, strict=True)
        for joint, slot, screw, tau_0, inertia in rows:
            r, rate = joint.reference(time, slot.start, screw, target, self.begin)
            error = slot.angles.near(q[slot.q_slice], np.array([r])) - r
            w, zeta = joint.bandwidth, joint.damping_ratio
            tau = tau_0 - inertia * (w**2 * error + 2.0 * zeta * w * (v[slot.v_slice] - rate))
            limit = slot.effort if joint.limit == "urdf" else joint.limit
            if limit != "none" and limit > 0.0:
                tau = np.clip(tau, -limit, limit)
            forces.append(frozen(tau))
        return forces


class WheelDrives(NamedTuple):
    """Drives of the bases that roll; the law of the bases and of their servos is that of DifferentialBase.

    Attributes:
        bases: descriptions.
        places: positions of x, y and yaw in the tree, of each base.
        poses: X_WB of each at the start.
        inertia: m and I, inertia that each moves there, kg and kg m^2, shape (b, 2).
        begin: desired pose of the payload at the start, shape (4, 4).
    """

    bases: tuple[DifferentialBase, ...]
    places: tuple[tuple[SharedPlace, ...], ...]
    poses: tuple[Array, ...]
    inertia: Array
    begin: Array

    @classmethod
    def of(cls, scenario: Scenario, chain: CellChain, q: Array, loads: Array) -> Self | None:
        """Return the drives of a cell; None without bases that roll; arguments as of SharedDrives."""
        cell, wheels = scenario.cell, scenario.cell.wheels
        if not wheels:
            return None
        inertia = chain.shared_statics(q, loads)[1].reshape(-1, 3)[:, ::2]
        poses = tuple(cell.arms[name].base.matrix for name in wheels)
        places, begin = tuple(chain.model.wheels.values()), scenario.payload_motion.at(0.0).X_WP_d
        return cls(tuple(wheels.values()), places, poses, inertia, begin)

    def force(self, time: float, q: Array, v: Array, target: PoseTarget) -> list[Array]:
        """Return the force of each drive along x and y and its torque about z, from a tick on, (1,) each.

        The force keeps its direction until the next tick; arguments as of SharedDrives.
        """
        forces = []
        for base, places, X_WB, inertia in zip(
            self.bases, self.places, self.poses, self.inertia, strict=True
        ):
            pose = np.array([q[slot.q_slice.start] for slot in places])
            rates = np.array([v[slot.v_slice.start] for slot in places])
            command = base.command(pose, rates, base.reference(time, X_WB, target, self.begin))
            F, M = base.force(pose, rates, command, inertia)
            forces += [F * np.cos(pose[2]), F * np.sin(pose[2]), M]
        return [frozen(np.array([force])) for force in forces]


class SharedReading(NamedTuple):
    """Reading of the joints under an arm.

    Attributes:
        position: positions, m or rad, shape (n,).
        velocity: rates, m/s or rad/s, shape (n,).
    """

    position: Array
    velocity: Array


class SharedSensors(NamedTuple):
    """Sensors of shared joints for the arms on them: late, counted and offset.

    The memory has positions and rates of the joints at the last ticks, the newest first, shape (d, 2, n).

    Attributes:
        places: positions of the joints in the tree.
        rows: task rows of the cell.
        arms: carrier of each arm, None of one that no joint carries, the joints with their axes at the
            start; their places; delay, ticks; count and offset, m or rad; masks of position and rate.
    """

    places: tuple[SharedPlace, ...]
    rows: TaskRows
    arms: tuple[tuple[SharedJoints, slice, int, float, float, float, float] | None, ...]

    @classmethod
    def of(cls, scenario: Scenario, places: Sequence[SharedPlace]) -> Self | None:
        """Return the sensors of a cell; None without shared joints."""
        cell, carried, first = scenario.cell, dict[str, tuple[SharedJoints, slice]](), 0
        for carrier in cell.carriers:
            entries = slice(first, first := first + len(carrier.joints))
            carried |= dict.fromkeys(carrier.arms, (carrier, entries))
        if not carried:
            return None
        arms: list[tuple[SharedJoints, slice, int, float, float, float, float] | None] = []
        for name in cell.arms:
            sensor = scenario.sensors_of(name).shared_joints
            masks = float(sensor.told != "nothing"), float(sensor.told == "all")
            numbers = (sensor.delay, sensor.resolution, sensor.offset, *masks)
            arms.append((*carried[name], *numbers) if name in carried else None)
        return cls(tuple(places), cell.task_rows, tuple(arms))

    def start(self) -> Array:
        """Return the memory before the first tick: at rest at the start."""
        depth = 1 + max(arm[2] for arm in self.arms if arm is not None)
        rest = np.array([[slot.start for slot in self.places], [0.0] * len(self.places)])
        return np.tile(rest, (depth, 1, 1))

    def step(self, memory: Array, q: Array, v: Array) -> tuple[list[SharedReading | None], Array]:
        """Return the reading of each arm, and the memory.

        Args:
            memory: Memory before.
            q: Configuration of the cell, shape (nq,).
            v: Velocity of the cell, shape (nv,).
        """
        last, told = memory[0, 0], list[SharedReading | None]()
        near = zip(self.places, last, strict=True)
        position = [slot.angles.near(q[slot.q_slice], angle[None])[0] for slot, angle in near]
        rate = [v[slot.v_slice.start] for slot in self.places]
        memory = np.concatenate((np.array([[position, rate]]), memory[:-1]))
        start = np.array([slot.start for slot in self.places])
        for arm in self.arms:
            if arm is None:
                told.append(None)
                continue
            _, entries, delay, count, offset, tells_position, tells_rate = arm
            read, velocity = memory[delay][:, entries]
            read = (count * np.round(read / count) if count else read) + offset
            believed = start[entries] + tells_position * (read - start[entries])
            told.append(SharedReading(frozen(believed), frozen(tells_rate * velocity)))
        return told, memory

    def carried(self, index: int, view: PayloadKinematics, told: SharedReading) -> PayloadKinematics:
        """Return the payload as an arm sees it with the joints under it where it reads them.

        X = D X_0 with D = prod_k exp(S_k dq_k), J = [R_D, R_D] J_0, and J_s v_s about P.

        Args:
            index: Index of the arm.
            view: Pose and Jacobian with the joints where they start.
            told: Positions and rates of the joints.
        """
        arm = self.arms[index]
        assert arm is not None
        D, V = arm[0].moved(told.position, told.velocity)
        X, rows = D @ view.pose, self.rows
        J = np.array([rows.turn(D, column) for column in view.jacobian.T]).T
        return PayloadKinematics(X, J, rows.select(about(X[:3, 3], V)))
