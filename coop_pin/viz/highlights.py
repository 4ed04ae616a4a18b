"""Highlights of a run: its worst instants, one computed sentence, and the marks on its clock."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from coop_pin.description.events import MISSED
from coop_pin.description.scenario import Scenario
from coop_pin.results.breaches import Cause
from coop_pin.results.metrics import ORIENTATION_BAND_RAD, POSITION_BAND_M
from coop_pin.results.run_result import RunResult
from coop_pin.results.task import LARGEST, moment_errors
from coop_pin.results.window import PHASES, recovering

_SMALL_N, _SMALL_NM = 1.0, 0.1
"""Errors of the internal force and moment, N and N m, below which a run counts as having followed them."""

_ROUNDING_N = 1e-6
"""Force that counts as none, N."""

_NAMED_WITHIN_S = 1.0
"""Time after an event within which a sentence refers to it."""


class Instant(NamedTuple):
    """Instant of a run that is worth a look.

    Attributes:
        text: description of what happens then.
        time: s.
    """

    text: str
    time: float


def read_number(value: float) -> str:
    """Return a number as it is read: two digits, and no exponent from 100 on."""
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:.2g}"


def telling_instant(result: RunResult) -> Instant:
    """Return the instant of the largest error of the internal force, and what it means, as one sentence.

    If the force is followed, it is that of the internal moment. The decay of the start's errors is left out.

    Args:
        result: the run.
    """
    if math.isfinite(result.dropped_at):
        text = result.friction_text
        return Instant(f"{text[0].upper()}{text[1:]}.", result.dropped_at)
    data = result.data
    errors = [np.nan_to_num(data[f"internal_{part}_error"].values) for part in ("axial", "shear")]
    error = np.hypot(*errors).max(axis=1)
    time, decay = data["time"].values, _decay(result, "internal force")
    worst = int(np.argmax(np.where(time >= decay, error, -1.0)))
    moment, _, moment_text = _moment(result)
    arm, t = int(np.argmax(np.hypot(*errors)[worst])), float(time[worst])
    if error[worst] < _SMALL_N:
        text = f"the internal force stays within {error[worst]:.2g} N of what is wanted"
        t = float(time[moment]) if moment_text else t
        return Instant(f"From {decay:.3g} s on, {text}{moment_text}.", t)
    before = f" Not counted: the first {decay:.3g} s, in which errors of the start decay." * (decay > 0.0)
    when, text = _when(result.scenario, t), _force_text(result, worst, arm)
    after = f"{_motion(result, worst)}{moment_text}.{_allowed(result, worst, arm)}{before}"
    return Instant(f"{when} {text}; {after}", t)


def _force_text(result: RunResult, sample: int, arm: int) -> str:
    """Return the internal force of an arm at a sample as a clause: the part that is farther off."""
    axial, shear, desired, desired_shear, off_along, off_across = (
        float(np.nan_to_num(result.data[name].values[sample, arm]))
        for name in (
            "internal_axial",
            "internal_shear",
            "desired_internal_axial",
            "desired_internal_shear",
            "internal_axial_error",
            "internal_shear_error",
        )
    )
    at = _at(result.scenario, arm)
    if abs(off_along) >= abs(off_across):
        verb = "pull the payload apart" if axial > 0.0 else "squeeze the payload"
        force = f"{verb} with {read_number(abs(axial))} N{at}"
        does = force if abs(axial) > _ROUNDING_N else "do not squeeze the payload"
        goal = f"{'a pull' if desired > 0.0 else 'a squeeze'} of {read_number(abs(desired))} N"
        return f"the arms {does}, where {'none' if abs(desired) < _SMALL_N else goal} is wanted"
    force = f"the arms load the payload across with {read_number(shear)} N{at}"
    if desired_shear < _SMALL_N and abs(off_across) < 1.1 * shear:
        return f"{force}, where none is wanted"
    off = f"off by {read_number(abs(off_across))} N"
    return f"{force}, where {read_number(desired_shear)} N in another direction is wanted: {off}"


def events_text(result: RunResult) -> str:
    """Return what happened to arms and grasps of a run, as sentences; empty without such an event."""
    remarks = result.data.attrs.get(RunResult.REMARKS, "").splitlines()
    missed = [remark for remark in remarks if MISSED in remark]
    texts = [
        f"{event.outcome}{_holders(result.scenario, event, missed)}"
        for event in sorted(result.scenario.events, key=lambda event: event.time)
        if event.outcome and event.time <= result.end
        if not any(event.is_named(remark) for remark in missed)
    ]
    sentences = [*["; ".join(texts)][: len(texts)], *missed]
    return " ".join(f"{sentence[:1].upper()}{sentence[1:]}." for sentence in sentences)


def _holders(scenario: Scenario, event: Any, missed: list[str]) -> str:
    """Return which arms hold the payload after a grasp event, if it is one, in brackets."""
    if event not in scenario.grasp_events:
        return ""
    not_done = [other for other in scenario.grasp_events if any(other.is_named(remark) for remark in missed)]
    holds = scenario.grasp_plan_at(event.instant, not_done).holds
    names = [name for name, is_held in zip(scenario.cell.arms, holds, strict=True) if is_held]
    if len(names) in (0, len(holds)):
        return f" ({'all hold it' if names else 'no arm holds it'})"
    return f" ({' and '.join(map(repr, names))} hold{'s' * (len(names) == 1)} it)"


def _at(scenario: Scenario, arm: int) -> str:
    """Return at which arm something is, where the payload has more than two."""
    arms = list(scenario.cell.arms)
    return f" at arm {arms[arm]!r}" if len(arms) > 2 else ""


def _decay(result: RunResult, cause: Cause) -> float:
    """Return the time in which an error that the run starts with decays, s."""
    return float(result.monitor.counted_from[LARGEST[cause]])


def _allowed(result: RunResult, sample: int, arm: int) -> str:
    """Return which error of an arm's internal force the task allows at a sample, as a sentence."""
    limits, data = result.scenario.task, result.data
    desired = float(np.linalg.norm(np.nan_to_num(data["desired_internal_wrench"].values[sample, arm, :3])))
    allowed = f"{read_number(max(limits.force, limits.force_share * desired))} N"
    if recovering(data["time"].values[sample : sample + 1], result.scenario).any():
        return f" The task allows {allowed}, but any until {limits.recovery:g} s after an event."
    return f" The task allows {allowed}."


def _moment(result: RunResult) -> tuple[int, float, str]:
    """Return sample and size of the largest error of the internal moment, N m, and words for a large one.

    It is that of the task: of what no law controls, the part that the weight asks of the grasps is no error.
    """
    is_wanted = result.scenario.cell.task_rows.has_moments
    error = np.nan_to_num(moment_errors(result.arrays, result.scenario)).max(axis=1)
    decay = _decay(result, "internal moment")
    late = result.data["time"].values >= decay
    worst = int(np.argmax(np.where(late, error, -1.0)))
    if error[worst] > _SMALL_NM:
        verb = " is off by up to" if is_wanted else ", which no arm controls, reaches"
        return worst, float(error[worst]), f"; the internal moment{verb} {read_number(error[worst])} N m"
    whole = np.linalg.norm(np.nan_to_num(result.data["internal_wrench"].values[..., 3:]), axis=2).max(axis=1)
    most = float(np.where(late, whole, 0.0).max())
    bends = f"; its weight bends the payload between the grasps with up to {read_number(most)} N m"
    is_free = not is_wanted or bool(result.scenario.cell.patches)
    return worst, float(error[worst]), bends if is_free and most > _SMALL_NM else ""


class VerdictLine(NamedTuple):
    """Verdict on task or simulation.

    Attributes:
        text: the verdict, and why it is bad.
        is_good: whether task or simulation is as it should be.
        numbers: judged values, with the thresholds.
    """

    text: str
    is_good: bool
    numbers: str = ""


def verdict_lines(result: RunResult) -> list[VerdictLine]:
    """Return the verdicts on task and simulation."""
    task, is_sound = result.task, result.simulation_sound
    if not is_sound:
        return [VerdictLine(result.verdict(), is_good=False)]
    friction = f"; {result.friction_text}" if result.friction_text and task.state != "dropped" else ""
    text, _, numbers = task.text.partition(" (") if task.kept else (task.text, "", "")
    of_task = VerdictLine(f"{text}{friction}", task.kept, numbers.removesuffix(")"))
    return [of_task] if result.engine == RunResult.LOGGED else [of_task, _soundness(result)]


def _soundness(result: RunResult) -> VerdictLine:
    """Return the verdict on a sound simulation."""
    allowed, data, closed = result.scenario.trust, result.data, max(result.closure_error_max())
    stops = ["joints within their stops"] * bool(np.isfinite(data["position_upper"].values).any())
    closures = [f"grasps closed to {closed:.1g} m (allowed {allowed.closure_error:g})"] * (closed > 0.0)
    judged = (
        f"energy to {result.energy_balance_max():.1g} J ({allowed.energy_share:g} of the work)",
        f"condition number {data['jacobian_condition'].values.max():.2g} ({allowed.jacobian_condition:g})",
    )
    numbers = ", ".join((*closures, *judged, *stops))
    return VerdictLine("simulation sound: all checks passed", is_good=True, numbers=numbers)


def instants(result: RunResult) -> list[Instant]:
    """Return the instants that the page offers: start, events, largest error, worst parts, and end.

    Parts count where they are not wanted. Instants at the same time are one.
    """
    data, time = result.data, result.data["time"].values
    names = ("internal_axial", "internal_shear", "internal_axial_error", "internal_shear_error")
    axial, shear, off_along, off_across = (np.nan_to_num(data[name].values) for name in names)
    off, worst = np.hypot(off_along, off_across).max(axis=1), telling_instant(result).time
    happened = [event for event in result.scenario.events if event.time <= result.end]
    headings = Counter(event.heading for event in happened)
    events = [
        (event.heading + f" at {event.time:g} s" * (headings[event.heading] > 1), event.time)
        for event in happened
    ]
    events += [("dropped", result.dropped_at)] * math.isfinite(result.dropped_at)
    instants = [("start", 0.0), *sorted(events, key=lambda event: event[1])]
    error = off[int(np.abs(time - worst).argmin())]
    instants += [(f"largest error {read_number(error)} N", worst)] * bool(error > _SMALL_N)
    moment, size, _ = _moment(result)
    instants += [(f"largest moment error {read_number(size)} N m", float(time[moment]))] * bool(
        size > _SMALL_NM
    )
    for text, values, error in (
        ("worst squeeze", -axial, -off_along),
        ("worst pull", axial, off_along),
        ("worst shear", shear, off_across),
    ):
        unwanted = np.where(error > _SMALL_N, values, 0.0)
        sample, arm = np.unravel_index(unwanted.argmax(), unwanted.shape)
        if (size := float(unwanted[sample, arm])) > _SMALL_N:
            off_by = float(error[sample, arm])
            difference = f" (off by {read_number(off_by)} N)" * (size - off_by > _SMALL_N)
            text = f"{text} {read_number(size)} N{_at(result.scenario, int(arm))}{difference}"
            instants.append((text, float(time[sample])))
    merged: dict[float, list[str]] = {}
    for text, at in [*instants, ("end", result.end)]:
        merged.setdefault(at, []).append(text)
    return [Instant(", ".join(dict.fromkeys(texts)), at) for at, texts in merged.items()]


def spans(result: RunResult) -> list[dict[str, Any]]:
    """Return the events and the times of motion, for the page: kind, start, end (s) and text."""
    scenario = result.scenario
    events = [
        {
            "kind": "event",
            "start": event.time,
            "end": event.end,
            "text": event.text(scenario.surroundings_at(math.nextafter(event.time, -math.inf))),
        }
        for event in scenario.events
        if event.time <= result.end
    ]
    if math.isfinite(result.dropped_at):
        events.append({"kind": "event", "start": result.dropped_at, "end": result.end, "text": "dropped"})
    windows = [
        {"kind": "window", "start": window.start, "end": window.end, "text": PHASES["moving"]}
        for window in result.windows_of("moving")
    ]
    return [*windows, *events]


def _when(scenario: Scenario, time: float) -> str:
    """Return the time as the start of a sentence, with the latest event if that explains it."""
    text = f"At {time:.2f} s"
    before = [event for event in scenario.events if event.time <= time]
    if not before:
        return text
    event = max(before, key=lambda event: event.end)
    name, since = event.title, time - event.end
    if since > _NAMED_WITHIN_S:
        return text
    if abs(since) < 0.5 / scenario.clock.rate_hz:
        return f"{text}, as the {name} ends,"
    return f"{text}, while the {name} lasts," if since < 0.0 else f"{text}, {since:.2g} s after the {name},"


def _motion(result: RunResult, sample: int) -> str:
    """Return whether the motion gives the internal force away at a sample."""
    error = result.data["pose_error"].values[sample]
    distance, angle = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
    if distance <= POSITION_BAND_M and angle <= ORIENTATION_BAND_RAD:
        return f"nothing in the motion shows it (the payload is {1e3 * distance:.2g} mm off its path)"
    millimetres, milliradians = (read_number(1e3 * float(one)) for one in (distance, angle))
    return f"the payload is {millimetres} mm and {milliradians} mrad off its path"
