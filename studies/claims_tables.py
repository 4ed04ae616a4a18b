"""Tables of the study of the paper's claims: verdicts and the numbers behind them, as Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from front_figures import TITLES
from pages import markdown

PROMPT_S = 2.5
"""Claimed: about 2 s."""
SMALL_N, SMALL_MM = 0.1, 1.0
"""What counts as an internal force that has gone, a hundredth of the desired one, and as tracking."""
MEASURES = (
    "settled_s",
    "position_mm",
    "force_N",
    "axial_N",
    "force_converged_s",
    "end_position_mm",
    "end_force_N",
    "settled_again_s",
    "event_peak_mm",
)
"""Of claims_window; the last two are those of runs with the event."""
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
PAPER, NEW = "printed", "anchored"
WORDS = {(True, True): "holds", (True, False): "holds in part", (False, False): "does not hold"}
"""Verdict by whether the first part of a claim holds, and all of it."""


def written(value: float) -> str:
    """Return a number with two digits; what failed has none."""
    if not np.isfinite(value):
        return "never" if value > 0.0 else "fails"
    return f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2g}"


def of(table: pd.DataFrame, measure: str, **place: Any) -> float:
    """Return a measure of the one row at a place."""
    chosen = table
    for column, value in place.items():
        chosen = chosen[chosen[column] == value]
    return float(chosen[measure].item())


def verdicts(
    tables: Mapping[str, pd.DataFrame], costs: pd.DataFrame, front: Mapping[str, pd.DataFrame]
) -> str:
    """Return the five claims with verdicts by the rules of ``rules``, and what each says of the new law."""
    rows = [
        [f"{number}. {claim}", f"**{WORDS[holds]}**", evidence, new]
        for number, (claim, holds, evidence, new) in enumerate(rules(tables, costs, front), 1)
    ]
    return markdown(["claim", "verdict", "what the runs say", "the new law (anchored)"], rows)


Rule = tuple[str, tuple[bool, bool], str, str]
"""A claim, whether its first part and all of it hold, and what says so of the paper's and of the new law."""


def rules(
    tables: Mapping[str, pd.DataFrame], costs: pd.DataFrame, front: Mapping[str, pd.DataFrame]
) -> list[Rule]:
    """Return the claims in the order of the page."""
    runs = tables["laws"]
    return [
        tracking_rule(runs),
        force_rule(runs),
        gain_rule(tables["force_gain"]),
        robust_rule(runs),
        cost_rule(costs, front),
    ]


def tracking_rule(runs: pd.DataFrame) -> Rule:
    """Errors of position are gone after about 2 s, and again after the event."""

    def said(law: str) -> tuple[float, float, str]:
        first, second, peak = (
            of(runs, name, law=law, trial="as published")
            for name in ("settled_s", "settled_again_s", "event_peak_mm")
        )
        text = f"{written(first)} s and {written(second)} s to 5 mm; {written(peak)} mm at the event"
        return first, second, text

    first, second, text = said(PAPER)
    prompt = first <= PROMPT_S, max(first, second) <= PROMPT_S
    return (
        "Position errors vanish within about 2 s, and again after the event (section 4.2)",
        prompt,
        text,
        said(NEW)[2],
    )


def force_rule(runs: pd.DataFrame) -> Rule:
    """Internal-force errors vanish."""

    def rms(law: str, trial: str = "as published", measure: str = "force_N") -> float:
        return of(runs, measure, law=law, trial=trial)

    with_integral, without = rms(PAPER), rms("printed, α = 0")
    ramp = rms(PAPER, "bias 0.1 mm", "end_force_N")

    def biased(law: str) -> str:
        early, late = rms(law, "bias 0.1 mm"), rms(law, "bias 0.1 mm", "end_force_N")
        course = "rising" if late > 1.2 * early else "not rising"
        return f"under 0.1 mm of bias {written(early)} N, after 20 s {written(late)} N, {course}"

    text = f"{written(with_integral)} N rms are left, {written(without)} N at α = 0; {biased(PAPER)}"
    new = f"{written(rms(NEW))} N; {biased(NEW)}"
    holds = without <= SMALL_N, max(with_integral, without, ramp) <= SMALL_N
    return "Internal-force errors converge to zero (Theorem 3)", holds, text, new


def gain_rule(runs: pd.DataFrame) -> Rule:
    """A larger force gain makes them converge faster."""
    table = runs.set_index(runs.columns[0])
    low, high = table.loc[0.0], table.loc[9.0]
    level = low["force_N"] / high["force_N"]
    faster = high["force_converged_s"] < 0.5 * low["force_converged_s"]
    beyond = table.iloc[-1]
    slow, quick = (written(row["force_converged_s"]) for row in (high, low))
    end = "diverges" if beyond["status"] == "failed" else "is stable"
    text = (
        f"$K_f = 9$ divides the error by {written(level)}, but takes {slow} s to come to that, $K_f = 0$"
        f" {quick} s; $K_f = {table.index[-1]:g}$ {end}"
    )
    new = "its anchor converges at the rate $g / T$, and has a bound, too"
    return "A larger $K_f$ makes them converge faster (after Theorem 3)", (faster, faster), text, new


def robust_rule(runs: pd.DataFrame) -> Rule:
    """It is robust whatever the dynamics."""
    dynamic = ("half the mass", "twice the mass", "three times the friction", "unknown load")

    def worst(law: str, measure: str) -> float:
        return max(of(runs, measure, law=law, trial=trial) for trial in dynamic)

    def said(law: str) -> str:
        position, force = worst(law, "position_mm"), worst(law, "force_N")
        return f"at most {written(position)} mm and {written(force)} N under other masses, friction and load"

    tracks = worst(PAPER, "position_mm") <= SMALL_MM
    holds_force = worst(PAPER, "force_N") <= SMALL_N
    return (
        "It is robust whatever the dynamics (abstract)",
        (tracks, tracks and holds_force),
        said(PAPER),
        said(NEW),
    )


def cost_rule(costs: pd.DataFrame, front: Mapping[str, pd.DataFrame]) -> Rule:
    """It is decentralised, cheap, needs no force sensor, and fits manipulators of all kinds."""
    counted = costs.set_index(["controller", "joints"])

    def operations(name: str) -> str:
        return ", ".join(f"{counted.loc[(name, joints), 'operations']:.0f}" for joints in (3, 6, 7))

    model = [counted.loc[("computed-torque", joints), "ratio"] for joints in (3, 6, 7)]
    panda = front["panda"].set_index(["law", "trial"])
    force = {law: panda.loc[(law, "nominal"), "force_N"] for law in ("printed, sgn", NEW)}
    text = (
        f"{operations('printed')} operations a tick at 3, 6, 7 joints; computed torque takes"
        f" {min(model):.1f} to {max(model):.1f} times as long; nothing crosses between arms at $K_f = 0$;"
        f" but two Pandas keep {written(force['printed, sgn'])} N of error"
    )
    new = (
        f"{operations('anchored')} operations, {written(force[NEW])} N on two Pandas; but every wrist is"
        " measured and its wrench sent to all arms"
    )
    claim = "It is decentralised, cheap and portable, and needs no force sensor (conclusion)"
    return claim, (min(model) > 1.0, force["printed, sgn"] <= SMALL_N), text, new


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


def alpha(runs: pd.DataFrame, gain: str, rate: str) -> str:
    """Return the internal-force error over alpha, N rms, by control rate."""
    table = runs.pivot(index=rate, columns=gain, values="force_N")
    rows = [
        [f"{hertz:g} Hz", *map(written, line)] for hertz, line in zip(table.index, table.values, strict=True)
    ]
    return markdown(["α", *(f"{value:g}" for value in table.columns)], rows)


def force_gain(runs: pd.DataFrame, gain: str) -> str:
    """Return level and time of convergence of the internal force over the force gain."""
    columns = {"force_N": "internal force, N rms", "force_converged_s": "within twice that after, s"}
    rows = [
        ["$K_f$", *(f"{value:g}" for value in runs[gain])],
        *([title, *map(written, runs[name])] for name, title in columns.items()),
        ["rms × (1 + $K_f$), N", *map(written, runs["force_N"] * (1.0 + runs[gain]))],
    ]
    return markdown(rows[0], rows[1:])


def losses(front: Mapping[str, pd.DataFrame]) -> str:
    """Return every trial of the front in which another law is better by more than a tenth."""
    rows = []
    for cell, judged in front.items():
        for trial, mine in judged.groupby("trial", sort=False):
            laws = mine.set_index("law")
            if NEW not in laws.index:
                continue
            for measure, unit in (("position_mm", "mm"), ("force_N", "N")):
                own, best = laws.loc[NEW, measure], laws[measure].idxmin()
                if own > 1.1 * laws.loc[best, measure]:
                    values = [f"{written(value)} {unit}" for value in (own, laws.loc[best, measure])]
                    rows.append([TITLES[cell], str(trial), values[0], values[1], str(best)])
    return markdown(["cell", "trial", "anchored", "least", "of"], rows)
