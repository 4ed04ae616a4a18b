"""Result of a run: its scenario, labelled arrays, metrics, and its netCDF file."""

from __future__ import annotations

import functools
import math
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from coop_pin.base.arrays import require_path, require_type
from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import FileReadError, ScenarioError
from coop_pin.description.scenario import Scenario
from coop_pin.results.friction import (
    FrictionUse,
    dropped_at,
    friction_text,
    friction_use,
)
from coop_pin.results.metrics import (
    NO_STEADY_METRICS,
    STEADY_METRICS,
    InternalForceMetrics,
    internal_wrench_definitions,
    metric_text,
    steady_metrics,
)
from coop_pin.results.quantities import Arrays, Samples, quantities
from coop_pin.results.running_metrics import EveryTick, RunningMetrics
from coop_pin.results.trust import (
    Breach,
    LimitViolation,
)
from coop_pin.results.window import SETTLING_S, Window, Windows, checked_window

if TYPE_CHECKING:  # slow to load
    import xarray as xr

_EVENT = ("resettling_time_s", "event_peak_position_error_m")


class RunResult:
    """Result of a run, finished or not.

    Attributes:
        scenario: scenario that was run.
        data: xarray Dataset with dimensions time, arm, joint, axis; units are attributes of the variables.
        arrays: arrays of the same without labels, by name.
    """

    ENDED_BY = "ended_by"
    """Attribute of ``data``: class of the error that ended the run, if one did."""
    ENGINE, USUAL_ENGINE = "engine", "pinocchio"
    """Attribute of ``data``: what computed the motion, unless it was Pinocchio."""
    EVERY_TICK = "every_tick"
    """Attribute of ``data`` of runs that keep every n-th tick: what is known of all ticks, as JSON."""
    REMARKS = "remarks"
    """Attribute of ``data``: what the law's last state says of the run, a sentence a line, if anything."""

    def __init__(
        self,
        scenario: Scenario,
        data: xr.Dataset | Samples,
        attributes: Mapping[str, str] | None = None,
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
        """What computed the run: "pinocchio" or "compiled"."""
        return str(self._texts.get(self.ENGINE, self.USUAL_ENGINE))

    @property
    def _texts(self) -> Mapping[str, str]:
        """Attributes of ``data``, without labelling the arrays."""
        return self._attributes if isinstance(self._data, dict) else self._data.attrs

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return float(np.asarray(self.arrays["time"])[-1])

    @property
    def windows(self) -> Windows:
        """Windows of the metrics."""
        return Windows.of(self.scenario, self.end)

    def window_of(self, metric: str) -> Window:
        """Return the window that an entry of ``metrics`` is taken over."""
        if metric.startswith("after_event_"):
            return self.windows.after_event
        if metric in STEADY_METRICS:
            return self.windows.steady
        if metric == "settling_time_s":
            return Window(0.0, self.windows.event.start)
        return self.windows.event if metric in _EVENT else Window(0.0, self.end)

    def breaches(self) -> tuple[Breach, ...]:
        """Return what exceeded the scenario's trust thresholds, in the order of the first times.

        The last one is the error that ended the run, if one did.
        """
        breaches = self._of_all_ticks().breaches
        if self.ENDED_BY in self._texts:
            breaches += (Breach("error", "", "", self.end, self.end, self.scenario.duration),)
        return breaches

    @property
    def trustworthy(self) -> bool:
        """Whether the run kept within its scenario's trust thresholds."""
        return not self.breaches()

    def verdict(self) -> str:
        """Return "trustworthy", or the first breach in time with the number of the others, as one line.

        A payload that drops is named first.
        """
        first, *others = self.breaches() or (None,)
        more = f"; {len(others)} more" if others else ""
        trust = "trustworthy" if first is None else f"NOT TRUSTWORTHY: {first}{more}"
        text = self.friction_text
        if math.isfinite(self.dropped_at):
            return f"DROPPED: {text}; simulation {trust}"
        return f"{trust}; {text}" if text else trust

    def friction_use(self) -> FrictionUse:
        """Return the friction that every patch or pad uses of what it bears, over time."""
        return friction_use(self.arrays, self.scenario.cell)

    @property
    def friction_text(self) -> str:
        """When and why the payload slipped or dropped, or would by its pads; "" if it did not."""
        return friction_text(self.arrays, self.scenario)

    @property
    def dropped_at(self) -> float:
        """Time from which nothing holds the payload, s; NaN if something always does."""
        return float(dropped_at(self.arrays, self.scenario))

    def settling_time(self) -> float:
        """Return when the errors stay within 5 mm and 5 mrad until the first event, s; inf if they do not.

        On positional rows nothing controls the orientation, and the position alone counts.
        """
        return self._of_all_ticks().metrics["settling_time_s"]

    def position_rms(self, *, window: tuple[float, float] | None = None) -> float:
        """Return the rms of the position error over the steady window or another one, m.

        Args:
            window: start and end, s; NaN over a steady window that the run does not reach.

        Raises:
            OutOfRangeError: the window is empty or not within the run.
        """
        return self._steady_metrics(window)["position_rms_m"]

    def orientation_rms(self, *, window: tuple[float, float] | None = None) -> float:
        """Return the rms of the orientation error, rad; window as of position_rms."""
        return self._steady_metrics(window)["orientation_rms_rad"]

    def internal_force(self, *, window: tuple[float, float] | None = None) -> InternalForceMetrics:
        """Return the metrics of the internal wrench; window as of position_rms."""
        return InternalForceMetrics(*list(self._steady_metrics(window).values())[2:])

    def internal_wrench_definitions(self) -> xr.Dataset:
        """Return the internal wrench of every arm at every sample by each definition of the literature.

        Variables ``load_shares`` (the paper's, eqs. (7)-(12)), ``minimum_norm``, ``nonsqueezing``,
        ``virtual_linkage``, ``constraint_consistent``, ``symmetric``: see spatial.internal_wrench.
        """
        cell = self.scenario.cell
        return internal_wrench_definitions(self.data, cell.shares, cell.payload)

    def closure_error_max(self) -> tuple[float, float]:
        """Return the largest distance (m) and angle (rad) between a tip and its grasp over the whole run."""
        values = self._of_all_ticks().metrics
        return values["closure_error_max_m"], values["closure_error_max_rad"]

    def energy_balance_max(self) -> float:
        """Return the largest difference between energy and work over the whole run, J."""
        return self._of_all_ticks().metrics["energy_balance_max_J"]

    def limit_violations(self) -> tuple[LimitViolation, ...]:
        """Return every joint or drive limit that was exceeded, with the worst value and the first time."""
        return self._of_all_ticks().limits

    def metrics(self) -> dict[str, float]:
        """Return all metrics by name; the names carry the units, ``window_of`` gives their windows.

        ``trustworthy`` is 1 or 0. ``window_start_s`` and ``window_end_s`` bound the steady window,
        ``after_event_window_start_s`` and ``after_event_window_end_s`` that of the same metrics after the
        last event; a run that does not reach a window has NaN there. ``squeeze_reserve_min_N`` is
        that of cells with patches or pads, ``dropped_at_s`` also of cells whose grasps open. Of a run that
        keeps every n-th tick they are those of all ticks, as are breaches and limits; other windows are of
        the kept ones.
        """
        return {"trustworthy": float(self.trustworthy), **self._of_all_ticks().metrics}

    def _of_all_ticks(self) -> EveryTick:
        """Return metrics, breaches and exceeded limits; of a run that keeps every n-th tick, of all."""
        if self.every_tick is not None:
            return self.every_tick
        arrays = {str(name): np.asarray(values) for name, values in self.arrays.items()}
        return RunningMetrics(self.scenario, arrays).finished(arrays, self.scenario)

    def summary(self) -> str:
        """Return the verdict, every metric with its window, and the limits exceeded, one to a line."""
        scenario, end = self.scenario, self.end
        ended = f"; ended before its {scenario.duration:g} s" if end < scenario.duration - 1e-9 else ""
        engine = f"; engine {self.engine}" if self.ENGINE in self.data.attrs else ""
        every = f"; 1 of {scenario.clock.record_every} ticks kept, numbers of all" if self.every_tick else ""
        span = f"  {end:g} s at {scenario.clock.rate_hz:g} Hz{ended}{engine}{every}"
        lines = [f"{scenario.name}: {self.verdict()}", span]
        values = self.metrics()
        absent = [name for name, value in values.items() if math.isnan(value)]
        for name, value in values.items():
            if name in absent:
                continue
            window = "" if "window" in name else f"  {self.window_of(name)}"
            lines.append(f"  {name:<42} {metric_text(value):<14}{window}".rstrip())
        if absent:
            lines.append(
                textwrap.fill(f"  does not apply: {', '.join(absent)}", 99, subsequent_indent="    ")
            )
        if self.windows.steady.is_empty:
            lines.append(f"  no steady metrics: {NO_STEADY_METRICS}")
        elif math.isinf(self.settling_time()):
            lines.append(f"  {self._unsettled()}")
        if scenario.events and self.windows.after_event.is_empty:
            wait = f"{SETTLING_S:g} s after its last event"
            lines.append(f"  no steady metrics after the events: the run ends less than {wait}")
        lines += [f"  {remark}" for remark in self.data.attrs.get(self.REMARKS, "").splitlines()]
        return "\n".join(lines + [f"  limit exceeded: {violation}" for violation in self.limit_violations()])

    def _unsettled(self) -> str:
        """Return the errors at the end of a run that did not settle, and what to try."""
        last = np.asarray(self.arrays["pose_error"])[-1]
        advice = "the gains are too low for the load, or unstable at this rate ('coop-pin check' tests that)"
        if any(violation.kind == "torque" for violation in self.limit_violations()):
            advice = "drives saturate: lower load, squeeze or gains, or feed the force back (force_gain)"
        turn = f" and {np.linalg.norm(last[3:]):.3g} rad" if self.scenario.cell.controls_turns else ""
        return f"did not settle: errors of {np.linalg.norm(last[:3]):.3g} m{turn} at the end; {advice}"

    def _steady_metrics(self, interval: tuple[float, float] | None) -> dict[str, float]:
        if interval is None and self.every_tick is not None:
            return {name: self.every_tick.metrics[name] for name in STEADY_METRICS}
        window = self.windows.steady if interval is None else checked_window(interval, self.end)
        values = steady_metrics(self.arrays, window)
        return {name: float(value) for name, value in values.items()}

    def save(self, path: str | Path) -> None:
        """Write a netCDF file that holds the scenario too; if writing fails, an older file stays."""
        require_path("path", path)
        from coop_pin.results.netcdf import to_netcdf  # slow to load

        content = to_netcdf(self.data, self.scenario.to_toml())
        write_atomically(Path(path), lambda part: part.write_bytes(content))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a result.

        Raises:
            FileReadError: the file is missing, damaged or not a result of this version of coop_pin.
        """
        from coop_pin.results.dataset import with_names  # slow to load
        from coop_pin.results.netcdf import read_dataset

        require_path("path", path)
        path = Path(path)
        if not path.is_file():
            hint = "; it is a folder: give the path of the result.nc in it" if path.is_dir() else ""
            raise FileReadError(f"there is no result file at {path}{hint}")
        data, text = read_dataset(path)
        try:
            scenario = Scenario.from_toml(text)
        except (ScenarioError, FileReadError) as error:
            unreadable = f"{path} holds a scenario that this version of coop_pin cannot read ({error})"
            command = f"coop-pin run {path.with_name('scenario.toml')} --out {path.parent}"
            raise FileReadError(f"{unreadable}; mend it and repeat it: {command}") from None
        if missing := [q.name for q in quantities(scenario) if q.stored and q.name not in data]:
            advice = "it was written by another version of coop_pin: run its scenario again"
            raise FileReadError(f"{path} lacks {', '.join(missing)}; {advice}")
        return cls(scenario, with_names(data))
