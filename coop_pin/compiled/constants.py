"""Numbers of a run: all that its traced code computes with, and signals, which change from tick to tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.spatial.task_rows import TaskRows
from coop_pin.compiled.kind import Cover
from coop_pin.compiled.plant.cell_numbers import CellNumbers
from coop_pin.compiled.plant.serial_arm import Numbers, SerialArm, frames, payload_jacobian
from coop_pin.description.network import ArmClock
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import PayloadKinematics
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.cell_model import ArmPlace
from coop_pin.reference.pose_reference import PoseReference, PoseTarget
from coop_pin.simulation.devices.actuation import Actuation
from coop_pin.simulation.devices.drives import CellDrives, DriveState
from coop_pin.simulation.devices.network import CellNetwork
from coop_pin.simulation.devices.sensing import Sensing
from coop_pin.simulation.devices.sensors import CellSensors
from coop_pin.simulation.devices.torque_response import TorqueResponse
from coop_pin.simulation.devices.wrist import Wrist
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.simulation import Simulation
from coop_pin.simulation.tick import TickSignals
from coop_pin.simulation.timeline import Timeline
from coop_pin.tracing.traced_array import traced


class ArmConstants(NamedTuple):
    """Numbers of one arm besides its dynamics.

    Attributes:
        model: the arm as its own kinematics have it, calibration errors included.
        to_joints: T^-1, shape (k, k).
    """

    model: SerialArm
    to_joints: Numbers

    def view(self, rows: TaskRows, angles: Numbers) -> PayloadKinematics:
        """Return payload pose and Jacobian by the arm's own kinematics.

        Args:
            rows: Task rows of the cell.
            angles: Angles of the joints as measured, shape (n,).
        """
        placed, X_WP = frames(self.model, angles), np.eye(4).astype(object)
        X_WP[:3, :3], X_WP[:3, 3] = placed.R_WP, placed.p_WP
        J = rows.select(payload_jacobian(placed.S, placed.p_WP)).dot(self.to_joints)
        return PayloadKinematics(traced(X_WP), traced(J))


class RunConstants(NamedTuple):
    """Numbers of a run: those that differ between the runs of a batch become inputs of the code, others fold.

    The controller is last, since a plant's numbers are those before it.

    Attributes:
        cell: Dynamics of the cell, in the surroundings of the start: those that the robots' own gravity
            compensation believes.
        arms: Kinematics and transmission of each arm.
        sensors: Sensors of all arms.
        drives: Drives of all arms.
        network: Network between the arms; None without one.
        changes: Those fields of the surroundings that events change: at the start, and from each instant on.
        controller: Controller of all arms.
    """

    cell: CellNumbers
    arms: tuple[ArmConstants, ...]
    sensors: CellSensors
    drives: CellDrives
    network: CellNetwork | None
    changes: tuple[Mapping[str, Any], ...]
    controller: Any

    def view(
        self, angles: Sequence[Numbers], index: int, measured: Numbers | None = None
    ) -> PayloadKinematics:
        """Return payload pose and Jacobian by an arm's own kinematics.

        Args:
            angles: True joint angles of each arm, shape (k,) each.
            index: Index of the arm.
            measured: Measured joint angles of the arm, shape (k,); the true ones when omitted.
        """
        return self.arms[index].view(self.sensors.rows, angles[index] if measured is None else measured)


def covered_constants(
    cover: Cover, needed: RunConstants, scenario: Scenario, timeline: Timeline
) -> RunConstants:
    """Return the numbers of a run with what the code provides besides."""
    sensors, drives = needed.sensors, needed.drives
    if sensors.wrists and cover.delay:
        delays = [len(wrist.late) for wrist in sensors.wrists]
        arms = tuple(
            arm._replace(delays=np.eye(cover.delay + 1)[delay])
            for arm, delay in zip(sensors.arms, delays, strict=True)
        )
        sensors = sensors._replace(arms=arms, wrists=(Wrist.at_rest(cover.delay),) * len(arms))
    if cover.responds and drives.response is None:
        size = sum(len(arm.limit) for arm in drives.arms)
        drives = drives._replace(response=TorqueResponse.of_drives(np.zeros(size), np.full(size, np.inf)))
    return needed._replace(sensors=sensors, drives=drives, changes=changes(scenario, timeline, cover))


def covered_drives(needed: DriveState, constants: RunConstants) -> DriveState:
    """Return the memory of the drives at the start with what the code of the constants provides besides."""
    response = constants.drives.response
    if response is None or needed.response is not None:
        return needed
    return needed._replace(response=response.start(np.zeros(constants.cell.joints)))  # lag alone reads it


def run_constants(scenario: Scenario, run: Simulation) -> RunConstants:
    """Return the numbers of a run.

    Args:
        scenario: Scenario that is run.
        run: Simulation of this scenario.

    Raises:
        TracingError: an arm is no serial chain.
    """
    return RunConstants(
        cell=CellNumbers.from_chain(run.chain),
        arms=tuple(map(arm_constants, run.chain.arms)),
        sensors=run.sensing.sensors,
        drives=run.actuation.drives,
        network=run.exchange.network,
        changes=changes(scenario, run.timeline),
        controller=run.controller,
    )


@lru_cache(64)
def arm_constants(arm: CellArm) -> ArmConstants:
    """Return the numbers of an arm of a chain.

    Raises:
        TracingError: the arm is no serial chain.
    """
    model = arm.kinematics.model
    X_JP = model.frames[model.getFrameId("payload")].placement
    return ArmConstants(
        model=SerialArm.from_model(model, range(1, model.njoints), X_JP, pin.Inertia.Zero()),
        to_joints=arm.from_drive,
    )


def changes(scenario: Scenario, timeline: Timeline, cover: Cover | None = None) -> tuple[dict[str, Any], ...]:
    """Return the fields of the surroundings that events change, at the start and from each event time on.

    They depend on the kinds of the events, not on their numbers: a new mass may equal the old one.

    Args:
        scenario: Scenario with its events.
        timeline: Timeline of its run.
        cover: Fields and instants that the code provides; those of the scenario when None.
    """
    cover = cover or Cover.of(scenario)
    later = [scenario.surroundings_at(timeline.just_after(time)) for time in timeline.event_times()]
    present = [scenario.cell.surroundings, *later]
    present += present[-1:] * (cover.instants - len(later))  # instants that never come
    return tuple(
        {name: value for name, value in each._asdict().items() if name in cover.changed} for each in present
    )


def start(
    plant: Plant, slots: Sequence[ArmPlace], actuation: Actuation, sensing: Sensing
) -> dict[str, Array]:
    """Return what a run starts from, by name.

    ``q``, joint positions of all arms, of continuous joints near the posture, then position and quaternion of
    a free payload, shape (N,) or (N + 7,); ``holding``, the torques that the drives report, N m, shape (N,).
    """
    q = plant.q
    angles = [arm.angles.near(q[arm.q_slice], arm.posture) for arm in slots]
    holding = np.concatenate(actuation.holding_commands(q)) * np.concatenate(sensing.holding_factors)
    return {"q": np.concatenate((*angles, q[slots[-1].q_slice.stop :])), "holding": holding}


class Desired(NamedTuple):
    """Desired motion and squeeze at n ticks, or without the first axis at one.

    Attributes:
        time: t_k, s, shape (n,).
        target: desired motion, shape (n, 4, 4), (n, 6) and (n, 6).
        squeeze: f_d of each arm in payload axes, shape (n, m, 6).
    """

    time: Array
    target: PoseTarget
    squeeze: Array


class RunSignals(NamedTuple):
    """Signals of a run at n ticks, or without the first axis at one.

    Attributes:
        desired: desired motion and squeeze.
        drawn: signals of sensors, drives and messages.
        clocked: desired motion of each arm by its own clock, empty where that is exact; empty if all are.
    """

    desired: Desired
    drawn: TickSignals
    clocked: tuple[Desired | tuple[()], ...] = ()


class DesiredSource(NamedTuple):
    """Source of the desired motion and squeeze of a run.

    Attributes:
        scenario: scenario of the run.
        motion: the desired motion.
        timeline: timeline of the run.
    """

    scenario: Scenario
    motion: PoseReference
    timeline: Timeline

    def desired(self, ticks: range, clock: ArmClock | None = None) -> Desired:
        """Return desired motion and squeeze at ticks, or at what a clock shows then.

        Targets are copied one by one: thousands that live at once would be searched for garbage.
        """
        times = list(map(self.timeline.time, ticks))
        times = times if clock is None else list(map(clock.reading, times))
        X, V, A = target = PoseTarget(*(np.empty((len(times), *shape)) for shape in ((4, 4), (6,), (6,))))
        for index, time in enumerate(times):
            X[index], V[index], A[index] = self.motion.at(time)
        return self.squeezed(Desired(np.array(times), target, np.empty(0)))

    def squeezed(self, desired: Desired) -> Desired:
        """Return the same desired motion with the squeeze of the run."""
        squeeze, grasps = self.scenario.squeeze, self.scenario.cell.grasps
        return desired._replace(
            squeeze=np.array([squeeze.at(time, grasps) for time in desired.time.tolist()])
        )

    def clocked(self, ticks: range) -> tuple[Desired | tuple[()], ...]:
        """Return what each arm desires by its own clock at ticks, as in RunSignals."""
        clocks = self.scenario.clocks
        if not clocks:
            return ()
        arms = range(len(self.scenario.cell.arms))
        return tuple(self.desired(ticks, clocks[index]) if index in clocks else () for index in arms)


def columns(signals: RunSignals) -> Array:
    """Return signals as one array, in the order of the leaves of those of a tick, shape (n, entries)."""
    parts = list[Array]()
    _mapped(parts.append, signals)
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)


def first_of(signals: RunSignals) -> RunSignals:
    """Return the signals of the first tick."""
    return _mapped(lambda part: part[0], signals)


def _mapped(function: Callable[[Any], Any], tree: Any) -> Any:
    """Return a tree of tuples with a function applied to each of its arrays."""
    if not isinstance(tree, tuple):
        return function(tree)
    parts = [_mapped(function, part) for part in tree]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
