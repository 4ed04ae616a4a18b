"""Recorder: the samples of a run at its ticks, and the result made of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coop_pin.arrays import Array, frozen
from coop_pin.chain.cell_chain import determinate_rows
from coop_pin.control.interface import ArmMeasurement
from coop_pin.description.scenario import Scenario
from coop_pin.model.joint_limits import JointLimits
from coop_pin.reference import PoseTarget
from coop_pin.results import LimitTable, RunResult, RunSamples, Snapshot
from coop_pin.simulation.actuation import Applied
from coop_pin.simulation.plant import CHANNELS, Plant
from coop_pin.simulation.timeline import Timeline
from coop_pin.spatial import internal_wrenches, rotate_vector6


class Recorder:
    """Samples of a run at its ticks: the state at t_k, and torques and wrenches from t_k on.

    Attributes:
        count: ticks recorded so far.
        payload_energy: energy that payload changes have added so far, J.
    """

    def __init__(
        self, scenario: Scenario, plant: Plant, timeline: Timeline, limits: Sequence[JointLimits]
    ) -> None:
        self._cell, self._plant, self._limits = scenario.cell, plant, limits
        self.count = 0
        self.payload_energy = 0.0
        self._determined = determinate_rows(plant.chain, plant.q)
        samples, arms = timeline.ticks + 1, plant.chain.model.arms
        joints = max(len(arm.drive) for arm in arms)
        m, model = len(arms), plant.chain.mechanism.model
        self._jacobians = [np.zeros((samples, scenario.cell.task_rows.size, len(arm.drive))) for arm in arms]
        self._samples = RunSamples(
            time=np.zeros(samples),
            configuration=np.zeros((samples, model.nq)),
            velocity=np.zeros((samples, model.nv)),
            payload_pose=np.zeros((samples, 4, 4)),
            payload_twist=np.zeros((samples, 6)),
            desired_pose=np.zeros((samples, 4, 4)),
            desired_twist=np.zeros((samples, 6)),
            desired_squeeze=np.zeros((samples, m, 6)),
            tip_position=np.zeros((samples, m, 3)),
            drive_velocity=np.full((samples, m, joints), np.nan),
            torque=np.full((samples, m, joints), np.nan),
            commanded_torque=np.full((samples, m, joints), np.nan),
            saturated=np.zeros((samples, m, joints), dtype=bool),
            joint_position=np.full((samples, m, joints), np.nan),
            joint_velocity=np.full((samples, m, joints), np.nan),
            interaction_wrench=np.zeros((samples, m, 6)),
            external_wrench=np.zeros((samples, 6)),
            closure_error=np.zeros((samples, m, 2)),
            jacobian_condition=np.zeros((samples, m)),
            energy=np.zeros((samples, 2)),
            work=np.zeros((samples, len(CHANNELS) + 1)),
        )

    def record(
        self,
        tick: int,
        time: float,
        measurements: Sequence[ArmMeasurement],
        applied: Applied,
        target: PoseTarget,
        squeeze: Array,
    ) -> None:
        """Record one tick; the plant already holds its torques."""
        kept, plant = self._samples, self._plant
        kept.time[tick] = time
        kept.configuration[tick], kept.velocity[tick] = plant.q, plant.v
        seen = plant.observe()
        kept.payload_pose[tick], kept.payload_twist[tick] = seen.payload_pose, seen.payload_twist
        kept.tip_position[tick], kept.closure_error[tick] = seen.tip_positions, seen.closure_errors
        kept.interaction_wrench[tick] = seen.interaction_wrenches
        kept.desired_pose[tick], kept.desired_twist[tick], kept.desired_squeeze[tick] = (
            target.X_WP_d,
            target.V_WP_d,
            squeeze,
        )
        kept.external_wrench[tick] = plant.external
        kept.energy[tick] = seen.energy
        kept.work[tick, :-1], kept.work[tick, -1] = plant.work, self.payload_energy
        for index, measurement in enumerate(measurements):
            drives = len(measurement.v)
            kept.torque[tick, index, :drives] = applied.torques[index]
            kept.commanded_torque[tick, index, :drives] = applied.commanded[index]
            kept.saturated[tick, index, :drives] = applied.saturated[index]
            kept.drive_velocity[tick, index, :drives] = measurement.v
            self._jacobians[index][tick] = measurement.payload_jacobian
        self.count = tick + 1

    def snapshot(self) -> Snapshot:
        """Return the sample of the last recorded tick."""
        kept, last = self._samples, self.count - 1
        interaction, pose = (
            np.where(self._determined, kept.interaction_wrench[last], np.nan),
            kept.payload_pose[last],
        )
        return Snapshot(
            time=float(kept.time[last]),
            configuration=frozen(kept.configuration[last]),
            payload_pose=frozen(pose),
            desired_pose=frozen(kept.desired_pose[last]),
            tip_position=frozen(kept.tip_position[last]),
            interaction_wrench=frozen(interaction),
            internal_wrench=frozen(internal_wrenches(interaction, self._cell.shares)),
            desired_internal_wrench=frozen(rotate_vector6(pose[:3, :3], kept.desired_squeeze[last])),
            external_wrench=frozen(kept.external_wrench[last]),
            torque=frozen(kept.torque[last]),
            saturated=frozen(kept.saturated[last]),
            jacobian_condition=frozen(
                np.array([np.linalg.cond(jacobians[last]) for jacobians in self._jacobians])
            ),
        )

    def result(self, scenario: Scenario) -> RunResult:
        """Return the result up to the last recorded tick.

        Args:
            scenario: what was run.
        """
        kept, cell = self._samples.first(self.count), self._cell
        kept.interaction_wrench[..., ~self._determined] = np.nan
        for index, (place, jacobians) in enumerate(
            zip(self._plant.chain.model.arms, self._jacobians, strict=True)
        ):
            kept.jacobian_condition[:, index] = np.linalg.cond(jacobians[: self.count])
            posture, joints = cell.arms[place.name].posture, len(place.drive)
            start = np.zeros(joints) if posture is None else np.array(posture)
            kept.joint_position[:, index, :joints] = place.angles.along(
                kept.configuration[:, place.q_slice], start
            )
            kept.joint_velocity[:, index, :joints] = kept.velocity[:, place.v_slice]
        return RunResult.from_samples(scenario, kept, self._limit_table(kept.torque.shape[2]))

    def _limit_table(self, joints: int) -> LimitTable:
        """Return the limits with one row for each arm, NaN where there is none."""
        tables = np.full((4, len(self._limits), joints), np.nan)
        for index, limits in enumerate(self._limits):
            columns = (limits.lower, limits.upper, limits.velocity, limits.torque)
            for table, values in zip(tables, columns, strict=True):
                table[index, : len(values)] = np.where(np.isfinite(values), values, np.nan)
        names = tuple(arm.joint_names for arm in self._plant.chain.model.arms)
        return LimitTable(names, *tables)
