"""Misuse of a log: swapped topics, other signs and units, by which reading of it fits."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from coop_pin.description.scenario import Scenario
from coop_pin.identification.closure import BEYOND, ViewClosure
from coop_pin.identification.estimate import Fit, Priors
from coop_pin.identification.filtering import MARGIN, Filtered
from coop_pin.identification.payload import payload_fit
from coop_pin.logs.record import Record
from coop_pin.results.finding import Finding

_APART_M, _APART_RAD = 0.05, 0.15
"""Mismatch of the views beyond which no error of a calibrated arm explains it."""
_CHI = 2.0
"""chi of the wrenches from which on other readings of them are tried."""


def kinematic_findings(closure: ViewClosure, record: Record) -> Iterator[Finding]:
    """Yield that the arms do not hold one object, and which reading of the joints would.

    Args:
        closure: views of the arms.
        record: record of the arms.
    """
    apart, angle = _apart(closure)
    if apart < _APART_M and angle < _APART_RAD:
        return
    remedy, hint = {}, "check topics, units, bases and grasps"
    readings = {"degrees": _scaled(record, np.pi / 180.0)} | _swapped(record)
    for name, reading in readings.items():
        try:
            off = _apart(ViewClosure(reading, closure.arms, Priors(), springs=closure.springs))
        except (ValueError, np.linalg.LinAlgError):
            continue
        if off[0] < _APART_M and off[1] < _APART_RAD:
            hint = f"read as {name}, they agree within {1e3 * off[0]:.2g} mm"
            remedy = {"log.angle": "deg"} if name == "degrees" else {}
    sentence = f"the arms see the payload {1e3 * apart:.3g} mm and {angle:.3g} rad apart; {hint}"
    yield Finding("log", "arms", "error", sentence, apart, _APART_M, remedy)


def _apart(closure: ViewClosure) -> tuple[float, float]:
    """Return the median mismatch of the views, m and rad."""
    r, linear = closure.mismatch(), np.tile(closure.rows.are_linear, len(closure.arms) - 1)
    norms = [
        np.median(np.linalg.norm(r[:, part], axis=1)) if part.any() else 0.0 for part in (linear, ~linear)
    ]
    return float(norms[0]), float(norms[1])


def _scaled(record: Record, factor: float) -> Record:
    arms = {name: replace(arm, position=factor * arm.position) for name, arm in record.arms.items()}
    return replace(record, arms=arms)


def _swapped(record: Record) -> dict[str, Record]:
    """Return the record with the joints of two arms swapped, by the text of it."""
    swapped = {}
    for a, b in itertools.combinations(record.arms, 2):
        arms = {**record.arms, a: record.arms[b], b: record.arms[a]}
        if record.arms[a].position.shape[1] == record.arms[b].position.shape[1]:
            swapped[f"joints of {a} and {b} swapped"] = replace(record, arms=arms)
    return swapped


def wrench_findings(
    fit: Fit,
    record: Record,
    scenario: Scenario,
    closure: ViewClosure,
    kinematics: Fit,
    samples: Mapping[str, Filtered],
    priors: Priors,
) -> Iterator[Finding]:
    """Yield that the wrenches do not carry the payload, and which signs or order of them would.

    Args:
        fit: estimate of payload and wrists.
        record: record of the arms.
        scenario: cell.
        closure: views of the arms.
        kinematics: estimate of their errors.
        samples: filtered samples of all arms.
        priors: knowledge before the log.
    """
    strain, arms = _strain(fit), closure.arms
    if strain < _CHI:
        return
    best, hint, remedy = (
        strain,
        "check signs, topics, tips, the payload's mass and the weights of hands",
        dict[str, int](),
    )
    for order in itertools.permutations(arms):
        for signs in itertools.product((1.0, -1.0), repeat=len(arms)):
            read = {
                name: samples[name]._replace(wrench=sign * samples[other].wrench)
                for name, other, sign in zip(arms, order, signs, strict=True)
            }
            taken = {
                name: replace(
                    record.arms[name],
                    wrench_time=record.arms[other].wrench_time,
                    wrench=sign * record.arms[other].wrench,
                )
                for name, other, sign in zip(arms, order, signs, strict=True)
            }
            other = payload_fit(replace(record, arms=taken), scenario, closure, kinematics, read, priors)
            other_strain = _strain(other)
            if other_strain < 0.5 * best:
                best = other_strain
                turned = [name for name, sign in zip(arms, signs, strict=True) if sign < 0.0]
                moved = [
                    f"the wrist of {b} fits the joints of {a}: wrists or joints are swapped"
                    for a, b in zip(arms, order, strict=True)
                    if a != b
                ]
                hint = "; ".join([*moved, *[f"the wrench of {name} has the other sign" for name in turned]])
                remedy = {f"log.arms.{name}.wrench_sign": -1 for name in turned} if not moved else {}
    severity = "error" if best < 0.5 * strain else "warning"
    sentence = (
        f"the wrenches do not carry the payload (chi {fit.chi:.3g}, {strain:.3g} with the priors): {hint}"
    )
    yield Finding("log", "wrench", severity, sentence, strain, _CHI, remedy)  # type: ignore[arg-type]


def _strain(fit: Fit) -> float:
    """Return the larger of chi and the root mean square of estimates in prior sds."""
    return max(fit.chi, float(np.sqrt(np.mean((fit.x / fit.prior) ** 2))))


def prior_findings(kinematics: Fit, payload: Fit | None) -> Iterator[Finding]:
    """Yield estimates that are far beyond what was thought possible: a wrong cell, or a prior too small.

    Args:
        kinematics: estimate of the kinematics.
        payload: estimate of payload and wrists.
    """
    for fit in (kinematics, payload):
        if fit is None:
            continue
        for arm, late in fit.late.items():
            if abs(late) > MARGIN:
                sentence = f"the clock of {arm} is {late:.3g} s late: take that off its stamps"
                yield Finding("log", f"{arm} clock", "error", sentence, late, MARGIN)
        far = np.abs(fit.x) / fit.prior
        worst = int(far.argmax())
        if far[worst] > BEYOND:
            one = fit.parameters[worst]
            sentence = (
                f"{one} would be {one.valued(fit.x[worst])}, {far[worst]:.1f} times its prior: state a"
                " larger prior, or the cell is another one (bases, grasps, payload, hands)"
            )
            yield Finding("log", str(one), "warning", sentence, float(far[worst]), BEYOND)
