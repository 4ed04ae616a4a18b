"""Recorder of the quantities of a run at every tick."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coop_pin.arrays import Array, frozen
from coop_pin.chain.cell_chain import determinate_rows
from coop_pin.control.interface import ArmMeasurement
from coop_pin.description.scenario import Scenario
from coop_pin.model.joint_limits import JointLimits
from coop_pin.reference import PoseTarget
from coop_pin.results import RunResult, Snapshot
from coop_pin.results.dataset import Samples, allocate, computed, dataset
from coop_pin.results.trust import Breach, TrustMonitor
from coop_pin.simulation.actuation import Applied
from coop_pin.simulation.plant import CHANNELS, Plant
from coop_pin.simulation.timeline import Timeline


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
        count, arms, model = timeline.ticks + 1, plant.chain.model.arms, plant.chain.mechanism.model
        joints = max(len(arm.drive) for arm in arms)
        sizes = {"q": model.nq, "v": model.nv, "arm": len(arms), "joint": joints}
        self._samples = allocate(count, sizes)
        self._jacobians = [np.zeros((count, scenario.cell.task_rows.size, len(arm.drive))) for arm in arms]
        self._monitor = TrustMonitor(scenario.trust, timeline.period, self._joints, *self._limit_table()[:2])

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
        seen, work = plant.observe(), (*plant.work, self.payload_energy)
        distances, angles = zip(*seen.closure_errors, strict=True)
        for name, value in {
            "time": time,
            "configuration": plant.q,
            "velocity": plant.v,
            "payload_pose": seen.payload_pose,
            "payload_twist": seen.payload_twist,
            "desired_pose": target.X_WP_d,
            "desired_twist": target.V_WP_d,
            "desired_squeeze": squeeze,
            "tip_position": seen.tip_positions,
            "interaction_wrench": np.where(self._determined, seen.interaction_wrenches, np.nan),
            "external_wrench": plant.external,
            "closure_distance": distances,
            "closure_angle": angles,
            "kinetic_energy": seen.energy.kinetic,
            "potential_energy": seen.energy.potential,
            **{f"work_{c}": done for c, done in zip((*CHANNELS, "payload_change"), work, strict=True)},
        }.items():
            kept[name][tick] = value
        for index, measurement in enumerate(measurements):
            drives = len(measurement.v)
            kept["torque"][tick, index, :drives] = applied.torques[index]
            kept["commanded_torque"][tick, index, :drives] = applied.commanded[index]
            kept["saturated"][tick, index, :drives] = applied.saturated[index]
            kept["drive_velocity"][tick, index, :drives] = measurement.v
            self._jacobians[index][tick] = measurement.payload_jacobian
        self.count = tick + 1

    def snapshot(self) -> Snapshot:
        """Return the sample of the last recorded tick."""
        last = slice(self.count - 1, self.count)
        samples = {name: values[last] for name, values in self._samples.items()}
        samples["jacobian_condition"] = np.array([[np.linalg.cond(J[last])[0] for J in self._jacobians]])
        values = computed(samples, self._cell.shares, Snapshot._fields)
        arrays = {name: frozen(values[name][0]) for name in Snapshot._fields if name != "time"}
        return Snapshot(time=float(values["time"][0]), **arrays)

    def result(self, scenario: Scenario) -> RunResult:
        """Return the result up to the last recorded tick.

        Args:
            scenario: what was run.
        """
        kept, names = self._filled(slice(0, self.count)), [joints for _, joints in self._joints]
        return RunResult(scenario, dataset(scenario, kept, names, self._limit_table()))

    def breaches(self) -> tuple[Breach, ...]:
        """Return the breaches of the trust thresholds at the last recorded tick; call it at every tick."""
        return self._monitor.breaches(self._filled(slice(self.count - 1, self.count)))

    @property
    def _joints(self) -> list[tuple[str, list[str]]]:
        return [(arm.name, list(arm.joint_names)) for arm in self._plant.chain.model.arms]

    def _filled(self, ticks: slice) -> Samples:
        """Return the samples of some ticks, with what needs no record of its own filled in."""
        kept = {name: values[ticks] for name, values in self._samples.items()}
        for index, place in enumerate(self._plant.chain.model.arms):
            kept["jacobian_condition"][:, index] = np.linalg.cond(self._jacobians[index][ticks])
            posture, joints = self._cell.arms[place.name].posture, len(place.drive)
            start = np.zeros(joints) if posture is None else np.array(posture)
            angles = place.angles.along(kept["configuration"][:, place.q_slice], start)
            kept["joint_position"][:, index, :joints] = angles
            kept["joint_velocity"][:, index, :joints] = kept["velocity"][:, place.v_slice]
        return kept

    def _limit_table(self) -> Array:
        """Return the four limits of each arm's joints, shape (4, m, k); NaN where there is none."""
        table = np.full((4, *self._samples["torque"].shape[1:]), np.nan)
        for index, limits in enumerate(self._limits):
            columns = (limits.lower, limits.upper, limits.velocity, limits.torque)
            for row, values in zip(table, columns, strict=True):
                row[index, : len(values)] = np.where(np.isfinite(values), values, np.nan)
        return table
