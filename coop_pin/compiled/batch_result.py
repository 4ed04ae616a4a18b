"""Results of a batch: the record of each run, and the metrics of all."""

from __future__ import annotations

import itertools
from collections import ChainMap
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.compiled.preparation import Prepared
from coop_pin.compiled.samples import RunSamples
from coop_pin.results.friction import drop_metrics
from coop_pin.results.metrics import SIMULATION_SOUND, TASK_KEPT, all_metrics
from coop_pin.results.quantity import Samples
from coop_pin.results.run_result import RunResult
from coop_pin.results.running_metrics import RunningMetrics
from coop_pin.results.task import TaskMonitor
from coop_pin.results.trust import TrustMonitor
from coop_pin.tracing.kernel import Layout


class BatchResult:
    """Results of a batch.

    Attributes:
        scenarios: scenarios that were run.
        is_valid: mask of the runs that kept to the guards of a single run (finite and closed motion, regular
            Jacobians); the samples of the others mean nothing, shape (runs,).
        samples: quantities as a single run has them, at the ticks that it keeps, with a leading axis of runs.
        every_tick: the same at all ticks.
    """

    def __init__(
        self,
        prepared: Prepared,
        layout: Layout,
        records: Sequence[Array],
        is_valid: Mask,
        give_back: Callable[[], None],
    ) -> None:
        """Hold the records.

        Args:
            prepared: Scenarios, plants and numbers of the batch.
            layout: Slots of the records.
            records: Records of blocks of the runs, as a Machine returns them.
            is_valid: Mask of the valid runs, shape (runs,).
            give_back: Function that gives the memory of the records back.
        """
        self.scenarios, self.is_valid = prepared.scenarios, is_valid
        self._plants, self._thresholds, self._give_back = prepared.plants, prepared.thresholds, give_back
        self._every = every = self.scenarios[0].clock.record_every
        self.every_tick = RunSamples(prepared, layout, records)
        self.samples = self.every_tick if every == 1 else RunSamples(prepared, layout, records, every)

    def release(self) -> None:
        """Give the memory of the records to later batches.

        Samples, results and metrics that were returned before are copies and stay as they are. From now on,
        asking for others raises InvalidStateError.
        """
        self.every_tick.release()
        self.samples.release()
        self._give_back()

    def result(self, index: int) -> RunResult:
        """Return the result of one run, as coop_pin.run returns it."""
        plant, scenario = self._plants[index], self.scenarios[index]
        samples = {each.name: self.every_tick[each.name][index].copy() for each in plant.table}
        attributes = {RunResult.ENGINE: "compiled"}
        if self._every > 1:
            known = RunningMetrics(scenario, plant.labels).finished(samples, scenario)
            attributes[RunResult.EVERY_TICK] = known.to_text()
            samples = {name: self.samples[name][index].copy() for name in samples}
        return RunResult(scenario, samples | plant.labels, attributes)

    def metrics(self) -> list[dict[str, float]]:
        """Return the metrics of every run, as those of its result, without making the results."""
        extremes = self.every_tick.extremes(self.scenarios[0].trust.jacobian_condition)
        parts = (self._metrics(part, runs, extremes) for runs, part in self.every_tick.parts())
        metrics = list(itertools.chain.from_iterable(parts))
        for index, thresholds in enumerate(self._thresholds):
            if thresholds != self._thresholds[0]:
                metrics[index] = self.result(index).metrics()
        return metrics

    def _metrics(self, part: RunSamples, runs: slice, extremes: Samples) -> list[dict[str, float]]:
        """Return the metrics of some of the runs, with the thresholds of the first of all."""
        first, sides = self.scenarios[0], ("position_lower", "position_upper")
        limits = part.of_plants(lambda plant: np.stack([plant.labels[side] for side in sides]))
        lower, upper = np.moveaxis(limits, 1, 0)
        known = {name: values[runs] for name, values in extremes.items()}
        known |= {"time": part["time"][0], "arm": self._plants[runs.start].labels["arm"]}
        data = ChainMap(known, cast(Any, part))
        with np.errstate(all="ignore"):  # of runs that are not valid
            task = TaskMonitor(())
            is_off = task.exceeded(data, first)
            metrics = all_metrics(data, first, float(data["time"][-1]), task.after_decay)
            metrics |= drop_metrics(data, first)
            monitor = TrustMonitor(first.trust, (), lower, upper)
            is_sound = ~monitor.exceeded(data, metrics["energy_balance_max_J"])
            is_off |= metrics["joint_drift_rad"] > first.task.joint_drift
            is_off |= np.isfinite(metrics.get("dropped_at_s", np.nan))
        columns = {SIMULATION_SOUND: is_sound, TASK_KEPT: ~is_off} | task.largest | metrics
        table = np.empty((len(columns), len(is_sound)))
        for row, values in zip(table, columns.values(), strict=True):
            row[:] = values
        return [dict(zip(columns, row, strict=True)) for row in table.T.tolist()]
