"""Keeps what happens at every tick, and hands it over as a result."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coop_pin.arrays import Array
from coop_pin.control.measurement import ArmMeasurement
from coop_pin.description.scenario import Scenario
from coop_pin.reference import PoseTarget
from coop_pin.results import RunResult, RunSamples
from coop_pin.simulation.plant import CHANNELS, Plant
from coop_pin.simulation.timeline import Timeline


class Recorder:
    """Samples a run at its ticks: the state at t_k, and torques and wrenches from t_k on.

    Attributes:
        payload_energy: energy that payload changes have added so far, J.
    """

    def __init__(self, scenario: Scenario, plant: Plant, timeline: Timeline) -> None:
        self._scenario, self._plant = scenario, plant
        self._count = 0
        self.payload_energy = 0.0
        samples, arms = timeline.ticks + 1, plant.chain.tree.arms
        joints = max(len(arm.drive) for arm in arms)
        m, model = len(arms), plant.chain.tree.model
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
        torques: Sequence[Array],
        target: PoseTarget,
        squeeze: Array,
    ) -> None:
        """Keep the sample of one tick; its torques are already held."""
        kept, plant, chain = self._samples, self._plant, self._plant.chain
        kept.time[tick] = time
        kept.configuration[tick], kept.velocity[tick] = plant.q, plant.v
        kept.interaction_wrench[tick] = plant.interaction_wrenches()
        kept.payload_pose[tick] = chain.payload_pose(plant.q)
        kept.payload_twist[tick] = chain.payload_twist(plant.q, plant.v)
        kept.desired_pose[tick], kept.desired_twist[tick], kept.desired_squeeze[tick] = target.X_WP_d, target.V_WP_d, squeeze
        kept.tip_position[tick] = chain.tip_positions(plant.q)
        kept.external_wrench[tick] = plant.external
        kept.closure_error[tick] = chain.gaps(plant.q)
        kept.energy[tick] = chain.chain.energy(plant.q, plant.v)
        kept.work[tick, :-1], kept.work[tick, -1] = plant.work, self.payload_energy
        for index, (measurement, torque) in enumerate(zip(measurements, torques, strict=True)):
            kept.torque[tick, index, : len(torque)] = torque
            kept.drive_velocity[tick, index, : len(torque)] = measurement.v
            kept.jacobian_condition[tick, index] = np.linalg.cond(measurement.payload_jacobian)
        self._count = tick + 1

    def result(self) -> RunResult:
        """Return the result up to the last recorded tick."""
        return RunResult.from_samples(self._scenario, RunSamples(*(array[: self._count] for array in self._samples)))
