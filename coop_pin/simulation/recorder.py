"""Recorder of the quantities of a run at every tick."""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array, Mask, frozen
from coop_pin.base.errors import CoopPinError, InvalidStateError, NotEnoughMemoryError
from coop_pin.base.memory import free_memory
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.joint_limits import JointLimits, limit_table
from coop_pin.results.breaches import Breach
from coop_pin.results.quantities import quantities
from coop_pin.results.quantity import Quantity, Samples, allocate, bytes_per_sample, computed
from coop_pin.results.run_result import RunResult
from coop_pin.results.running_metrics import RunningMetrics
from coop_pin.results.snapshot import Snapshot
from coop_pin.results.trust import TrustMonitor
from coop_pin.simulation.devices.drives import Applied
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.tick import TickInputs
from coop_pin.simulation.timeline import Timeline

_BLOCK = 1024
"""Samples that are observed together, and ticks of a thinned run that are held together, at most."""
_FREE_PART = 0.8
"""Part of the free memory that a run should take, in the advice to one that does not fit."""
_WATCHED = ("joint_position", "jacobian_condition")
"""Computed quantities that a TrustMonitor reads."""


class RecordState(NamedTuple):
    """Samples of a run so far.

    Attributes:
        size: number of samples.
        thinned: number of the first ones that are every n-th; the others are of all ticks after them.
        held_from: tick of the first of these.
        observed: samples of which the observation is worked out.
        samples: copies of the samples of every quantity.
        angles: angles of each arm at the last sample, full turns counted, rad, shape (k,) each.
        monitor: search for breaches.
        running: metrics of the ticks that were thinned.
    """

    size: int
    thinned: int
    held_from: int
    observed: int
    samples: list[NDArray[Any]]
    angles: list[Array]
    monitor: TrustMonitor
    running: RunningMetrics | None


class Recorder:
    """Samples of a run at its ticks: the state at t_k, and torques and wrenches from t_k on.

    If ``Clock.record_every``, n, is above 1, the newest ticks are held, at most 1024 of them. Before others
    come, they are added to the running metrics, and those whose number n divides stay, as does the last tick.

    Attributes:
        scenario: scenario with the events added so far.
        count: number of samples, the newest tick's included.
        table: quantities of the run.
        memory: memory that a finished run and its file take, bytes.
        determined: rows of the interaction wrenches that are determinate; see RigidGrasps.
    """

    def __init__(
        self,
        scenario: Scenario,
        plant: Plant,
        timeline: Timeline,
        slots: Sequence[ArmPlace],
        limits: Sequence[JointLimits],
        determined: Mask,
    ) -> None:
        """Begin without samples; limits of each arm, and determined as the attribute, shape (6,)."""
        self.scenario, self._cell, self._plant, self._arms = scenario, scenario.cell, plant, slots
        self.determined = determined
        self.count, self._thinned, self._held_from, self._observed = 0, 0, 0, 0
        self.table, self._every = quantities(scenario), scenario.clock.record_every
        joints, rows = max(len(arm.drive) for arm in slots), scenario.cell.task_rows.size
        self._limits = limit_table(limits, joints)
        self._length = timeline.ticks // self._every + 1 + (_BLOCK if self._every > 1 else 0)
        nq, nv, patches = len(plant.q), len(plant.v), len(scenario.cell.patches) + len(scenario.cell.tables)
        self._sizes = {"q": nq, "v": nv, "arm": len(slots), "joint": joints, "patch": patches}
        links = scenario.cell.payload.links
        self._sizes |= {"shared": len(scenario.cell.driven), "base": len(scenario.cell.wheels)}
        self._sizes["payload_joint"] = 0 if links is None else len(links.start)
        self._block = 1 if patches else _BLOCK  # the plant remembers no bristles of earlier samples
        size = bytes_per_sample(self.table, self._sizes) + 8 * (rows + 1) * nv
        self.memory = float(self._length * size)
        if self.memory > (free := free_memory()):
            fits = math.ceil(self._every * self.memory / max(1.0, _FREE_PART * free))
            remedy = f"raise clock.record_every to {fits:.3g} or more, or lower duration or clock.rate_hz"
            samples = f"{self._length} samples of {scenario.name!r}"
            raise NotEnoughMemoryError(samples, self.memory, free, remedy)
        self._samples: Samples = {}  # allocated for the first tick: a run as one lane of a batch has none
        self._is_shared = False
        self._running = RunningMetrics(scenario, self.labels()) if self._every > 1 else None
        self._angles = [arm.posture for arm in slots]
        self._monitor = TrustMonitor(scenario.trust, self.joints, *self._limits[:2])

    def _allocate(self) -> None:
        """Replace the samples by empty ones, which nothing that was handed out shares."""
        count, plant, arms = self._length, self._plant, self._arms
        self._samples, self._is_shared = allocate(self.table, count, self._sizes), False
        self._work = np.full((count, len(plant.work)), np.nan)
        self._samples |= zip(plant.works, self._work.T, strict=True)
        self._read = [(each.read, *self._columns(each)) for each in self.table if each.read]
        rows = self._cell.task_rows.size
        self._jacobians = [np.zeros((count, rows, len(arm.drive))) for arm in arms]
        turning = [index for index, arm in enumerate(arms) if not arm.angles.is_vector]
        self._turned = {index: np.zeros((count, len(arms[index].drive))) for index in turning}
        self._forces = np.zeros((count, self._sizes["v"]))

    def record(
        self, time: float, inputs: TickInputs, applied: Applied, shares: Array, split: Array | None = None
    ) -> None:
        """Record one tick; the plant already holds its torques.

        Args:
            time: Time of the tick, s.
            inputs: Inputs of the controller.
            applied: Torques of the drives.
            shares: Load share of each arm, shape (m,).
            split: L_i of each arm beside joints, shape (m, 6, 6).
        """
        if self._running is not None and self.count - self._thinned == _BLOCK:
            self._thin(self._running)
        if not self._samples:
            self._allocate()
        samples, plant, sample = self._samples, self._plant, self.count
        measurements, references, target, squeeze, _ = inputs
        distances, angles = zip(*plant.closure_errors(), strict=True)
        for name, value in {
            "time": time,
            "configuration": plant.q,
            "velocity": plant.v,
            "desired_pose": target.X_WP_d,
            "desired_twist": target.V_WP_d,
            "desired_squeeze": squeeze,
            "closure_distance": distances,
            "closure_angle": angles,
        }.items():
            samples[name][sample] = value
        if "desired_tip_pose" in samples:
            grasps = zip(references, self._cell.grasps.values(), strict=True)
            samples["desired_tip_pose"][sample] = [one.pose @ grasp.matrix for one, grasp in grasps]
        if "load_share" in samples:
            samples["load_share"][sample] = shares
        if "load_split" in samples:
            samples["load_split"][sample] = split
        for read, columns, entries in self._read:
            at = sample if entries is None else (sample, entries)
            for column, value in zip(columns, read(measurements, applied), strict=True):
                if value is not None:
                    column[at] = value
        for jacobians, measurement in zip(self._jacobians, measurements, strict=True):
            jacobians[sample] = measurement.payload_jacobian
        for index, turned in self._turned.items():
            # Full turns are counted at every tick: between kept samples a joint may make several.
            arm = self._arms[index]
            along = arm.angles.along(plant.q[None, arm.q_slice], self._angles[index])
            turned[sample] = self._angles[index] = along[0]
        self._work[sample], self._forces[sample] = plant.work, plant.force
        self.count = sample + 1
        if self.count - self._observed == self._block:
            self.observe()

    def state(self) -> RecordState:
        """Return the samples so far."""
        samples = [table[: self.count].copy() for table in (self._tables() if self.count else ())]
        counts = self.count, self._thinned, self._held_from, self._observed
        return RecordState(
            *counts, samples, list(self._angles), *copy.deepcopy((self._monitor, self._running))
        )

    def restore(self, state: RecordState, scenario: Scenario) -> None:
        """Return to earlier samples of a scenario; what was handed out stays as it is."""
        self.scenario = scenario
        if self._is_shared or (state.samples and not self._samples):
            self._allocate()
        self.count, self._thinned = state.size, state.thinned
        self._held_from, self._observed = state.held_from, state.observed
        self._angles = list(state.angles)
        self._monitor, self._running = copy.deepcopy((state.monitor, state.running))
        if state.samples:  # none before the first tick
            for table, samples in zip(self._tables(), state.samples, strict=True):
                table[: self.count] = samples

    def _tables(self) -> list[NDArray[Any]]:
        return [*self._samples.values(), *self._jacobians, *self._turned.values(), self._forces]

    def observe(self) -> None:
        """Work out what an Observation has of the samples that lack it, all in the present surroundings.

        Raises:
            CoopPinError: there is no acceleration, or no finite wrench, at the last sample, which is dropped:
                at one before, the run would have ended there.
        """
        new, samples = slice(self._observed, self.count), self._samples
        if new.start == new.stop:
            return
        self.count -= 1
        q, v, time = samples["configuration"][new], samples["velocity"][new], samples["time"][new]
        with np.errstate(over="ignore", invalid="ignore"):
            observation = self._plant.observe(q, v, self._forces[new], time)
        for name, values in observation._asdict().items():
            if values is not None:
                samples[name][new] = values
        self._observed = self.count = new.stop

    def _thin(self, running: RunningMetrics) -> None:
        """Add the ticks that are held to the running metrics, and keep every n-th of them."""
        self.observe()
        held = slice(self._thinned, self.count)
        running.add(computed(self.table, self._kept(held), self._cell.shares), self.scenario)
        kept = self._rows()
        for table in self._tables():
            table[: len(kept)] = table[kept]
        self._held_from += self.count - self._thinned
        self.count = self._thinned = self._observed = len(kept)

    def _rows(self, *, is_last: bool = False) -> Any:
        """Return the indices of the samples that stay; with the last one if it is that of the run."""
        if self._running is None:
            return slice(0, self.count)
        rows = np.arange(self.count)
        ticks = self._held_from + rows - self._thinned
        return rows[
            (rows < self._thinned) | (ticks % self._every == 0) | (is_last & (rows == self.count - 1))
        ]

    def _columns(self, quantity: Quantity) -> tuple[list[Array], list[int] | None]:
        """Return the samples of each arm, or of a quantity of no arm, and their entries; None for all."""
        samples, arms = self._samples[quantity.name], self._arms
        match quantity.dims.split():
            case []:
                return [samples], None
            case [_, "joint"]:
                return [samples[:, index, : len(arm.drive)] for index, arm in enumerate(arms)], None
            case [_, "axis"]:
                return [*samples.swapaxes(0, 1)], list(self._cell.task_rows.indices)
        return [*samples.swapaxes(0, 1)], None

    def sample(self) -> Samples:
        """Return what is recorded of the last tick, with an axis of one sample; it changes at the next."""
        self.observe()
        return self._kept(slice(self.count - 1, self.count))

    def snapshot(self) -> Snapshot:
        """Return the sample of the last recorded tick."""
        self._is_shared = True
        values = computed(self.table, self.sample(), self._cell.shares, Snapshot._fields)
        arrays = {n: frozen(values[n][0]) for n in Snapshot._fields if n != "time" and n in values}
        return Snapshot(time=float(values["time"][0]), **arrays)

    def result(self, scenario: Scenario) -> RunResult:
        """Return the result of the scenario that was run, to the last tick whose wrenches are finite."""
        from coop_pin.results.dataset import dataset  # slow to load

        self._is_shared = True
        while self._observed < self.count:
            with contextlib.suppress(CoopPinError):  # which drops the last sample
                self.observe()
        names = [joints for _, joints in self.joints]
        data = dataset(scenario, self._kept(self._rows(is_last=True)), names, self._limits)
        if self._running is not None:
            held = computed(self.table, self._kept(slice(self._thinned, self.count)), self._cell.shares)
            data.attrs[RunResult.EVERY_TICK] = self._running.finished(held, scenario).to_text()
        if self._plant.engine != RunResult.USUAL_ENGINE:
            data.attrs[RunResult.ENGINE] = self._plant.engine
        return RunResult(scenario, data)

    def breaches(self) -> tuple[Breach, ...]:
        """Return the breaches of the trust thresholds at the last recorded tick; call it at every tick."""
        return self._monitor.breaches(computed(self.table, self.sample(), self._cell.shares, _WATCHED))

    @property
    def joints(self) -> list[tuple[str, list[str]]]:
        """Name of each arm and names of its joints."""
        return [(arm.name, list(arm.joint_names)) for arm in self._arms]

    def _kept(self, ticks: slice) -> Samples:
        """Return what was recorded at some ticks, without the wrenches that rigid bodies do not determine."""
        if self.count == 0:
            raise InvalidStateError("no tick is done yet, so nothing is recorded; do one first")
        samples: Samples = {name: values[ticks] for name, values in self._samples.items()}
        samples["interaction_wrench"][..., ~self.determined] = np.nan
        arms, q, v = self._arms, samples["configuration"], samples["velocity"]
        return samples | {
            "angles": [
                self._turned[index][ticks] if index in self._turned else arm.angles.of(q[:, arm.q_slice])
                for index, arm in enumerate(arms)
            ],
            "rates": [v[:, arm.v_slice] for arm in arms],
            "drive": [arm.drive for arm in arms],
            "jacobian": [J[ticks] for J in self._jacobians],
        }

    def labels(self) -> Samples:
        """Return names and limits of arms and joints by name."""
        from coop_pin.results.dataset import without_time  # slow to load

        return without_time(self.scenario, [joints for _, joints in self.joints], self._limits)
