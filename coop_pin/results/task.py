"""Task of a run: errors beyond its limits, largest errors, and the verdict: kept, off, dropped or lost."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.spatial import norms6
from coop_pin.description.scenario import Scenario
from coop_pin.results.breaches import Breach, Cause, Series, merged
from coop_pin.results.friction import bearing_slip, pad_friction, wheel_friction
from coop_pin.results.metrics import error_norms
from coop_pin.results.quantity import Arrays
from coop_pin.results.window import recovering

TaskState = Literal["kept", "off", "dropped", "lost"]
LARGEST: dict[Cause, str] = {
    "position": "position_error_max_m",
    "orientation": "orientation_error_max_rad",
    "internal force": "internal_force_error_max_N",
    "internal moment": "internal_moment_error_max_Nm",
}
"""Metric of the largest error, by the cause of its breach."""
_FROM_GROWTH, _FROM_OWN, _FROM_ALL = 0, 1, 2
"""Rules of what counts: from growth, from the first time within the own limit, from t_0; see TaskMonitor."""
_ROUNDING = 1e-9
"""Rounding of times, s."""
_Errors: TypeAlias = dict[Cause, tuple[Array, Array | float]]
"""Values of the errors and their limits."""


class TaskVerdict(NamedTuple):
    """Verdict on the task of a run.

    Attributes:
        state: "kept"; "off" beyond a limit; "dropped" by all that held the payload; "lost" where an error
            ended the run or a planned grasp did not happen.
        text: the verdict as a part of a sentence.
        deviations: errors beyond the task limits in the order of their first times; last the error that ended
            the run, if one did.
    """

    state: TaskState
    text: str
    deviations: tuple[Breach, ...]

    @property
    def kept(self) -> bool:
        """Whether the task was kept."""
        return self.state == "kept"


def task_verdict(
    deviations: tuple[Breach, ...],
    metrics: Mapping[str, float],
    recovery: float,
    friction: str,
    missed: Sequence[str],
) -> TaskVerdict:
    """Return the verdict on the task of a run.

    Args:
        deviations: errors beyond the task limits, in time; last the error that ended the run, if one did.
        metrics: metrics of the run.
        recovery: recovery of the task limits, s.
        friction: text of friction_text on when and why the payload slipped or dropped.
        missed: remarks on planned grasps that did not happen.
    """
    if math.isfinite(metrics.get("dropped_at_s", math.nan)):
        return TaskVerdict("dropped", f"DROPPED: {friction}", deviations)
    ended = [breach for breach in deviations if breach.cause == "error"]
    if reasons := [*map(str, ended), *missed]:
        return TaskVerdict("lost", f"task LOST: {'; '.join(reasons)}", deviations)
    if deviations:
        first, *others = deviations
        more = f"; {len(others)} more" if others else ""
        return TaskVerdict("off", f"task OFF: {first}{more}", deviations)
    scales = ((1e3, "mm"), (1e3, "mrad"), (1.0, "N"), (1.0, "N m"))
    sizes = [
        f"{cause} to {size:.2g} {unit}" if size < 99.5 else f"{cause} to {size:.0f} {unit}"
        for (cause, name), (scale, unit) in zip(LARGEST.items(), scales, strict=True)
        if math.isfinite(size := scale * metrics[name])
    ]
    allowance = f"; larger errors are allowed until {recovery:g} s after events" if recovery > 0.0 else ""
    return TaskVerdict("kept", f"task kept ({', '.join(sizes)}{allowance})", ())


class TaskMonitor:
    """Search for errors beyond the task limits in successive samples: of a whole run, or of its blocks.

    With the errors e_q of quantity q, their limits l_q and the time t_1 of the first event, errors count from

        t_0 = first time at which e_q <= l_q for all q, but at most t_1,

    and where there is none, those of each q from its own first time within l_q; without that, from the time
    at which e_q grows first, at least at the end. The largest errors count from the time after t_0 at which
    e_q grows first: before, they are what is left of the start.

    Attributes:
        largest: metrics of LARGEST by name, of all samples so far, shape (...) each.
        counted_from: times from which they count, s, likewise by name.
        after_decay: mask of the last samples from t_0 on, shape (..., n). Where there is none, from the last
            of the times at which one of the errors was within its own limit first.
    """

    def __init__(self, joints: Sequence[tuple[str, Sequence[str]]]) -> None:
        """Start before the first sample; with the name of each arm, and names of its joints."""
        self._joints = joints
        self._cut_start, self._slip, self._slid = np.array(np.nan), np.zeros(()), np.zeros(())
        self._decay: _Decay | None = None
        self._restarted = frozenset[Cause]()
        self.largest = dict.fromkeys(LARGEST.values(), np.array(np.nan))
        self.counted_from = dict.fromkeys(LARGEST.values(), np.array(0.0))
        self.after_decay: Mask = np.zeros(0, dtype=bool)

    def deviations(
        self, samples: Mapping[str, NDArray[Any]], scenario: Scenario, earlier: Sequence[Breach] = ()
    ) -> tuple[Breach, ...]:
        """Return the errors beyond the limits in all samples of a run so far, by their first times.

        Args:
            samples: quantities by name, n samples that follow those of the last call.
            scenario: scenario with the events so far.
            earlier: result of the last call; errors that turn out to be of the start's decay are left out.
        """
        series = self._series(samples, scenario)
        new = (breach for each in series for breach in each.breaches(samples["time"], self._joints))
        return merged((breach for breach in earlier if breach.cause not in self._restarted), new)

    @property
    def decayed(self) -> float:
        """Number of errors that have decayed, of one run; inf once t_0 has come."""
        if self._decay is None:
            return 0.0
        return math.inf if self._decay.decayed.all() else float(self._decay.within.sum())

    def exceeded(self, samples: Mapping[str, NDArray[Any]], scenario: Scenario) -> Mask:
        """Return which runs have errors beyond the limits, shape (...), from all their samples."""
        runs = np.shape(samples["pose_error"])[:-2]
        series = self._series(samples, scenario)
        return np.any([each.beyond.reshape(*runs, -1).any(axis=-1) for each in series], axis=0)

    def _series(self, samples: Mapping[str, NDArray[Any]], scenario: Scenario) -> list[Series]:
        """Return the series of all limits; samples may have axes before that of time."""
        errors, series = _errors(samples, scenario), list[Series]()
        counted = self._counted(errors, samples["time"], scenario)
        for (cause, (values, allowed)), counts in zip(errors.items(), counted, strict=True):
            each = Series.at_most(cause, values, allowed, values - allowed)
            is_of_arms = values.ndim > counts.ndim
            series.append(each._replace(beyond=each.beyond & (counts[..., None] if is_of_arms else counts)))
        lengths, longest = self._torque_cuts(samples), scenario.task.torque_cut
        cuts = Series.at_most("torque cut", lengths, longest)
        series.append(cuts._replace(beyond=lengths > longest * (1.0 + 1e-9)))
        if "stop_force" in samples:
            force = np.abs(samples["stop_force"])
            series.append(Series("end stop", force > 0.0, force, np.zeros(force.shape), force))
        if "patch_slip" in samples:
            slid = self._slid + bearing_slip(samples, scenario.cell, self._slip)
            self._slip, self._slid = np.asarray(samples["patch_slip"])[-1], slid[-1]
            series.append(Series.at_most("slip", slid, scenario.task.slip))
        if "wheel_force" in samples and any(scenario.cell.gravity):
            series.append(wheel_friction(samples["wheel_force"], scenario.cell))
        if scenario.cell.pads:
            series.append(Series.at_most("friction", pad_friction(samples, scenario.cell), 1.0))
        return series

    def _counted(self, errors: _Errors, time: Array, scenario: Scenario) -> Mask:
        """Return which samples of each quantity count, shape (q, ..., n), and update the attributes."""
        depth, n = errors["position"][0].ndim, len(time)
        e, is_within = (
            np.stack([reduce(x, axis=-1) if np.ndim(x) > depth else x for x in parts])
            for parts, reduce in (
                ([values for values, _ in errors.values()], np.max),
                ([values <= allowed for values, allowed in errors.values()], np.all),
            )
        )
        has_event = time >= min((event.time for event in scenario.events), default=math.inf) - _ROUNDING
        before = _Decay.start(e, is_within) if self._decay is None else self._decay
        grows = np.diff(e, prepend=before.error) > 0.0
        decayed = _first(is_within.all(axis=0) | has_event, before.decayed)
        within, ever_grown = _first(is_within, before.within), _first(grows, before.ever_grown)
        is_late = np.arange(n) >= decayed[..., None]
        grown = _first((grows | has_event) & is_late, before.grown)
        rule = np.where(decayed < n, _FROM_ALL, np.where(within < n, _FROM_OWN, _FROM_GROWTH))
        starts = np.choose(rule, (np.minimum(ever_grown, n - 1), within, decayed))
        shown = np.choose(rule, (ever_grown, within, grown))
        last = np.where(within < n, within, 0).max(axis=0)
        self.after_decay = np.arange(n) >= np.where(decayed < n, decayed, last)[..., None]
        largest = np.where(np.arange(n) >= shown[..., None], e, -np.inf).max(axis=-1)
        goes_on = before.rule == rule
        keeps = goes_on & (before.shows | (rule != _FROM_GROWTH))
        self._restarted = frozenset(
            cause for cause, kept in zip(errors, keeps, strict=True) if not kept.all()
        )
        self._update(np.fmax(largest, e[..., -1]), time[np.minimum(shown, n - 1)], goes_on & before.shows)
        self._decay = _Decay(decayed < n, within < n, ever_grown < n, grown < n, shown < n, rule, e[..., -1:])
        counted: Mask = np.arange(n) >= starts[..., None]
        return counted & ~recovering(time, scenario)

    def _update(self, largest: Array, since: Array, goes_on: Mask) -> None:
        """Include the largest errors of samples and the times from which they count, shape (q, ...)."""
        for row, name in enumerate(list(LARGEST.values())[: len(largest)]):
            both = np.fmax(self.largest[name], largest[row])
            self.largest[name] = np.where(goes_on[row], both, largest[row])
            self.counted_from[name] = np.where(goes_on[row], self.counted_from[name], since[row])

    def _torque_cuts(self, samples: Mapping[str, NDArray[Any]]) -> Array:
        """Return how long each torque has been at its limit without a break, s."""
        saturated, time = np.moveaxis(samples["saturated"].astype(bool), -3, 0), samples["time"]
        is_cut, lengths = saturated.any(axis=0), np.zeros(saturated.shape)
        earlier, self._cut_start = self._cut_start, np.full(is_cut.shape, np.nan)
        if is_cut.any():
            saturated, places = saturated[:, is_cut], np.arange(1, len(time) + 1)[:, None]
            after_free = np.maximum.accumulate(np.where(saturated, 0, places), axis=0)
            begun = np.fmin(np.broadcast_to(earlier, is_cut.shape)[is_cut], time[0])
            starts = np.where(after_free, np.append(time, np.nan)[after_free], begun)
            self._cut_start[is_cut] = np.where(saturated[-1], starts[-1], np.nan)
            lengths[:, is_cut] = np.where(saturated, time[:, None] - starts, 0.0)
        return np.moveaxis(lengths, 0, -3)


def monitored(data: Arrays, scenario: Scenario) -> TaskMonitor:
    """Return the monitor of all samples of a run, for what is known of its start's decay."""
    monitor = TaskMonitor(())
    monitor.exceeded({str(name): np.asarray(values) for name, values in data.items()}, scenario)
    return monitor


class _Decay(NamedTuple):
    """State of the start's decay after some samples, shape (q, ...), of ``decayed`` (...).

    Attributes:
        decayed: whether all quantities have been within their limits, or an event has come.
        within: whether each has been.
        ever_grown: whether the error of each has grown.
        grown: whether it has since.
        shows: whether the largest errors count already.
        rule: rule of what counts: _FROM_GROWTH, _FROM_OWN or _FROM_ALL.
        error: the last errors, shape (q, ..., 1).
    """

    decayed: Mask
    within: Mask
    ever_grown: Mask
    grown: Mask
    shows: Mask
    rule: NDArray[np.int64]
    error: Array

    @classmethod
    def start(cls, errors: Array, is_within: Mask) -> Self:
        """Return the state before the first sample, shapes (q, ..., n); nothing decays if all is within."""
        none = np.zeros(errors.shape[:-1], dtype=bool)
        is_good = np.broadcast_to(is_within[..., 0].all(axis=0), none.shape)
        return cls(none[0], none, none, is_good, none, np.full(none.shape, -1), errors[..., :1])


def _first(mask: Mask, already: Mask) -> NDArray[np.int64]:
    """Return the index of the first sample of a mask: 0 where it came already, n where it does not come."""
    index = np.where(mask.any(axis=-1), mask.argmax(axis=-1), mask.shape[-1])
    return np.where(already, 0, index)


def _errors(samples: Mapping[str, NDArray[Any]], scenario: Scenario) -> _Errors:
    """Return values and limits of the errors of LARGEST that exist, shapes (..., n) and (..., n, m)."""
    limits, cell = scenario.task, scenario.cell
    distances, angles = error_norms(samples)
    if "relative_error" in samples:  # a tool is off where it is so on the payload
        off = (norms.max(axis=-1) for norms in norms6(np.asarray(samples["relative_error"])))
        distances, angles = map(np.maximum, (distances, angles), off)
    axial, shear = (np.asarray(samples[f"internal_{part}_error"]) for part in ("axial", "shear"))
    f_d, m_d = norms6(np.asarray(samples["desired_internal_wrench"]))
    errors: _Errors = {
        "position": (distances, limits.position),
        "orientation": (angles, limits.orientation if cell.controls_turns else math.inf),
        "internal force": (np.hypot(axial, shear), np.maximum(limits.force, limits.force_share * f_d)),
        "internal moment": (
            moment_errors(samples, scenario),
            np.maximum(limits.moment, limits.moment_share * m_d),
        ),
    }
    is_alone = len(cell.arms) == 1  # without internal wrench
    return {cause: parts for cause, parts in errors.items() if not (is_alone and "internal" in cause)}


def moment_errors(samples: Mapping[str, NDArray[Any]], scenario: Scenario) -> Array:
    """Return the error of each arm's internal moment beyond what the weight asks, N m, shape (..., n, m).

    Components that no law controls, those outside the task rows and all at a patch, count beyond
    c_i m |g| |r_i| of the heaviest payload and the strongest gravity of the run; r_i is from P to the grasp.
    """
    cell, wrench = scenario.cell, np.asarray(samples["internal_wrench"])
    is_row = np.isin((3, 4, 5), cell.task_rows.indices)
    is_held = np.array([is_row & (name not in cell.patches) for name in cell.arms])
    is_held |= np.isnan(wrench.reshape(-1, *wrench.shape[-2:])[0, :, 3:])  # of these nothing is known
    if is_held.all():
        return np.asarray(samples["internal_moment_error"])
    error = np.nan_to_num(wrench - samples["desired_internal_wrench"])
    held, free = (norms6(error * np.pad(mask, ((0, 0), (3, 0))))[1] for mask in (is_held, ~is_held))
    around = [scenario.surroundings_at(time) for time in (0.0, *(event.time for event in scenario.events))]
    weight = max(float(each.mass * np.linalg.norm(each.gravity)) for each in around)
    levers = np.array([np.linalg.norm(cell.grasps[name].matrix[:3, 3]) for name in cell.arms])
    shares = np.asarray(samples["load_share"]) if "load_share" in samples else cell.shares
    return np.hypot(held, np.maximum(free - weight * levers * shares, 0.0))
