"""Newtons: the internal force that every cause makes, that of the law's shares, and what nothing explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from coop_pin.base.arrays import Array
from coop_pin.base.errors import MissingExtraError, TracingError
from coop_pin.description.scenario import Scenario
from coop_pin.identification.causes import Cause, Newtons, force_interval, ranked_causes
from coop_pin.identification.closure import ViewClosure
from coop_pin.identification.effects import Effects, effects
from coop_pin.identification.estimate import Fit, Parameter, Priors
from coop_pin.identification.excitation import best_excitation
from coop_pin.identification.filtering import Filtered
from coop_pin.identification.friction import DriveFriction
from coop_pin.identification.law_response import uncovered
from coop_pin.identification.payload import hand_weight
from coop_pin.identification.resimulation import CauseRuns
from coop_pin.identification.views import FRAME_AXES
from coop_pin.logs.record import Record

_SETTLED = 1.0
"""Time that the law is given at the start before what it leaves counts, s."""
_SIMULATED = 12
"""Most causes that are run as a whole."""
_NEAR = 0.02
"""Force near zero, at which intervals are shifted and not scaled, N."""
_REPEATS = 5.0
"""Samples after which what is left of a reading is taken to be independent."""


def newtons(
    closure: ViewClosure,
    record: Record,
    scenario: Scenario,
    kinematics: Fit,
    payload: Fit | None,
    friction: Sequence[DriveFriction],
    samples: Mapping[str, Filtered],
    priors: Priors,
) -> dict[str, Any]:
    """Return effects, causes and what they leave, as fields of Blame.

    By the formulas of the law where they cover it, else by runs with one cause alone.

    Args:
        closure: views of the arms.
        record: record of the arms.
        scenario: cell and law that ran.
        kinematics: estimate of the kinematics.
        payload: estimate of payload and wrists; None without wrenches.
        friction: friction of the drives.
        samples: filtered samples of all arms.
        priors: knowledge before the log.
    """
    seen = [one for one in friction if one.is_seen]
    parameters, x, covariance, prior = _estimates(closure, kinematics, payload, seen)
    reason, p = uncovered(scenario), len(kinematics.x)
    try:
        runs = _runs(scenario, parameters, seen, x, prior, record, closure) if reason else None
        made = effects(record, closure, scenario, parameters, seen) if runs is None else runs.effects
        causes = ranked_causes(made, x, covariance, prior, priors.forecast)
        views = force_interval(made.force[..., :p], x[:p], covariance[:p, :p], priors.forecast)
        if runs is not None:
            views, causes = _simulated(runs, views, causes, dict(zip(parameters, x, strict=False)))
    except (TracingError, MissingExtraError) as error:
        return {"uncovered": f"{reason}; and it cannot be simulated for them: {error}"}
    answer: dict[str, Any] = {"effects": made, "simulated": reason, "causes": causes, "views": views}
    answer["excitation"] = best_excitation(closure, kinematics, made, priors)
    if payload is not None:
        *left, share = _left(made, x, covariance, scenario, closure, samples)
        answer |= {"read": left[0], "unexplained": left[1], "share": share}
        ranked = [*causes, share] if share.low > 0.0 and share.is_known else causes
        answer["causes"] = tuple(sorted(ranked, key=lambda cause: -cause.newtons))
    return answer


def _estimates(
    closure: ViewClosure, kinematics: Fit, payload: Fit | None, friction: Sequence[DriveFriction]
) -> tuple[list[Parameter], Array, Array, Array]:
    """Return the parameters that make a force but friction; with it estimates, covariance and prior sds."""
    axes = {FRAME_AXES[k] for k in closure.rows.indices}
    fits = [(kinematics, [*range(len(kinematics.x))])]
    if payload is not None:
        is_wrist = [
            one.part == "hand" or (one.part == "wrist" and one.axis in axes) for one in payload.parameters
        ]
        fits.append((payload, [*np.flatnonzero(is_wrist)]))
    # of friction a factor of what was found is a parameter
    factors = [min(one.sd[1] / max(abs(one.coulomb), 1e-9), 1.0) ** 2 for one in friction]
    x = np.concatenate([*(fit.x[kept] for fit, kept in fits), np.ones(len(friction))])
    covariance = block_diag(*(fit.covariance[np.ix_(kept, kept)] for fit, kept in fits), np.diag(factors))
    prior = np.concatenate([*(fit.prior[kept] for fit, kept in fits), np.ones(len(friction))])
    return [fit.parameters[k] for fit, kept in fits for k in kept], x, covariance[: len(x), : len(x)], prior


def _runs(
    scenario: Scenario,
    parameters: Sequence[Parameter],
    friction: Sequence[DriveFriction],
    x: Array,
    prior: Array,
    record: Record,
    closure: ViewClosure,
) -> CauseRuns:
    p, first = len(parameters), next(iter(closure.arms))
    start, end = record.held_span

    def seen(times: Array) -> Array:
        return closure.view(first, np.clip(times, start, end)).pose[:, :3, 3]

    return CauseRuns(scenario, parameters, friction, x[:p], prior[:p], start, seen)


def _simulated(
    runs: CauseRuns,
    views: Newtons,
    causes: Sequence[Cause],
    values: Mapping[Parameter, float],
) -> tuple[Newtons, tuple[Cause, ...]]:
    """Return all views that differ and the causes by runs of each; intervals grow with them."""
    largest = [one for one in causes if one.members[0].part != "friction"][:_SIMULATED]
    sets = [{one: values[one] for one in cause.members} for cause in largest]
    sets.append({one: value for one, value in values.items() if one.part not in ("wrist", "hand")})
    *forces, together = runs.newtons(sets)
    run = [
        Cause(cause.members, *_scaled(cause[1:4], force), cause.sizes, cause.seen)
        for cause, force in zip(largest, forces, strict=True)
    ]
    rest = [cause for cause in causes if cause not in largest]
    return _scaled(views, together), tuple(sorted([*run, *rest], key=lambda cause: -cause.newtons))


def _scaled(forecast: Newtons, force: float) -> Newtons:
    """Return the force of a run with the interval of its forecast: shifted near zero, else in proportion."""
    factor = (force + _NEAR) / (forecast[0] + _NEAR)
    low, high = (max(factor * (end + _NEAR) - _NEAR, 0.0) for end in forecast[1:])
    return force, low, high


def _left(
    made: Effects,
    x: Array,
    covariance: Array,
    scenario: Scenario,
    closure: ViewClosure,
    samples: Mapping[str, Filtered],
) -> tuple[float, float, Cause]:
    """Return the internal force that wrists read, what is beyond its causes, and the cause of load shares.

    A law that parts the load by other shares than those of the cell leaves an internal force ``d_i F`` along
    the whole force F: d_i is fitted to what the other causes leave.
    """
    linear = [k for k in closure.rows.indices if k < 3]
    force, f_d, times = _read(scenario, closure, samples)
    total = force.sum(axis=1, keepdims=True)
    stated = np.array(scenario.cell.shares)
    internal = force - stated[:, None] * total
    at = np.clip(np.searchsorted(made.times, times), 0, len(made.times) - 1)
    reading, read = made.reading[at], internal - f_d
    left = internal - (f_d if made.without is None else made.without[at]) - reading @ x
    settled = times > times[0] + min(_SETTLED, np.ptp(times) / 2.0)
    left, total, reading, read = left[settled], total[settled][:, 0], reading[settled], read[settled]
    weight = total / max(float((total**2).sum()), 1e-12)
    shares = np.einsum("nk,nik->i", weight, left)
    left = left - shares[:, None] * total[:, None]
    noise = sum((one.noise[:3] ** 2).sum() for one in samples.values()) / 4.0
    rms, whole = (float((each**2).sum(axis=2).max(axis=1).mean()) for each in (left, read))
    arm = int(np.abs(shares).argmax())
    by_x = np.einsum("nk,nkp->p", weight, reading[:, arm])
    variance = _REPEATS * rms / len(linear) * float((weight**2).sum()) + by_x @ covariance @ by_x
    size = float(np.linalg.norm(total, axis=1).mean())
    newtons, half = size * abs(float(shares[arm])), 1.96 * size * float(np.sqrt(variance))
    members = tuple(Parameter(name, "load share", "", "") for name in closure.arms)
    sizes = tuple((stated + shares - stated * shares.sum()).tolist())
    share = Cause(members, newtons, max(newtons - half, 0.0), newtons + half, sizes, 1.0)
    norms = np.sqrt(np.maximum(np.array((whole, rms)) - noise, 0.0))
    return float(norms[0]), float(norms[1]), share


def _read(
    scenario: Scenario, closure: ViewClosure, samples: Mapping[str, Filtered]
) -> tuple[Array, Array, Array]:
    """Return the force that every wrist reads without its hand, the squeeze, world axes, and their times."""
    linear, grasps = [k for k in closure.rows.indices if k < 3], scenario.cell.grasps
    times = next(iter(samples.values())).time
    R = closure.view(next(iter(closure.arms)), times).pose[:, :3, :3]
    tips = []
    for name, one in samples.items():
        force = (one.wrench - hand_weight(scenario, closure.arms[name], one.q))[:, :3]
        tips.append(np.einsum("nij,njk,nk->ni", R, closure.tip(name, times)[:, :3, :3], force))
    f_d = np.array([scenario.squeeze.at(time, grasps)[:, :3] for time in times.tolist()])
    f_d = np.einsum("nij,naj->nai", R, f_d)
    return np.stack(tips, axis=1)[:, :, linear], f_d[:, :, linear], times
