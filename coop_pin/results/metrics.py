"""Metrics of a run: settling time, tracking error, internal force, energy balance.

Functions of a run's arrays by name, such as its dataset; those that average state their window. The arrays
may have axes before that of time, such as the runs of a batch with the same times; so have the metrics then.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.spatial import norms6
from coop_pin.description.scenario import Scenario
from coop_pin.results.energies import energy_balance
from coop_pin.results.quantity import Arrays
from coop_pin.results.window import PHASES, SETTLING_S, EventWindows, Window, phases, samples_of

POSITION_BAND_M = 5e-3
ORIENTATION_BAND_RAD = 5e-3
_ROUNDING, _TRACE_ROUNDING = 1e-9, 1e-12
"""Rounding of times, s, and of traces of rotations."""
DRIFT_S, REST = 1.0, 1e-3
"""Time over which joints drift, s, and speed at which the payload rests in any case, m/s and rad/s."""

PHASE_METRICS = {
    "position_rms_m": ("position error, rms", "mm", 1e3),
    "orientation_rms_rad": ("orientation error, rms", "mrad", 1e3),
    "internal_axial_mean_N": ("internal force along the line between the tips, mean", "N", 1.0),
    "internal_axial_rms_error_N": ("internal force along the line, rms of its error", "N", 1.0),
    "internal_shear_rms_N": ("internal force across the line, rms of its error", "N", 1.0),
    "internal_moment_rms_error_Nm": ("internal moment about P, rms of its error", "N m", 1.0),
}
"""Metrics of a phase, which has its name in front, such as ``moving_position_rms_m``; as METRIC_TEXTS."""

_REASONS = {
    "moving": "it never moves, the start's decay and events apart",
    "rest": "it never rests, the start's decay and events apart",
    "after_event": "the run ends with it",
}
"""Reasons why a run has no sample of a phase."""
TOOL_METRICS = {
    "relative_position_error_max_m": ("position of a tool in the payload, largest error", "mm", 1e3),
    "relative_orientation_error_max_rad": ("orientation of a tool, largest error", "mrad", 1e3),
    "absolute_position_error_max_m": ("mean position of all tips, largest error", "mm", 1e3),
}
"""Metrics of arms with tools; as METRIC_TEXTS."""
SIMULATION_SOUND, TASK_KEPT = "simulation_sound", "task_kept"
"""Metrics of the two verdicts on a run: 1 or 0."""

METRIC_TEXTS = {
    "position_error_max_m": ("position error, largest", "mm", 1e3),
    "orientation_error_max_rad": ("orientation error, largest", "mrad", 1e3),
    "internal_force_error_max_N": ("internal force, largest error of an arm", "N", 1.0),
    "internal_moment_error_max_Nm": ("internal moment about P, largest error of an arm", "N m", 1.0),
    "settling_time_s": ("settles to 5 mm and 5 mrad after the start", "s", 1.0),
    "resettling_time_s": ("settles again after the first event", "s", 1.0),
    "event_peak_position_error_m": ("largest position error from the first event on", "mm", 1e3),
    "torque_peak_Nm": ("largest drive torque", "N m", 1.0),
    "joint_drift_rad": ("drift of a joint in the last second, the payload at rest", "mrad", 1e3),
    "closure_error_max_m": ("closure error, largest distance", "m", 1.0),
    "closure_error_max_rad": ("closure error, largest angle", "rad", 1.0),
    "energy_balance_max_J": ("energy minus work, largest", "J", 1.0),
    "squeeze_reserve_min_N": ("normal force of a patch or pad beyond what friction needs, least", "N", 1.0),
    "dropped_at_s": ("nothing holds the payload from", "s", 1.0),
    "sent_B": ("bytes that arms sent each other", "kB", 1e-3),
    **TOOL_METRICS,
}
"""Text of each metric, its unit as shown, and the scale from the SI value to that unit."""

METRIC_TEXTS |= {
    f"{phase}_{name}": (f"{text}, {when}", unit, scale)
    for phase, when in PHASES.items()
    for name, (text, unit, scale) in PHASE_METRICS.items()
}


def measure_text(name: str) -> str:
    """Return the text and unit of a metric, in which METRIC_TEXTS scales it; its name if it has none."""
    return f"{METRIC_TEXTS[name][0]} ({METRIC_TEXTS[name][1]})" if name in METRIC_TEXTS else name


def all_metrics(data: Arrays, scenario: Scenario, end: float, counted: Mask) -> dict[str, Any]:
    """Return all metrics by name but the verdicts and the largest errors; see RunResult.metrics.

    Args:
        data: arrays of a run, or of runs with the same times.
        scenario: scenario of the run, or of the first run.
        end: time at which the run ends, s.
        counted: mask of the samples after the decay of what the run starts with, shape (..., n).
    """
    events, turns = EventWindows.of(scenario, end), scenario.cell.controls_turns
    distance, angle = closure_error_max(data)
    masks = phases(data, scenario, counted)
    values = phase_metrics(data, [*masks.values()])
    return {
        "settling_time_s": settling_time(data, events.before, turns=turns),
        "resettling_time_s": resettling_time(data, events, turns=turns),
        "event_peak_position_error_m": event_peak_position_error(data, events),
        **{f"{phase}_{name}": x for phase, row in zip(masks, values, strict=True) for name, x in row.items()},
        "closure_error_max_m": distance,
        "closure_error_max_rad": angle,
        "energy_balance_max_J": np.abs(energy_balance(data)).max(axis=-1),
        "torque_peak_Nm": np.fmax.reduce(np.abs(np.asarray(data["torque"])), axis=(-3, -2, -1)),
        "joint_drift_rad": np.fmax.reduce(joint_drift(data, events), axis=(-2, -1)),
        **(
            {"sent_B": np.asarray(data["bytes_sent"])[..., -1, :].sum(axis=-1)}
            if "bytes_sent" in data
            else {}
        ),
        **(tool_metrics(data) if "relative_error" in data else {}),
    }


# ------------------------------------------------------------ tracking


def in_band(data: Arrays, *, turns: bool) -> Mask:
    """Return the mask of the samples with errors of at most 5 mm and 5 mrad, shape (..., n).

    Args:
        data: arrays of a run.
        turns: whether the task rows control the orientation; otherwise its error does not count.
    """
    if "pose_entries" in data and (inside := _in_band_by_trace(data, turns)) is not None:
        return inside
    distances, angles = error_norms(data)
    return np.asarray((distances <= POSITION_BAND_M) & ((angles <= ORIENTATION_BAND_RAD) | (not turns)))


def _in_band_by_trace(data: Arrays, turns: bool) -> Mask | None:
    """Return in_band by the trace of R R_d^T, 1 + 2 cos(angle): less work; None if rounding decides."""
    X, X_d = data["pose_entries"], data["desired_pose"]
    x, y, z = (X[i][3] - X_d[..., i, 3] for i in range(3))
    inside = np.asarray(np.sqrt(x * x + y * y + z * z) <= POSITION_BAND_M)
    trace = sum(X[i][j] * X_d[..., i, j] for i in range(3) for j in range(3)) if turns else 3.0
    excess = trace - (1.0 + 2.0 * math.cos(ORIENTATION_BAND_RAD))
    return inside & (excess > 0.0) if np.all(np.abs(excess) > _TRACE_ROUNDING) else None


def error_norms(data: Arrays) -> tuple[Array, Array]:
    """Return the norms of the position and orientation errors, m and rad, shapes (..., n)."""
    return norms6(np.asarray(data["pose_error"]))


def settling_time(data: Arrays, window: Window, *, turns: bool) -> Array:
    """Return the time from a window's start after which the errors stay in the band; inf if they do not.

    NaN for an empty window.
    """
    inside, time = samples_of(data, window), np.asarray(data["time"])
    out = inside & ~in_band(data, turns=turns)
    times = np.append(np.where(inside, time - window.start, np.inf), np.inf)
    settled = np.where(out.any(axis=-1), times[len(time) - np.argmax(out[..., ::-1], axis=-1)], 0.0)
    return np.where(window.is_empty, np.nan, settled)


def resettling_time(data: Arrays, events: EventWindows, *, turns: bool) -> Array:
    """Return the settling time after the first event, s; NaN without one, or if the band is not left."""
    if events.after is None:
        return np.array(np.nan)
    is_left = np.any(samples_of(data, events.after) & ~in_band(data, turns=turns), axis=-1)
    return np.where(is_left, settling_time(data, events.after, turns=turns), np.nan)


def event_peak_position_error(data: Arrays, events: EventWindows) -> Array:
    """Return the largest position error from the first event on, m; NaN without an event."""
    if events.after is None:
        return np.array(np.nan)
    return error_norms(data)[0][..., samples_of(data, events.after)].max(axis=-1, initial=0.0)


def phase_metrics(data: Arrays, masks: Sequence[Mask]) -> list[dict[str, Array]]:
    """Return PHASE_METRICS over the samples of each mask, shape (..., n); NaN if there are none."""
    squares = [np.square(values) for values in error_norms(data)]
    internal, rows = _internal_means(data), list[dict[str, Array]]()
    for mask in masks:
        forces: tuple[Any, ...] = _of_phase(internal, mask)
        rows.append(dict(zip(PHASE_METRICS, (*(_rms(x, mask) for x in squares), *forces), strict=True)))
    return rows


def _mean(values: Array, mask: Mask) -> Array:
    """Return the mean over the samples of a mask; NaN if there are none."""
    if not mask.any():
        return np.full(np.shape(mask)[:-1], np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(mask, values, 0.0).sum(axis=-1) / mask.sum(axis=-1))


def _rms(squares: Array, mask: Mask) -> Array:
    return np.sqrt(_mean(squares, mask))


# ------------------------------------------------------------ internal force


class InternalForceMetrics(NamedTuple):
    """Internal force over a window and over all arms; NaN for a single arm, which has none.

    The axial direction of an arm is the line from its own tip to the middle of the other tips: for two arms,
    the line between the tips.

    Attributes:
        axial_mean: mean force along the axial direction, N; negative where the arms squeeze.
        axial_rms_error: rms of its error, N.
        shear_rms: rms of the force error across the axial direction, N.
        moment_rms_error: rms of the moment error about P, N m.
    """

    axial_mean: float
    axial_rms_error: float
    shear_rms: float
    moment_rms_error: float

    @property
    def force_rms_error(self) -> float:
        """Rms of the force error, axial and shear together, N."""
        return math.hypot(self.axial_rms_error, self.shear_rms)


def internal_force(data: Arrays, mask: Mask) -> InternalForceMetrics:
    """Return the metrics of the internal wrench over the samples of a mask; arrays for several runs."""
    return _of_phase(_internal_means(data), mask)


def _internal_means(data: Arrays) -> list[Array]:
    """Return the axial force and the squares of axial, shear and moment errors, means over the arms."""
    axial, *errors = (
        np.asarray(data[f"internal_{part}"])
        for part in ("axial", "axial_error", "shear_error", "moment_error")
    )
    if len(data["arm"]) == 1:
        return [np.full(axial.shape[:-1], np.nan)] * 4
    return [axial.mean(axis=-1), *(np.square(values).mean(axis=-1) for values in errors)]


def _of_phase(means: Sequence[Array], mask: Mask) -> InternalForceMetrics:
    axial, *squares = means
    values: list[Any] = [_mean(axial, mask), *(_rms(x, mask) for x in squares)]
    return InternalForceMetrics(*values)


def tool_metrics(data: Arrays) -> dict[str, Array]:
    """Return the largest errors of the relative and the absolute pose of arms with tools by name."""
    position, angle = (norms.max(axis=(-2, -1)) for norms in norms6(np.asarray(data["relative_error"])))
    absolute = norms6(np.asarray(data["absolute_error"]))[0].max(axis=-1)
    return dict(zip(TOOL_METRICS, (position, angle, absolute), strict=True))


# ------------------------------------------------------------ energy


def closure_error_max(data: Arrays) -> tuple[Array, Array]:
    """Return the largest distance (m) and angle (rad) between a tip and its grasp."""
    distance, angle = (np.asarray(data[f"closure_{part}"]) for part in ("distance", "angle"))
    return np.fmax.reduce(distance, axis=(-2, -1)), np.fmax.reduce(angle, axis=(-2, -1))


def joint_drift(data: Arrays, events: EventWindows) -> Array:
    """Return how far all joints drift in the last second, rad or m, shape (..., m, k).

    NaN unless the reference rests since 4 s, after all events, and the payload moves at less than a tenth of
    what the joints do: joints that move are then the spare ones of redundant arms.
    """
    time, shape = np.asarray(data["time"]), np.shape(data["joint_position"])
    late, last = (time >= time[-1] - span - _ROUNDING for span in (SETTLING_S, DRIFT_S))
    rests = np.full(shape[:-3], events.last_end + SETTLING_S <= time[-1] - DRIFT_S)
    if rests.any():
        rests &= ~np.compress(late, np.asarray(data["desired_twist"]), axis=-2).any(axis=(-2, -1))
    if not rests.any():
        return np.full((*shape[:-3], *shape[-2:]), np.nan)
    speeds, twist = (np.asarray(data[name]) for name in ("joint_velocity", "payload_twist"))
    drift = DRIFT_S * np.abs(np.compress(last, speeds, axis=-3).mean(axis=-3))
    moved = np.abs(np.compress(last, twist, axis=-2).mean(axis=-2)).max(axis=-1)
    rests &= moved <= REST + np.fmax.reduce(drift, axis=(-2, -1)) / 10.0
    return np.where(rests[..., None, None], drift, np.nan)


# ------------------------------------------------------------ texts


def verdict_text(metrics: Mapping[str, float]) -> str:
    """Return the verdicts on task and simulation, of the metrics of a run, as text; "" if it has none."""
    words = {TASK_KEPT: ("task NOT kept", "task kept"), SIMULATION_SOUND: ("NOT sound", "sound")}
    texts = [words[name][metrics[name] == 1.0] for name in words if name in metrics]
    return ", simulation ".join(texts)


def metric_text(value: float) -> str:
    """Return a metric as text; a word stands for what is no number."""
    if math.isnan(value):
        return "does not apply"
    return "never" if math.isinf(value) else f"{value:.4g}"


def metric_lines(
    values: Mapping[str, float], windows_of: Callable[[str], tuple[Window, ...]], missing: Sequence[str]
) -> list[str]:
    """Return a line for each metric, with its windows, and what does not apply, with its reason.

    Args:
        values: metrics by name.
        windows_of: returns the windows of a metric.
        missing: phases that the run does not have.
    """
    absent = [name for name, value in values.items() if math.isnan(value)]
    lines = [
        f"  {name:<42} {metric_text(value):<14}  {', '.join(map(str, windows_of(name)))}"
        for name, value in values.items()
        if name not in absent
    ]
    if absent:
        lines.append(textwrap.fill(f"  does not apply: {', '.join(absent)}", 99, subsequent_indent="    "))
    return lines + [f"  no metrics {PHASES[phase]}: {_REASONS[phase]}" for phase in missing]
