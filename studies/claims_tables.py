"""Tables of the study of the paper's claims: verdicts and the numbers behind them, as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pages import markdown

PROMPT_S = 2.5
"""Claimed: about 2 s."""
GAMMA = 2.0
"""The pose gain of the runs, 1/s. It is ours: errors of position decay at this rate."""
SMALL_N, SMALL_MM = 0.1, 1.0
"""What counts as an internal force that has vanished, a hundredth of the desired one, and as tracking."""
TWICE = 2.0
"""Factor of the relative rules."""
MEASURES = (
    "settled_s",
    "settled_narrow_s",
    "position_mm",
    "force_N",
    "axial_N",
    "force_converged_s",
    "force_in_band_s",
    "end_position_mm",
    "end_force_N",
    "settled_again_s",
    "settled_again_narrow_s",
    "event_peak_mm",
)
"""Of claims_window; the last three are those of runs with the event."""
EXPERIMENT = {
    "settled_s": "settles to 5 mm and 5 mrad after, s",
    "settled_again_s": "again after the event, s",
    "event_peak_mm": "largest position error after the event, mm",
    "position_mm": "position error, 4 to 10 s, mm rms",
    "end_position_mm": "the same, last second",
    "force_N": "internal-force error, 4 to 10 s, N rms",
    "end_force_N": "the same, last second",
}
"""Rows of the table of the published experiment, and their names."""
NEW = "anchored"
SHOWN = (0.002, 0.2)
"""Alphas whose numbers stand beside a verdict: that of the experiment, and that which takes loads up."""
DYNAMICS = ("half the mass", "twice the mass", "three times the friction", "unknown load")
"""Trials that change the dynamics; the last one is a load, which the paper does not claim to bear."""
HOLDS, LARGE, PART, FAILS = "holds", "holds for α large enough", "holds in part", "does not hold"
"""Verdicts over the alphas of the curve: at all, from one on as the paper assumes, at others, at none."""


def written(value: float) -> str:
    """Return a number with two digits; what failed has none."""
    if not np.isfinite(value):
        return "never" if value > 0.0 else "fails"
    return f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2g}"


def seconds(value: float) -> str:
    """Return a time with its unit, or "never"."""
    return written(value) + (" s" if np.isfinite(value) else "")


def of(table: pd.DataFrame, measure: str, **place: Any) -> float:
    """Return a measure of the one row at a place."""
    chosen = table
    for column, value in place.items():
        chosen = chosen[chosen[column] == value]
    return float(chosen[measure].item())


def verdicts(curve: pd.DataFrame, costs: pd.DataFrame) -> str:
    """Return the five claims: what the paper assumes, and verdicts under rules with their numbers."""
    rows = []
    for number, claim in enumerate(claims(curve, costs), 1):
        for index, rule in enumerate(claim.rules):
            head = [f"{number}. {claim.text}", claim.assumes] if index == 0 else ["", ""]
            rows.append([*head, rule.text, f"**{rule.verdict}**", rule.found])
    return markdown(["claim", "the paper assumes", "rule", "verdict", "what the runs say"], rows)


class Rule(NamedTuple):
    """A rule and its verdict.

    Attributes:
        text: the rule.
        verdict: over the alphas of the curve; with a gain of ours that decides it.
        found: the numbers that decide it.
    """

    text: str
    verdict: str
    found: str


class Claim(NamedTuple):
    """A claim of the paper.

    Attributes:
        text: the claim and where it stands.
        assumes: what the paper assumes for it.
        rules: at least two rules, each a choice.
    """

    text: str
    assumes: str
    rules: tuple[Rule, ...]


def claims(curve: pd.DataFrame, costs: pd.DataFrame) -> list[Claim]:
    """Return the claims in the order of the page.

    Args:
        curve: medians of the printed law, a row for each alpha, by trial and measure.
        costs: of a tick.
    """
    return [tracking(curve), force(curve), gain(curve), robust(curve), cost(costs)]


def over_alpha(text: str, holds: pd.Series, shown: Callable[[float], str]) -> Rule:
    """Return a rule judged at every alpha, with its numbers at those that the pages show.

    Args:
        text: the rule.
        holds: whether it holds, by alpha.
        shown: returns the numbers at an alpha.
    """
    numbers = "; ".join(f"{shown(alpha)} at α = {alpha:g}" for alpha in SHOWN)
    some = f". It holds at α = {spans(holds)}" if holds.any() and not holds.all() else ""
    return Rule(text, verdict(holds), numbers + some)


def verdict(holds: pd.Series) -> str:
    """Return the verdict of a rule from whether it holds at each alpha, in rising order."""
    if holds.all() or not holds.any():
        return HOLDS if holds.all() else FAILS
    return LARGE if holds.is_monotonic_increasing else PART


def spans(holds: pd.Series) -> str:
    """Return where a rule holds, as runs of neighbouring alphas."""
    groups = (holds != holds.shift()).cumsum()
    runs = [part.index for _, part in holds.groupby(groups) if part.iloc[0]]
    return ", ".join(f"{run[0]:g} to {run[-1]:g}" if len(run) > 1 else f"{run[0]:g}" for run in runs)


def tracking(curve: pd.DataFrame) -> Claim:
    """Return the claim that errors of position are gone after about 2 s, and again after the event."""
    runs = curve["event"]

    def rule(band: str, kind: str) -> Rule:
        first, second = (runs[f"settled{part}{kind}_s"] for part in ("", "_again"))
        judged = over_alpha(
            f"within {band} {PROMPT_S:g} s after the start and after the event",
            np.maximum(first, second) <= PROMPT_S,
            lambda alpha: f"{seconds(first[alpha])} and {seconds(second[alpha])}",
        )
        gains = f" with our $\\gamma$ = {GAMMA:g}" if judged.verdict == FAILS else ""
        return judged._replace(verdict=judged.verdict + gains)

    return Claim(
        "Position errors vanish within about 2 s, and again after the event (section 4.2)",
        "exact kinematics, one $x$ for all arms",
        (rule("5 mm and 5 mrad", ""), rule("1 mm and 1 mrad", "_narrow")),
    )


def force(curve: pd.DataFrame) -> Claim:
    """Return the claim that internal-force errors vanish."""
    early, late = curve["quiet", "force_N"], curve["quiet", "end_force_N"]
    again = curve["event", "end_force_N"]
    fed_early, fed_late = (curve["K_f 9", measure] for measure in ("force_N", "end_force_N"))
    return Claim(
        "Internal-force errors go to zero in the experiment (observed in section 4.2); Theorem 3, that they"
        " always do, is refuted below",
        "exact kinematics, one $x$ and one $\\gamma$ for all arms, rigid grasps, $\\alpha$ and $K_d$ large"
        " enough; law (23) has $K_f$ > 0, here 0",
        (
            over_alpha(
                f"at most {SMALL_N:g} N rms from 4 to 10 s, and in the last second of 20 s after the event",
                np.maximum(early, again) <= SMALL_N,
                lambda alpha: f"{written(early[alpha])} N and {written(again[alpha])} N",
            ),
            over_alpha(
                "without event, the last second of 20 s has at most half of that from 4 to 10 s",
                late <= early / TWICE,
                lambda alpha: f"{written(late[alpha])} N of {written(early[alpha])} N",
            ),
            over_alpha(
                f"at most {SMALL_N:g} N in both, without event, at $K_f = 9$ behind a low-pass",
                np.maximum(fed_early, fed_late) <= SMALL_N,
                lambda alpha: f"{written(fed_early[alpha])} N and {written(fed_late[alpha])} N",
            ),
        ),
    )


def gain(curve: pd.DataFrame) -> Claim:
    """Return the claim that a larger force gain makes them converge faster."""

    def rule(measure: str, text: str) -> Rule:
        low, high = (curve[f"K_f {K_f:g}", measure] for K_f in (0.0, 9.0))
        return over_alpha(
            text,
            np.isfinite(high) & (low > 0.0) & (high <= low / TWICE),
            lambda alpha: f"{seconds(low[alpha])} at $K_f = 0$, {seconds(high[alpha])} at 9",
        )

    return Claim(
        "A larger $K_f$ makes them converge faster, at a rate in proportion to $K_f$ + 1 (after Theorem 3)",
        "the measured $f$ has no delay",
        (
            rule("force_in_band_s", f"$K_f = 9$ halves the time until the error stays below {SMALL_N:g} N"),
            rule("force_converged_s", "the same until it stays below twice the run's own rms"),
        ),
    )


def robust(curve: pd.DataFrame) -> Claim:
    """Return the claim that the law is robust whatever the dynamics, and rows of its own for a load."""
    calm = curve["quiet"]

    def largest(measure: str, trials: Sequence[str]) -> pd.Series:
        return curve.xs(measure, axis=1, level="measure")[list(trials)].max(axis=1)

    def rules(under: str, trials: Sequence[str]) -> tuple[Rule, Rule]:
        position, strain = (largest(measure, trials) for measure in ("position_mm", "force_N"))
        return (
            over_alpha(
                f"{under} at most {SMALL_MM:g} mm rms",
                position <= SMALL_MM,
                lambda alpha: f"{written(position[alpha])} mm",
            ),
            over_alpha(
                f"and at most {SMALL_N:g} N, at $K_f$ = 0",
                (position <= SMALL_MM) & (strain <= SMALL_N),
                lambda alpha: f"{written(strain[alpha])} N",
            ),
        )

    *dynamics, load = DYNAMICS
    position, strain = (
        largest(measure, [f"{name}, K_f 9" for name in dynamics]) for measure in ("position_mm", "force_N")
    )
    fed = over_alpha(
        f"and at most {SMALL_N:g} N, at $K_f$ = 9 behind a low-pass",
        (position <= SMALL_MM) & (strain <= SMALL_N),
        lambda alpha: f"{written(strain[alpha])} N",
    )
    factors = [largest(measure, dynamics) / calm[measure] for measure in ("position_mm", "force_N")]
    relative = over_alpha(
        f"at most {TWICE:g} times those of our undisturbed run, of position and force",
        np.maximum(*factors) <= TWICE,
        lambda alpha: " and ".join(f"{written(factor[alpha])}" for factor in factors) + " times",
    )
    return Claim(
        "It is robust in the face of varying dynamics (abstract)",
        "exact kinematics; masses, inertias and friction are unknown but bounded; no explicit compensation of"
        " external disturbances, but of viscous friction (section 3)",
        (
            *rules("under half or twice the payload's mass, or three times the friction,", dynamics),
            fed,
            relative,
            *(
                rule._replace(verdict=f"not a claim; {rule.verdict}")
                for rule in rules("under an unknown load of 100 N along $y$ from the start", [load])
            ),
        ),
    )


def cost(costs: pd.DataFrame) -> Claim:
    """Return the claim that the law is decentralised, cheap, and needs no force sensor."""
    counted, joints = costs.set_index(["controller", "joints"]), (3, 6, 7)

    def of_joints(name: str, column: str) -> list[float]:
        return [float(counted.loc[(name, number), column]) for number in joints]

    model, printed, least = (
        of_joints("computed-torque", "ratio"),
        of_joints("printed", "operations"),
        of_joints("payload-pd", "operations"),
    )
    ratios = [mine / other for mine, other in zip(printed, least, strict=True)]
    cheap, near = min(model) > 1.0, max(ratios) <= TWICE
    return Claim(
        "It is decentralised, cheap and portable, and needs no force sensor (conclusion)",
        "grasps that keep contact; without a force sensor $K_f = 0$",
        (
            Rule(
                "a tick takes less time than that of a law with a model",
                HOLDS if cheap else FAILS,
                f"computed torque takes {min(model):.1f} to {max(model):.1f} times as long",
            ),
            Rule(
                "at most twice the operations of the cheapest law without a wrench sensor, `payload-pd`",
                HOLDS if near else FAILS,
                "{:.0f}, {:.0f}, {:.0f} at 3, 6, 7 joints: ".format(*printed)
                + "{:.2f}, {:.2f}, {:.2f} times".format(*ratios),
            ),
        ),
    )


def experiment(runs: pd.DataFrame) -> str:
    """Return what each law does in the experiment as published."""
    mine = runs[runs["trial"] == "as published"]
    laws = list(mine["law"])
    rows = [[name, *(written(of(mine, key, law=law)) for law in laws)] for key, name in EXPERIMENT.items()]
    return markdown(["", *laws], rows)


def robustness(runs: pd.DataFrame) -> str:
    """Return position error, mm, and internal-force error, N, over 4 to 10 s, then the latter after 20 s."""
    laws = list(dict.fromkeys(runs["law"]))
    rows = []
    for trial, mine in runs.groupby("trial", sort=False):
        cells = []
        for law in laws:
            position, force, end = (
                of(mine, name, law=law) for name in ("position_mm", "force_N", "end_force_N")
            )
            cells.append(f"{written(position)} / {written(force)} / {written(end)}")
        rows.append([str(trial), *cells])
    return markdown(["trial", *laws], rows)


def force_gain(runs: pd.DataFrame, gain: str) -> str:
    """Return level and time of convergence of the internal force over the force gain."""
    columns = {
        "force_N": "internal force, N rms",
        "force_in_band_s": "below 0.1 N after, s",
        "force_converged_s": "below twice its own rms after, s",
    }
    rows = [
        ["$K_f$", *(f"{value:g}" for value in runs[gain])],
        *([title, *map(written, runs[name])] for name, title in columns.items()),
        ["rms × (1 + $K_f$), N", *map(written, runs["force_N"] * (1.0 + runs[gain]))],
    ]
    return markdown(rows[0], rows[1:])


def losses(front: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return every trial of the front in which another law is better by more than a tenth."""
    rows = []
    for cell, judged in front.items():
        for trial, mine in judged.groupby("trial", sort=False):
            laws = mine.set_index("law")
            if NEW not in laws.index:
                continue
            for measure in ("position_mm", "force_N"):
                own, best = laws.loc[NEW, measure], laws[measure].idxmin()
                if own > 1.1 * laws.loc[best, measure]:
                    rows.append((cell, trial, measure, own, laws.loc[best, measure], best))
    return pd.DataFrame(rows, columns=["cell", "trial", "measure", "anchored", "least", "law"])
