"""Static torques of drives against their limits, internal force they can bear, and loads without an arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, frozen, typed
from coop_pin.base.spatial import rotate_vector6, shift_wrench, weight_wrench
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.reachability import Reachability, reachability
from coop_pin.model.cell_arm import CellArm
from coop_pin.simulation.simulation import Simulation


class DriveTorque(NamedTuple):
    """Largest static torque of one drive, with the part of each cause.

    Attributes:
        arm: arm name.
        joint: the joint with the same index as the drive.
        time: time of the largest torque, s.
        weight: part for the arm's own weight; the parts have the sign of the torque, a negative one relieves
            the drive.
        load: part for the arm's share of the payload's weight.
        squeeze: part for the desired internal wrench.
        limit: torque at which the drive saturates; infinite if there is none.
        unit: "N m" or "N".
    """

    arm: str
    joint: str
    time: float
    weight: float
    load: float
    squeeze: float
    limit: float
    unit: str

    @property
    def torque(self) -> float:
        """Size of the torque: the sum of its parts."""
        return self.weight + self.load + self.squeeze

    @property
    def ok(self) -> bool:
        """Whether the drive can hold."""
        return self.torque <= self.limit

    def __str__(self) -> str:
        limit = f" of {self.limit:.4g}" if np.isfinite(self.limit) else ""
        weight, load, squeeze = (round(part, 9) + 0.0 for part in (self.weight, self.load, self.squeeze))
        return (
            f"{self.arm}/{self.joint} needs {self.torque:.3g}{limit} {self.unit} to stand still"
            f" at t = {self.time:.4g} s: arm's weight {weight:.3g}, load share {load:.3g},"
            f" squeeze {squeeze:.3g}"
        )


@dataclass(frozen=True, eq=False)
class ArmStatics:
    """Static torques of the drives of one arm along the motion, N m (N at a prismatic joint).

    Attributes:
        arm: arm name.
        joints: names of its joints, in the order of its drives.
        units: units of the torques.
        times: s, shape (n,).
        weight: torque for the arm's own weight, shape (n, k).
        load: torque for its share of the payload's weight, shape (n, k).
        squeeze: torque for its desired internal wrench, shape (n, k).
        limit: torques at which the drives saturate, shape (k,).
    """

    arm: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    times: Array
    weight: Array
    load: Array
    squeeze: Array
    limit: Array

    @property
    def torque(self) -> Array:
        """The whole static torque, shape (n, k)."""
        return self.weight + self.load + self.squeeze

    @property
    def used(self) -> Array:
        """Parts of the limits that weight and load share need, shape (n, k)."""
        return np.abs(self.weight + self.load) / self.limit

    def drives(self) -> tuple[DriveTorque, ...]:
        """Return the largest torque of each drive; none if the arm has no configurations."""
        if not len(self.times):
            return ()
        return tuple(self._largest(k) for k in range(len(self.joints)))

    def _largest(self, k: int) -> DriveTorque:
        torque = self.torque[:, k]
        at = int(np.abs(torque).argmax())
        sign = np.copysign(1.0, torque[at])
        weight, load, squeeze = (float(sign * part[at, k]) for part in (self.weight, self.load, self.squeeze))
        return DriveTorque(
            self.arm,
            self.joints[k],
            float(self.times[at]),
            weight,
            load,
            squeeze,
            float(self.limit[k]),
            self.units[k],
        )


@dataclass(frozen=True, eq=False)
class StaticTorques:
    """Static torques of a cell along its motion.

    Attributes:
        arms: torques in the order of the cell.
    """

    arms: tuple[ArmStatics, ...]

    @property
    def drives(self) -> tuple[DriveTorque, ...]:
        """Largest torque of every drive, in the order of the arms."""
        return tuple(drive for arm in self.arms for drive in arm.drives())

    @property
    def overloaded(self) -> tuple[DriveTorque, ...]:
        """Drives that cannot hold, the one with the largest part of its limit first."""
        return tuple(sorted((drive for drive in self.drives if not drive.ok), key=_relief))

    @property
    def worst(self) -> DriveTorque | None:
        """The drive that needs the largest part of its limit; None if no drive has a limit."""
        limited = [drive for drive in self.drives if np.isfinite(drive.limit)]
        return min(limited, key=_relief, default=None)

    @property
    def ok(self) -> bool:
        """Whether every drive can hold."""
        return not self.overloaded

    def summary(self) -> str:
        """Return the findings as text: every drive that cannot hold, or the one closest to its limit."""
        absent = [arm.arm for arm in self.arms if not len(arm.times)]
        title = "static torques"
        if absent:
            title += f" (without {', '.join(absent)}, which cannot hold the payload at the start)"
        if self.overloaded:
            counts = f"{len(self.overloaded)} of {len(self.drives)} drives cannot hold the cell"
            return "\n".join((f"{title}: {counts}", *(f"  ! {drive}" for drive in self.overloaded)))
        if self.worst is None:
            return f"{title}: no drive has a limit" if self.drives else f"{title}: not computed"
        return f"{title}: every drive can hold the cell; closest to its limit: {self.worst}"


def _relief(drive: DriveTorque) -> float:
    """Return minus the part of its limit that a drive needs; a limit of zero comes first."""
    return -drive.torque / drive.limit if drive.limit else -np.inf


def static_torques(scenario: Scenario, *, poses: int = 401) -> StaticTorques:
    """Return the torques that hold a scenario's cell at rest at every pose of its reference.

    ``tau = g(q) - J^T (c_i m g + f_d_i)``, in drive coordinates: the arm's own weight, its share of the
    payload's weight about P, and its desired internal wrench. These are whole drive torques, whether the
    controller commands them or the robot compensates gravity itself. Acceleration, friction, wrench pulses,
    lost torques and what a controller adds to the squeeze are not considered; changes of the payload's mass
    are.

    Args:
        scenario: scenario that would be run.
        poses: number of poses, as for reachability.

    Raises:
        ArgumentError: fewer than two poses.
        UrdfError, NameNotFoundError, FileReadError: an arm or the motion cannot be built.
    """
    return statics_along(scenario, reachability(scenario, poses=poses))


@typed
def statics_along(scenario: Scenario, cell_reach: Reachability) -> StaticTorques:
    """Return the static torques at the configurations of a scenario's reachability.

    Out of reach these are the nearest ones; an arm that cannot hold the start has none.

    Args:
        scenario: motion, payload and squeeze.
        cell_reach: reachability of the scenario.
    """
    return StaticTorques(tuple(_arm_statics(scenario, arm.arm, arm.times, arm.q) for arm in cell_reach.arms))


@typed
def start_torques(simulation: Simulation) -> StaticTorques:
    """Return the static torques at the configuration of a simulation, without inverse kinematics."""
    q, time = simulation.plant.q, np.array([simulation.time])
    return StaticTorques(
        tuple(
            _arm_statics(simulation.scenario, arm.name, time, q[np.newaxis, arm.q_slice])
            for arm in simulation.slots
        )
    )


def _arm_statics(scenario: Scenario, name: str, times: Array, configurations: Array) -> ArmStatics:
    cell, model = scenario.cell, CellArm(scenario.cell, name)
    index, rows, rest = list(cell.arms).index(name), model.rows, np.zeros(model.nv)
    parts = np.zeros((3, len(times), model.nv))
    links, L = cell.payload.links, None
    if cell.splits_load or links is not None:
        L = cell.loads_within([True] * len(cell.arms))[index]
    for at, (time, q) in enumerate(zip(times, configurations, strict=True)):
        J, X_WP = model.payload_jacobian(q), model.payload_pose(q)
        f_d = rows.turn(X_WP, rows.select(scenario.squeeze.at(float(time), cell.grasps)[index]))
        surroundings = scenario.surroundings_at(float(time))
        model.model.gravity.linear = surroundings.gravity
        F_load = model.share * surroundings.mass * surroundings.gravity
        parts[:, at] = model.nonlinear_effects(q, rest), -J[:3].T @ F_load, -rows.select(J).T @ f_d
        if L is not None:
            X_WP_d = scenario.payload_motion.at(float(time)).X_WP_d  # the joint may have turned in its view
            R, W = X_WP_d[:3, :3], weight_wrench(surroundings.mass, surroundings.gravity)
            f_d = rotate_vector6(R, scenario.squeeze.at(float(time), cell.grasps)[index])
            W_P = rotate_vector6(R.T, W)
            if links is not None:  # events change the mass of the link of P alone
                g_P, added = R.T @ surroundings.gravity, surroundings.mass - cell.payload.mass
                W_P = links.weight(g_P) + weight_wrench(added, g_P)
            F_load = rotate_vector6(R, L @ W_P)
            r = X_WP_d[:3, 3] - X_WP[:3, 3]
            parts[1, at], parts[2, at] = (-J.T @ shift_wrench(F, r) for F in (F_load, f_d))
    weight, load, squeeze = (frozen(part) for part in parts @ model.from_drive)
    joints = model.limits.joints
    units = tuple("N m" if unit == "rad" else "N" for unit in joints.units)
    return ArmStatics(name, tuple(joints.names), units, times, weight, load, squeeze, model.limits.torque)


_NO_LEVER = 1e-12
"""Torque by a newton that counts as none, m."""
_POSES = 9
"""Poses of the motion at which arms are left out."""


@typed
def force_reserve(scenario: Scenario, cell_reach: Reachability) -> float:
    """Return the internal force that no drive is too weak for, whatever its direction, at rest, N.

    Beside weight, load share and squeeze, the least at the poses of the motion; inf without limits.

    Args:
        scenario: arms and payload.
        cell_reach: reachability of the scenario; every arm reaches the whole motion.
    """
    reserve = np.inf
    for reach, arm in zip(cell_reach.arms, statics_along(scenario, cell_reach).arms, strict=True):
        model = CellArm(scenario.cell, reach.arm)
        for q, torque in zip(reach.q, arm.torque, strict=True):
            J = model.rows.select(model.payload_jacobian(q)) @ model.from_drive
            per_newton = np.linalg.norm(J[model.rows.are_linear], axis=0)
            reserve = min(
                reserve, float(np.min((arm.limit - np.abs(torque)) / np.maximum(per_newton, _NO_LEVER)))
            )
    return reserve


@typed
def loads_without_an_arm(scenario: Scenario, cell_reach: Reachability) -> dict[str, tuple[float, float]]:
    """Return for each arm the part of their torque limits that the others need without it, at rest.

    Largest over nine poses of the motion; above 1 no law can hold the payload. By linear programming over
    the wrenches F_i, so that the internal wrench is the best one::

        min t,  |g_i(q) - J_i^T F_i| <= t limit_i for every other arm,  sum_i F_i + F_dead = [m_0 g, 0]

    F_dead = (J^+)^T g(q) of an arm that is limp, and 0 of one that still carries its own weight.

    Args:
        scenario: arms and payload.
        cell_reach: reachability of the scenario; every arm reaches the whole motion.

    Returns:
        By arm the parts with the arm limp, and with it carrying its own weight; 0.0 without limits, inf
        where the others cannot balance the load at all; empty for a single arm.
    """
    if len(cell_reach.arms) < 2:
        return {}
    names, loads = [arm.arm for arm in cell_reach.arms], dict[str, list[tuple[float, float]]]()
    models = [CellArm(scenario.cell, name) for name in names]
    for at in np.linspace(0, len(cell_reach.arms[0].times) - 1, _POSES).astype(int):
        weights, jacobians = [], []
        for arm, model in zip(cell_reach.arms, models, strict=True):
            weights.append(model.nonlinear_effects(arm.q[at], np.zeros(model.nv)))
            jacobians.append(model.payload_jacobian(arm.q[at]))
        surroundings = scenario.surroundings_at(float(cell_reach.arms[0].times[at]))
        W = np.append(surroundings.mass * surroundings.gravity, np.zeros(3))
        for dead, name in enumerate(names):
            F_dead = np.linalg.pinv(jacobians[dead]).T @ weights[dead]
            others = [
                (weights[i] @ model.from_drive, jacobians[i] @ model.from_drive, model.limits.torque)
                for i, model in enumerate(models)
                if i != dead
            ]
            loads.setdefault(name, []).append((_least_part(others, W - F_dead), _least_part(others, W)))
    return {name: tuple(np.max(parts, axis=0).tolist()) for name, parts in loads.items()}


def _least_part(arms: list[tuple[Array, Array, Array]], load: Array) -> float:
    """Return the least t of arms with their g, J and limits, in drive coordinates, under a load, (6,)."""
    if len(arms) == 1:  # its wrench is the load
        g, J, limits = arms[0]
        return float(np.max(np.abs(g - J.T @ load) / limits))
    from scipy.linalg import block_diag  # slow to load
    from scipy.optimize import linprog

    g, limits = (np.concatenate([arm[part] for arm in arms]) for part in (0, 2))
    J, limited = block_diag(*(arm[1] for arm in arms)), np.isfinite(limits)
    A = np.hstack([J.T, limits[:, None]])[limited]  # J^T F + t limit >= g, and likewise for -g
    A, b = np.vstack([-A, A * np.append(np.ones(len(J)), -1.0)]), np.concatenate([-g[limited], g[limited]])
    balance = np.hstack([*(np.eye(6) for _ in arms), np.zeros((6, 1))])
    bounds = [(None, None)] * len(J) + [(0.0, None)]
    solution = linprog(np.eye(len(J) + 1)[-1], A_ub=A, b_ub=b, A_eq=balance, b_eq=load, bounds=bounds)
    return float(solution.fun) if solution.success else np.inf
