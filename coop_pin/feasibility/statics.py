"""Static torques of drives against their limits."""

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
