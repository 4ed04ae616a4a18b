"""Record of arms that held a payload: joints and wrists by arm, each with its own clock; a run is one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.base.arrays import Array, require_path, require_type
from coop_pin.base.errors import ArgumentError, FileReadError
from coop_pin.base.spatial import quaternions, rotations
from coop_pin.description.cell.grasp import CompliantGrasp
from coop_pin.description.log_table import SECONDS
from coop_pin.description.scenario import Scenario
from coop_pin.logs.csv_log import read_csv
from coop_pin.logs.mcap_log import read_mcap
from coop_pin.logs.topics import FIELDS, Topic, table_of
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.joint_limits import JointLimits
from coop_pin.results.run_result import RunResult


@dataclass(frozen=True, eq=False)
class ArmRecord:
    """Record of one arm.

    Attributes:
        time: stamps of the joint states by the arm's own clock, s, shape (n,).
        position: joint positions, rad or m, shape (n, nv).
        velocity: joint velocities, rad/s or m/s, shape (n, nv); NaN where they are not logged.
        effort: joint torques, N m, shape (n, nv); NaN likewise.
        wrench_time: stamps of the wrenches, s, shape (w,).
        wrench: wrench on the arm by the payload in axes and origin of the tip, N and N m, shape (w, 6).
    """

    time: Array
    position: Array
    velocity: Array
    effort: Array
    wrench_time: Array
    wrench: Array

    def free_wrench(self, free: tuple[float, float] | None) -> Array:
        """Return the wrenches of an interval with free hands, none without one, shape (k, 6)."""
        start, end = free or (0.0, 0.0)
        return self.wrench[(self.wrench_time >= start) & (self.wrench_time < end)]


@dataclass(frozen=True, eq=False)
class Record:
    """Record of all arms.

    Attributes:
        arms: records of the arms by name, in the order of the cell.
        desired_time: stamps of the desired poses, s, shape (d,); empty where they are not logged.
        desired: desired poses X_WP_d, shape (d, 4, 4).
        free: interval in which the hands were free, s; None without one.
    """

    arms: Mapping[str, ArmRecord]
    desired_time: Array
    desired: Array
    free: tuple[float, float] | None = None

    @property
    def span(self) -> tuple[float, float]:
        """First and last time at which every arm has samples, s."""
        stamps = [arm.time for arm in self.arms.values()]
        return max(float(time[0]) for time in stamps), min(float(time[-1]) for time in stamps)

    @property
    def held_span(self) -> tuple[float, float]:
        """First and last time at which every arm has samples and holds the payload, s."""
        start, end = self.span
        return (start if self.free is None else max(start, self.free[1])), end

    @classmethod
    def of_run(cls, result: RunResult) -> Self:
        """Return what the arms of a run would log: what their encoders and wrists read, and the torques.

        Where a run has no sensors, its true positions and wrenches. A wrist reads in axes of its tip, and the
        run has its reading turned to the world by the arm's own view, which is off where its model is. Rows
        of wrenches that rigid bodies do not determine count as zero.

        Args:
            result: run, finished or not.
        """
        require_type("result", result, RunResult)
        data, scenario, arms = result.data, result.scenario, {}
        time = data.time.values
        X_WP = poses_of(data.payload_position.values, data.payload_quaternion.values)
        for name in scenario.cell.arms:
            arm, of_arm = CellArm(scenario.cell, name), data.sel(arm=name)
            n, T = arm.nv, arm.drive
            q, v = of_arm.joint_position.values[:, :n], of_arm.joint_velocity.values[:, :n]
            if "measured_drive_position" in of_arm:
                q = of_arm.measured_drive_position.values[:, :n] @ arm.from_drive.T
                v = of_arm.measured_drive_velocity.values[:, :n] @ arm.from_drive.T
            has_wrist = scenario.sensors_of(name).wrist is not None
            F = np.nan_to_num((of_arm.measured_wrench if has_wrist else of_arm.interaction_wrench).values)
            view = arm.kinematics.view
            sees = has_wrist and not scenario.cell.jointed and not scenario.cell.shared_joints
            seen = np.array([view(arm.configuration(each)).pose for each in q]) if sees else X_WP
            X_PE = arm.X_PE
            if isinstance(scenario.cell.grasps[name], CompliantGrasp):  # the wrist is behind the spring
                off = np.nan_to_num(of_arm.grasp_deflection.values)
                X_PE = X_PE @ poses_of(off[:, :3], Rotation.from_rotvec(off[:, 3:]).as_quat())
            wrench = at_tip(F, seen, X_PE)
            arms[name] = ArmRecord(time, q, v, of_arm.torque.values[:, :n] @ T, time, wrench)
        return cls(arms, time, poses_of(data.desired_position.values, data.desired_quaternion.values))

    @classmethod
    def load(cls, path: str | Path, scenario: Scenario) -> Self:
        """Read a log: ``.csv``, ``.mcap``, or a result of coop_pin.

        Times begin at zero with the first joint state of any arm.

        Args:
            path: the file.
            scenario: cell whose arms were logged; its ``log`` names the topics.

        Raises:
            FileReadError: the file is missing or damaged, or has no such topic or joint.
            ArgumentError: a CSV or MCAP file is read without a table ``log``.
            MissingExtraError: MCAP without the extra 'logs'.
        """
        require_path("path", path)
        require_type("scenario", scenario, Scenario)
        file, log = Path(path), scenario.log
        if file.suffix not in (".csv", ".mcap"):
            return cls.of_run(RunResult.load(file))
        if not file.is_file():
            raise FileReadError("there is no such file", str(file))
        if log is None:
            raise ArgumentError(f"{scenario.name!r} has no table [log], which says which topic is which arm")
        named = [topic for arm in log.arms.values() for topic in (arm.joints, arm.wrench)] + [log.desired]
        named = [topic for topic in named if topic]
        topics = read_csv(file, named, SECONDS[log.time]) if file.suffix == ".csv" else read_mcap(file, named)
        if missing := [topic for topic in named if topic not in topics]:
            known = f"; it has {', '.join(sorted(topics))}" if topics else ""
            raise FileReadError(f"has no topic {missing[0]!r}, which the table log names{known}", str(file))
        return cls.of_topics(topics, scenario, file)

    @classmethod
    def of_topics(cls, topics: Mapping[str, Topic], scenario: Scenario, file: Path) -> Self:
        """Return the record of topics as read, in SI units and in the order of the joints.

        Args:
            topics: topics by name.
            scenario: cell and table ``log``.
            file: file that has them, for messages.

        Raises:
            FileReadError: a joint is missing, or a number.
        """
        for name, topic in topics.items():
            topic.require_numbers(name, file)
        log, arms = table_of(scenario), {}
        zero = min(float(topics[arm.joints].time[0]) for arm in log.arms.values())
        for name in scenario.cell.arms:
            stated, limits = log.arms[name], JointLimits(scenario.cell.arms[name], name)
            joints, wrist = topics[stated.joints], topics.get(stated.wrench)
            order = _order(joints.joints, limits.joints.names, f"{file}, {stated.joints}")
            degrees = (np.array(limits.joints.units) == "rad") & (log.angle == "deg")
            none = np.full((len(joints.time), len(joints.joints)), np.nan)
            q, v, tau = (joints.values.get(part, none)[:, order] for part in FIELDS["JointState"])
            scale = np.where(degrees, np.pi / 180.0, 1.0)
            time, wrench = np.empty(0), np.empty((0, 6))
            if wrist is not None:
                time = wrist.time - zero
                wrench = stated.wrench_sign * np.hstack(
                    [wrist.values[part] for part in FIELDS["WrenchStamped"]]
                )
            arms[name] = ArmRecord(joints.time - zero, q * scale, v * scale, tau, time, wrench)
        desired, X_d = np.empty(0), np.empty((0, 4, 4))
        if log.desired:
            poses = topics[log.desired]
            desired, X_d = poses.time - zero, poses_of(poses.values["position"], poses.values["orientation"])
        return cls(arms, desired, X_d, log.free)

    def topics(self, scenario: Scenario) -> dict[str, Topic]:
        """Return the record as topics of ROS, by the names and signs of the table ``log`` of a scenario.

        Args:
            scenario: cell with the names of arms and joints.
        """
        log, topics = table_of(scenario), dict[str, Topic]()
        for name, arm in self.arms.items():
            stated, names = log.arms[name], JointLimits(scenario.cell.arms[name], name).joints.names
            parts = dict(zip(FIELDS["JointState"], (arm.position, arm.velocity, arm.effort), strict=True))
            known = {part: values for part, values in parts.items() if np.isfinite(values).all()}
            topics[stated.joints] = Topic("JointState", arm.time, known, names, name)
            if stated.wrench and len(arm.wrench_time):
                force, torque = np.hsplit(stated.wrench_sign * arm.wrench, 2)
                wrench = {"force": force, "torque": torque}
                topics[stated.wrench] = Topic("WrenchStamped", arm.wrench_time, wrench, frame=f"{name}/tip")
        if log.desired and len(self.desired_time):
            pose = {"position": self.desired[:, :3, 3], "orientation": quaternions(self.desired[:, :3, :3])}
            topics[log.desired] = Topic("PoseStamped", self.desired_time, pose)
        return topics


def _order(logged: tuple[str, ...], joints: tuple[str, ...], source: str) -> list[int]:
    """Return where the joints of an arm stand in a message; without any of their names by their number."""
    names = [name.removeprefix("arm/") for name in joints]
    missing = [name for name in names if name not in logged]
    if not missing:
        return [logged.index(name) for name in names]
    if len(missing) == len(names) == len(logged):
        return [*range(len(names))]
    raise FileReadError(f"has no joint {missing[0]!r}; it has {', '.join(logged)}", source)


def poses_of(position: Array, orientation: Array) -> Array:
    """Return poses of positions and quaternions x, y, z, w, shape (n, 4, 4)."""
    X = np.tile(np.eye(4), (len(position), 1, 1))
    X[:, :3, :3], X[:, :3, 3] = rotations(orientation), position
    return X


def at_tip(F_P: Array, X_WP: Array, X_PE: Array) -> Array:
    """Return wrenches about P in world axes as wrenches about the tip in its axes, shape (n, 6).

    Args:
        F_P: wrenches, shape (n, 6).
        X_WP: poses of the payload, shape (n, 4, 4).
        X_PE: pose of the tip in the payload frame, shape (4, 4) or (n, 4, 4).
    """
    X_PE = np.broadcast_to(X_PE, X_WP.shape)
    R = X_WP[:, :3, :3] @ X_PE[:, :3, :3]
    lever = (X_WP[:, :3, :3] @ X_PE[:, :3, 3:])[..., 0]
    moment = F_P[:, 3:] - np.cross(lever, F_P[:, :3])
    return np.hstack((np.einsum("nji,nj->ni", R, F_P[:, :3]), np.einsum("nji,nj->ni", R, moment)))
