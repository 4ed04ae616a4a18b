"""Result of a run: its scenario, labelled arrays, metrics, and its netCDF file."""

from __future__ import annotations

import functools
import html
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from coop_pin.base.arrays import Mask, require_path, require_type
from coop_pin.base.atomic_write import write_atomically
from coop_pin.description.events import MISSED
from coop_pin.description.scenario import Scenario
from coop_pin.results.breaches import Breach, LimitViolation
from coop_pin.results.finding import Findings
from coop_pin.results.friction import FrictionUse, dropped_at, friction_text, friction_use
from coop_pin.results.metrics import (
    SIMULATION_SOUND,
    TASK_KEPT,
    InternalForceMetrics,
    metric_lines,
    phase_metrics,
)
from coop_pin.results.quantity import Arrays, Samples
from coop_pin.results.running_metrics import EveryTick, Metrics, RunningMetrics
from coop_pin.results.task import LARGEST, TaskMonitor, TaskVerdict, monitored, task_verdict
from coop_pin.results.window import Window, checked_window, metric_windows, phases, samples_of

if TYPE_CHECKING:  # slow to load
    import pandas as pd
    import xarray as xr

_FORMER = {"trustworthy": "simulation_sound and task.kept", "windows": "phases", "window_of": "windows_of"}
"""Attributes of earlier versions, and what replaces them."""


class RunResult:
    """Result of a run, finished or not.

    Attributes:
        scenario: scenario that was run.
        data: xarray Dataset with dimensions time, arm, joint, axis; units are attributes of the variables.
        arrays: arrays of the same without labels, by name.
    """

    ENDED_BY = "ended_by"
    """Attribute of ``data``: class of the error that ended the run, if one did."""
    ENGINE, USUAL_ENGINE, LOGGED = "engine", "pinocchio", "log"
    """Attribute of ``data``: what computed the motion, unless it was Pinocchio; of a log LOGGED."""
    EVERY_TICK = "every_tick"
    """Attribute of ``data`` of runs that keep every n-th tick: what is known of all ticks, as JSON."""
    FINDINGS, REMARKS = "findings", "remarks"
    """Attributes of ``data``, if any: errors and warnings that the run began with, as JSON; what plant and
    law say of the run at its end, a sentence a line."""

    def __init__(
        self, scenario: Scenario, data: xr.Dataset | Samples, attributes: Mapping[str, str] | None = None
    ) -> None:
        """Hold a Dataset, or arrays as ``labelled`` takes them, which are labelled on access.

        Args:
            scenario: Scenario that was run.
            data: Dataset, or arrays by name.
            attributes: Further attributes of the Dataset that is made of arrays.
        """
        require_type("scenario", scenario, Scenario)
        require_type("data", data, Mapping)
        self.scenario, self._data, self._attributes = scenario, data, dict(attributes or {})

    @property
    def data(self) -> xr.Dataset:
        """The labelled arrays."""
        if isinstance(self._data, dict):
            from coop_pin.results.dataset import labelled  # slow to load

            self._data = labelled(self.scenario, self._data).assign_attrs(self._attributes)
        return self._data

    @property
    def arrays(self) -> Arrays:
        """The arrays by name, without their labels."""
        return self._data if isinstance(self._data, dict) else self._data.variables

    @functools.cached_property
    def every_tick(self) -> EveryTick | None:
        """Metrics, breaches and exceeded limits of all ticks of a run that keeps every n-th."""
        text = self._texts.get(self.EVERY_TICK)
        return None if text is None else EveryTick.of_text(text)

    @property
    def engine(self) -> str:
        """What computed the run: "pinocchio", "compiled" or "mujoco"."""
        return str(self._texts.get(self.ENGINE, self.USUAL_ENGINE))

    @property
    def _texts(self) -> dict[Any, Any]:
        """Attributes of ``data``, without labelling the arrays."""
        return self._attributes if isinstance(self._data, dict) else self._data.attrs

    @property
    def findings(self) -> Findings:
        """Errors and warnings that were known before the run; none of one that did not look."""
        text = self._texts.get(self.FINDINGS)
        return Findings(self.scenario.name, ()) if text is None else Findings.from_json(text)

    def note(self, findings: Findings) -> None:
        """Keep the errors and warnings among the findings of the run.

        Args:
            findings: findings of the scenario.
        """
        if len(doubts := findings.of("error", "warning")):
            self._texts[self.FINDINGS] = doubts.to_json()

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return float(np.asarray(self.arrays["time"])[-1])

    @functools.cached_property
    def monitor(self) -> TaskMonitor:
        """Task monitor of the kept samples: when the start had decayed, and since when errors count."""
        return monitored(self.arrays, self.scenario)

    @functools.cached_property
    def phases(self) -> dict[str, Mask]:
        """Masks of the kept samples in each phase of metrics such as ``moving_position_rms_m``.

        "moving" and "rest", as the reference does, are without the decay of what the run starts with and
        without events that last; "after_event" is from the end of the last event and its recovery on.
        """
        return phases(self.arrays, self.scenario, self.monitor.after_decay)

    def windows_of(self, metric: str) -> tuple[Window, ...]:
        """Return the windows that an entry of ``metrics`` is taken over."""
        return metric_windows(metric, self.arrays, self.scenario, self.phases, self.monitor.counted_from)

    def breaches(self) -> tuple[Breach, ...]:
        """Return what exceeded the scenario's trust thresholds, in the order of the first times."""
        return self._of_all_ticks.breaches

    @property
    def simulation_sound(self) -> bool:
        """Whether the simulation kept within the scenario's trust thresholds: its numbers can be believed."""
        return not self.breaches()

    @property
    def task(self) -> TaskVerdict:
        """Verdict on the task, by the scenario's task limits: kept, off, dropped or lost."""
        known, remarks = self._of_all_ticks, self._texts.get(self.REMARKS, "").splitlines()
        deviations = known.deviations
        if self.ENDED_BY in self._texts:
            deviations += (Breach("error", "", "", self.end, self.end, self.scenario.duration),)
        missed = [remark for remark in remarks if MISSED in remark]
        recovery = self.scenario.task.recovery if self.scenario.events else 0.0
        return task_verdict(deviations, known.metrics, recovery, self.friction_text, missed)

    def verdict(self) -> str:
        """Return the verdicts on simulation and task as one line; what must not be believed comes first."""
        first, *others = self.breaches() or (None,)
        more, task, text = f"; {len(others)} more" if others else "", self.task, self.friction_text
        done = f"{task.text}; {text}" if text and task.state != "dropped" else task.text
        if first is None:
            return f"{done}; simulation sound"
        return f"SIMULATION NOT SOUND: {first}{more}; do not believe the rest: {done}"

    def friction_use(self) -> FrictionUse:
        """Return the friction that every patch or pad uses of what it bears, over time."""
        return friction_use(self.arrays, self.scenario.cell)

    @property
    def friction_text(self) -> str:
        """When and why the payload slipped or dropped, or would by its pads; "" if it did not."""
        return friction_text(self.arrays, self.scenario)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Name what replaces a former attribute.

            Raises:
                AttributeError: there is no such attribute.
            """
            advice = f"; ask {_FORMER[name]}" if name in _FORMER else ""
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}{advice}")

    @property
    def dropped_at(self) -> float:
        """Time from which nothing holds the payload, s; NaN if something always does."""
        return float(dropped_at(self.arrays, self.scenario))

    def settling_time(self) -> float:
        """Return when the errors stay within 5 mm and 5 mrad until the first event, s; inf if they do not.

        On positional rows nothing controls the orientation, and the position alone counts.
        """
        return self._of_all_ticks.metrics["settling_time_s"]

    def position_rms(self, *, window: tuple[float, float] | None = None) -> float:
        """Return the rms of the position error, m.

        Args:
            window: start and end, s. When omitted, all that is moving or at rest, see ``phases``; of a run
                without such a time, all after the decay of its start.

        Raises:
            OutOfRangeError: the window is empty or not within the run.
        """
        return self._over(window)["position_rms_m"]

    def orientation_rms(self, *, window: tuple[float, float] | None = None) -> float:
        """Return the rms of the orientation error, rad; window as of position_rms."""
        return self._over(window)["orientation_rms_rad"]

    def internal_force(self, *, window: tuple[float, float] | None = None) -> InternalForceMetrics:
        """Return the metrics of the internal wrench; window as of position_rms."""
        return InternalForceMetrics(*list(self._over(window).values())[2:])

    def _over(self, window: tuple[float, float] | None) -> dict[str, float]:
        if window is None:
            mask = self.phases["moving"] | self.phases["rest"]
            mask = mask if mask.any() else self.monitor.after_decay
        else:
            mask = samples_of(self.arrays, checked_window(window, self.end))
        return {name: float(value) for name, value in phase_metrics(self.arrays, [mask])[0].items()}

    def internal_wrench_definitions(self) -> xr.Dataset:
        """Return the internal wrench of every arm at every sample by each definition of the literature.

        Variables ``load_shares`` (the paper's, eqs. (7)-(12)), ``minimum_norm``, ``nonsqueezing``,
        ``virtual_linkage``, ``constraint_consistent``, ``symmetric``: see spatial.internal_wrench. Beside
        joints those whose load a grasp does not transmit are NaN, and ``transmitted`` is the run's own.
        """
        from coop_pin.results.dataset import internal_wrench_definitions  # slow to load

        return internal_wrench_definitions(self.data, self.scenario.cell)

    def closure_error_max(self) -> tuple[float, float]:
        """Return the largest distance (m) and angle (rad) between a tip and its grasp over the whole run."""
        values = self._of_all_ticks.metrics
        return values["closure_error_max_m"], values["closure_error_max_rad"]

    def energy_balance_max(self) -> float:
        """Return the largest difference between energy and work over the whole run, J."""
        return self._of_all_ticks.metrics["energy_balance_max_J"]

    def limit_violations(self) -> tuple[LimitViolation, ...]:
        """Return every joint or drive limit that was exceeded, with the worst value and the first time."""
        return self._of_all_ticks.limits

    def metrics(self) -> Metrics:
        """Return all metrics by name; the names carry the units, ``windows_of`` gives their windows.

        ``simulation_sound`` and ``task_kept`` are 1 or 0. The largest errors are those of the whole run but
        the decay of what it starts with, see TaskMonitor. Names that begin with moving, rest or after_event
        are of these ``phases``; NaN where a run has no such phase. ``squeeze_reserve_min_N`` is that of cells
        with patches or pads, ``dropped_at_s`` also of cells whose grasps open. Of a run that keeps every n-th
        tick they are those of all ticks, as are breaches and limits; other windows are of the kept ones.
        """
        verdicts = {SIMULATION_SOUND: float(self.simulation_sound), TASK_KEPT: float(self.task.kept)}
        return Metrics(verdicts | dict(self._of_all_ticks.metrics))

    @functools.cached_property
    def _of_all_ticks(self) -> EveryTick:
        """Metrics, breaches and exceeded limits; of a run that keeps every n-th tick, of all."""
        if self.every_tick is not None:
            return self.every_tick
        arrays = {str(name): np.asarray(values) for name, values in self.arrays.items()}
        return RunningMetrics(self.scenario, arrays).finished(arrays, self.scenario)

    def summary(self) -> str:
        """Return the verdicts, every metric with its windows, and the limits exceeded, one to a line."""
        scenario, end = self.scenario, self.end
        ended = f"; ended before its {scenario.duration:g} s" if end < scenario.duration - 1e-9 else ""
        engine = f"; engine {self.engine}" if self.ENGINE in self.data.attrs else ""
        every = f"; 1 of {scenario.clock.record_every} ticks kept, numbers of all" if self.every_tick else ""
        span = f"  {end:g} s at {scenario.clock.rate_hz:g} Hz{ended}{engine}{every}"
        expected = ("moving", "rest", "after_event")[: 3 if scenario.events else 2]
        missing = [phase for phase in expected if not self.phases[phase].any()]
        lines = [f"{scenario.name}: {self.verdict()}", span]
        lines += metric_lines(self.metrics(), self.windows_of, missing)
        if any(window.start > 0.0 for name in LARGEST.values() for window in self.windows_of(name)):
            lines.append("  largest errors: before their windows the error that the start left only decays")
        lines += [f"  {remark}" for remark in self.data.attrs.get(self.REMARKS, "").splitlines()]
        return "\n".join(lines + [f"  limit exceeded: {violation}" for violation in self.limit_violations()])

    __repr__ = summary

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.summary())}</pre>"

    def to_dataframe(self) -> pd.DataFrame:
        """Return the samples as a table: a row for each time, a column for each arm, joint, axis [unit]."""
        from coop_pin.results.dataset import as_table  # slow to load

        return as_table(self.data)

    def save(self, path: str | Path) -> None:
        """Write a netCDF file that holds the scenario too; if writing fails, an older file stays."""
        require_path("path", path)
        from coop_pin.results.netcdf import to_netcdf  # slow to load

        content = to_netcdf(self.data, self.scenario.to_toml())
        write_atomically(Path(path), lambda part: part.write_bytes(content))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a result, from its file or from the folder of a run.

        Raises:
            FileReadError: the file is missing, damaged or not a result of this version of coop_pin.
        """
        from coop_pin.results.netcdf import read_run  # slow to load

        require_path("path", path)
        return cls(*read_run(Path(path)))
