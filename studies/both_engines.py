"""The comparison and the paper's experiment on both engines: medians side by side, and why they differ.

Runs what is missing in out/studies/both_engines, and writes the tables in studies/both_engines/, the blocks
of docs/studies/engines.md, and in the folder of the runs comparison.html, the explorer with both engines. A
trial that MuJoCo's plant does not have (palms) is left out.

Usage: python studies/both_engines.py [--cells NAME ...] [--duration SECONDS] [--seeds N] [--only ENGINE]
    [--out FOLDER] [--draw]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from claims_window import judged
from pages import markdown, write_block
from paper_claims import METRIC, plans

import coop_pin as cp
from coop_pin.comparison import Comparison, benchmark_scenario, controllers_for, standard_trials
from coop_pin.comparison.measures import measures
from coop_pin.comparison.trials import changes_of

HERE = Path(__file__).parent
DATA = HERE / "both_engines"
PAGE = HERE.parent / "docs" / "studies" / "engines.md"
ENGINES = {"auto": "Pinocchio", "mujoco": "MuJoCo"}
"""Engines as asked for, and what computes the motion; "auto" has compiled code of the same dynamics."""
CELLS = ("adept-anchored", "two-pandas-box", "three-ur5-plate")
LAWS = ("printed", "zeroed-leaky", "anchored", "computed-torque")
PAPER = ("printed, α = 0.002", "printed, α = 0.2", "zeroed leaky", "anchored")
MEASURES = {"tracking_rms_mm": "tracking", "axial_rms_N": "force"}
PAPER_MEASURES = {"position_mm": "tracking", "force_N": "force"}
COUNTS = ["runs", "finished", "kept"]
KEY = ["scenario", "law", "trial"]
ALIKE, FLOORS = 0.01, {"tracking": 1e-4, "force": 1e-3}
"""Part by which medians may differ without a reason, and smallest difference that has one, mm and N."""
PUSH_N = 1e-2
"""Push on the payload, N: about as far as a soft weld's force is off, a ten thousandth of the largest."""
FAR_MM = 100.0
"""Tracking error beyond which the payload has left its path, mm: about the length of the lines."""
PUBLISHED, PATCHED = "adept-paper", "held by palms"


def compared(engine: str, out: Path, cells: list[str], duration: float | None, seeds: int) -> pd.DataFrame:
    """Return the medians of the comparison on an engine: a row for each scenario, law and trial."""
    bases = [benchmark_scenario(cp.Scenario.load(cell)) for cell in cells]
    known = {name: None for base in bases for name in standard_trials(base) if name != PATCHED}
    execution = cp.Execution(workers=0, engine=engine, quiet=True)
    options: dict[str, Any] = {"duration": duration, "seeds": seeds, "execution": execution}
    table = cp.compare(cells, list(LAWS), list(known), out=out / engine, **options).table.reset_index()
    names = {"controller": "law"} | MEASURES
    return table.rename(columns=names)[[*KEY, *MEASURES.values(), *COUNTS]]


def published(engine: str, out: Path) -> pd.DataFrame:
    """Return the paper's experiment on an engine, in the same form."""
    plan = plans()["laws"]
    cases = {name: case for name, case in plan.cases["run"].items() if name.split(" | ")[0] in PAPER}
    plan = cp.SweepPlan(base=plan.base[PUBLISHED], cases={"run": cases}, metrics=(METRIC,))
    execution = cp.Execution(workers=0, engine=engine, quiet=True)
    table = cp.sweep(plan, out=out / f"paper-{engine}", execution=execution).table
    table[["law", "trial"]] = table["run"].str.split(" | ", regex=False, expand=True)
    ran = table.rename(columns=PAPER_MEASURES).assign(scenario=PUBLISHED, runs=1)
    counts = {"finished": (ran["status"] == "ok").astype(int), "kept": ran["task_kept"].astype(int)}
    return ran.assign(**counts)[[*KEY, *MEASURES.values(), *COUNTS]]


def joined(tables: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """Return a row for each scenario, law and trial, with the measures of both engines and what is apart."""
    first, second = (tables[engine].set_index(KEY) for engine in ENGINES)
    suffixes = ("", "_mujoco")
    both = first.merge(second, left_index=True, right_index=True, suffixes=suffixes).reset_index()
    for name in MEASURES.values():
        values = both[[name, f"{name}_mujoco"]].to_numpy(float)
        with np.errstate(invalid="ignore"):
            apart = np.abs(values[:, 0] - values[:, 1])
        both[f"{name}_apart"] = np.where(np.isinf(values).all(axis=1), 0.0, apart)
    return both


def is_apart(row: pd.Series) -> bool:
    """Return whether a median differs by more than it may without a reason."""
    apart = row[[f"{name}_apart" for name in MEASURES.values()]].to_numpy(float)
    return not (apart <= allowed(values_of(row))).all()  # NaN is apart, too


def reason(row: pd.Series, duration: float | None) -> str:
    """Return what makes a place differ, from runs of it with one thing changed.

    A sensitive law is told first: there a push on the payload that is too small to matter changes
    Pinocchio's measures as much. A difference that falls with a quarter of MuJoCo's step is the step's, one
    that grows with twice the time constant of the welds the welds', one that goes without friction the
    friction's. Where the payload left its path on both engines, none of these is told, but the numbers are.
    """
    scenario = scenario_of(row, duration)
    if (text := sensitivity(row, scenario)) is not None:
        return text
    steps, softness = scenario.clock.steps_per_tick, scenario.plant.mujoco.time_constant
    free = {f"cell.arms.{name}.friction": "none" for name in scenario.cell.arms}
    ours = values_of(row)
    other = {
        "step": (ours, {"clock.steps_per_tick": 4 * steps}),
        "weld": (ours, {"plant.mujoco.time_constant": 2.0 * softness}),
        "friction": (measured(scenario.override(free), "pinocchio"), free),
    }
    before = parts(ours, values_of(row, "_mujoco")).max()
    after = {
        name: parts(first, measured(scenario.override(fields), "mujoco")).max() / before
        for name, (first, fields) in other.items()
    }
    has_left = min(row["tracking"], row["tracking_mujoco"]) > FAR_MM
    found = ["divergence"] if has_left else [name for name, holds in CAUSES.items() if holds(after[name])]
    ratios = ", ".join(f"{name} {ratio:.2g}" for name, ratio in after.items())
    return f"{' and '.join(found) or 'none of them'} ({ratios})"


CAUSES: dict[str, Callable[[float], bool]] = {
    "step": lambda ratio: ratio < 0.5,
    "weld": lambda ratio: ratio > 1.4,
    "friction": lambda ratio: ratio < 0.3,
}
"""Whether a difference is due to each, by what is left of it."""


def sensitivity(row: pd.Series, scenario: cp.Scenario) -> str | None:
    """Return how far a push of PUSH_N along the first axis that suffices moves Pinocchio's own measures.

    It suffices if it moves each measure that is apart by half of the engines' difference. None if none does.
    """
    ours, events = values_of(row), [event.model_dump() for event in scenario.events]
    differ = np.abs(values_of(row, "_mujoco") - ours)
    pulse = {"kind": "wrench-pulse", "time": 0.0, "duration": scenario.duration}
    for axis, name in enumerate("xyz"):
        push = pulse | {"wrench": [PUSH_N * (axis == other) for other in range(6)]}
        pushed = scenario.override({"events": [push, *events]})
        moved = np.abs(measured(pushed, "pinocchio") - ours)
        if (moved >= 0.5 * differ)[differ > allowed(ours)].all():
            return f"sensitivity ({1e3 * PUSH_N:g} mN along {name}: {moved[0]:.2g} mm, {moved[1]:.2g} N)"
    return None


def scenario_of(row: pd.Series, duration: float | None) -> cp.Scenario:
    """Return the scenario of a place of the comparison, or of the paper's experiment."""
    if row["scenario"] == PUBLISHED:
        return plans()["laws"].part([f"{row['law']} | {row['trial']}"], "pinocchio").scenario(0)
    scenario = cp.Scenario.load(row["scenario"])
    base = benchmark_scenario(scenario, duration)
    law = controllers_for(scenario, [row["law"]])[row["law"]]
    return base.override(changes_of(base, standard_trials(base)[row["trial"]], law))


def measured(scenario: cp.Scenario, engine: str) -> np.ndarray:
    """Return tracking, mm, and force, N, of a run on an engine."""
    run = cp.run(scenario, engine=engine, warn=False)
    is_published = scenario.name == PUBLISHED
    values, names = (judged(run), PAPER_MEASURES) if is_published else (measures(run), MEASURES)
    return np.array([values[name] for name in names])


def values_of(row: pd.Series, suffix: str = "") -> np.ndarray:
    """Return tracking, mm, and force, N, of a row."""
    return row[[f"{name}{suffix}" for name in MEASURES.values()]].to_numpy(float)


def parts(ours: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return differences as parts of ours."""
    return np.abs(ours - others) / np.maximum(ours, 1e-12)


def allowed(values: np.ndarray) -> np.ndarray:
    """Return by how much measures may differ without a reason."""
    return np.maximum(ALIKE * values, list(FLOORS.values()))


def side_by_side(both: pd.DataFrame) -> str:
    """Return trials by laws with both engines' medians, tracking in mm and axial force in N."""
    laws = list(dict.fromkeys(both["law"]))
    rows = []
    for (scenario, trial), part in both.groupby(["scenario", "trial"], sort=False):
        cells = part.set_index("law")
        rows.append((f"`{scenario}`", str(trial), *(_cell(cells.loc[law]) for law in laws)))
    return markdown(("scenario", "trial", *(f"`{law}`" for law in laws)), rows)


def same_order(part: pd.DataFrame) -> dict[str, bool]:
    """Return whether both engines have the laws of a place in one order, by measure."""
    least = {name: floor / ALIKE for name, floor in FLOORS.items()}  # what rests has no order
    return {
        name: _order(part[name], least[name]) == _order(part[f"{name}_mujoco"], least[name])
        for name in MEASURES.values()
    }


def _order(values: pd.Series, least: float) -> tuple[float, ...]:
    """Return the ranks of the laws, those with less than the least value as equals."""
    return tuple(values.clip(lower=least).rank())


def _cell(row: pd.Series) -> str:
    """Return "tracking / force" of ours; MuJoCo's behind an arrow where three digits are not the same."""
    ours, others = (
        " / ".join(_rounded(row[f"{name}{suffix}"]) for name in MEASURES.values())
        for suffix in ("", "_mujoco")
    )
    return ours if ours == others else f"{ours} → {others}"


def _verdict(row: pd.Series) -> str:
    """Return whether the task was kept, on both engines."""
    words = ["kept" if row[f"kept{suffix}"] == row["runs"] else "not kept" for suffix in ("", "_mujoco")]
    return words[0] if words[0] == words[1] else " → ".join(words)


def _rounded(value: float) -> str:
    return f"{float(f'{value:.3g}'):g}" if np.isfinite(value) else "failed"


def summary(both: pd.DataFrame) -> str:
    """Return how far medians are apart, and how often the order of the laws is the same.

    Less than 0.01 mm and 0.1 N count as that.
    """
    places = both.groupby(["scenario", "trial"], sort=False)
    cells, lengths = (
        ", ".join(f"`{name}`" for name in dict.fromkeys(both["scenario"])),
        set(both["duration_s"]),
    )
    length = f"of {lengths.pop():g} s" if all(lengths) else "of their scenarios' own length"
    lines = [f"- {cells}: {int(both['runs'].sum())} runs on each engine, {length}."]
    for name in MEASURES.values():
        least = FLOORS[name] / ALIKE  # of smaller values no part is taken: what rests has none
        parts = (both[f"{name}_apart"] / both[name].clip(lower=least)).replace([np.inf], np.nan)
        same = [same_order(part)[name] for _, part in places]
        lines.append(
            f"- {name}: medians are apart by {parts.median():.1g} of the value, at most by {parts.max():.2g};"
            f" the same order of the laws in {sum(same)} of {len(same)} places."
        )
    return "\n".join(lines)


def blocks() -> dict[str, str]:
    """Return the blocks of the page, from the tables."""
    tables = {
        name: pd.read_csv(DATA / f"{name}.csv", keep_default_na=False) for name in ("comparison", "paper")
    }
    shown = {name: f"{summary(both)}\n\n{side_by_side(both)}" for name, both in tables.items()}
    rows = [
        (*(str(row[key]) for key in KEY), _cell(row), _verdict(row), row["reason"])
        for _, row in pd.concat(tables.values()).query("reason != ''").iterrows()
    ]
    table = markdown((*KEY, "tracking, mm / force, N", "task", "reason"), rows)
    return shown | {"reasons": table if rows else "No median is apart by more than that."}


def explorer(out: Path) -> None:
    """Write the explorer of both engines, and its table, from which the site's is written."""
    tables = []
    for engine, name in ENGINES.items():
        table = Comparison.load(out / engine).table.reset_index()
        table["controller"] += "" if engine == "auto" else f", {name}"
        tables.append(table)
    both = Comparison.of_cells(pd.concat(tables).set_index(["scenario", "controller", "trial"]))
    both.write_csv(DATA / "explorer.csv")
    both.write_html(out / "comparison.html")


def main() -> None:
    """Run what is missing, unless only told to draw, and write tables and blocks."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, help="of every run, s; the scenarios' own when omitted")
    parser.add_argument("--cells", nargs="+", default=list(CELLS), help="cells of the comparison")
    parser.add_argument("--seeds", type=int, default=5, help="of random trials")
    parser.add_argument("--out", type=Path, default=Path("out") / "studies" / "both_engines")
    parser.add_argument("--only", choices=list(ENGINES), help="run one engine, and write nothing")
    parser.add_argument("--draw", action="store_true", help="only write the blocks, from the tables")
    asked = parser.parse_args()
    if asked.only:
        compared(asked.only, asked.out, asked.cells, asked.duration, asked.seeds)
        published(asked.only, asked.out)
        return
    if not asked.draw:
        tables = {
            "comparison": {
                name: compared(name, asked.out, asked.cells, asked.duration, asked.seeds) for name in ENGINES
            },
            "paper": {name: published(name, asked.out) for name in ENGINES},
        }
        DATA.mkdir(exist_ok=True)
        for name, each in tables.items():
            both = joined(each)
            both["duration_s"] = asked.duration if name == "comparison" else None
            both["reason"] = [
                reason(row, asked.duration) if is_apart(row) else "" for _, row in both.iterrows()
            ]
            both.to_csv(DATA / f"{name}.csv", index=False, float_format="%.6g", lineterminator="\n")
        explorer(asked.out)
    for name, block in blocks().items():
        write_block(PAGE, name, block)


if __name__ == "__main__":
    main()
