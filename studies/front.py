"""Tracking against internal force: nine laws, tuned with one budget, under all trials in two cells.

Each law is tuned in a moderate trial with a seed of its own, then judged in every trial: once where nothing
is random, else the median over the seeds. Finished runs are kept in out/studies/front, so an interrupted
command continues when it is repeated. Writes the tables in studies/front and the figures in docs/images.

Usage: python studies/front.py [--cells adept panda] [--seeds 10 10] [--out DIR] [--draw]
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import front_figures
import numpy as np

import coop_pin as cp
from coop_pin.base.errors import FieldError
from coop_pin.sweeps import Span
from coop_pin.urdf import find_urdf

HERE = Path(__file__).parent
DATA = HERE / "front"
TUNED_ON, TUNED_SEED = "all at once, moderate", 1000
SIZE, GENERATIONS = 6, 4
"""Runs in a generation, and generations after the first: 30 runs for each law, however many gains it has."""


class Cell(NamedTuple):
    """One of the two cells.

    Attributes:
        base: scenario, whose law is replaced.
        changes: of every run.
        urdf: of its arms.
        gains: of the printed law and of the payload-space law; their damping is at the same part of the bound
            of zero-order hold and is not tuned.
        printed: kind of the printed law.
        mass: payload mass that the own-wrench law is told, kg; a tenth less than the true one.
        faults: magnitudes of the trials that differ between the cells.
    """

    base: str
    changes: dict[str, Any]
    urdf: str
    gains: tuple[dict[str, Any], dict[str, Any]]
    printed: str
    mass: float
    faults: dict[str, float]


CELLS = {
    "adept": Cell(
        base="adept-anchored",
        changes={"events": [], "duration": 10.0, "sensors.wrist": {}},
        urdf="adept_3dof",
        gains=({"damping_gain": [60.0, 60.0, 10.0]}, {"sliding_gain": [800.0, 800.0, 40.0]}),
        printed="sliding-mode",
        mass=10.0,
        faults={"load": 100.0, "friction": 2.0, "lag": 5e-3, "rate": 200.0, "cutoff": 30.0},
    ),
    "panda": Cell(
        base="two-pandas-box",
        changes={
            "events": [],
            "duration": 3.0,
            "motion.start_time": 0.25,
            "motion.duration": 2.0,
            "sensors.wrist": {},
            "actuators.gravity_compensation": {},
        },
        urdf="panda",
        gains=(
            {"damping_gain": [38.0, 34.0, 34.0, 52.0, 10.0, 20.0, 10.0]},
            {"sliding_gain": [800.0, 800.0, 800.0, 60.0, 60.0, 60.0]},
        ),
        printed="sliding-mode-redundant",
        mass=2.7,
        faults={"load": 40.0, "friction": 1.0, "lag": 5e-4, "rate": 1000.0, "cutoff": 100.0},
    ),
}

GAMMA = ("controller.gains.pose_gain", 1.0, 8.0)
ALPHA = ("controller.gains.sign_gain", 1e-5, 1.0)
"""Of the integral of the sign: as small as serves the paper's experiment, and as large as takes loads up."""
K_I, G = ("controller.gains.sign_gain", 0.05, 1.0), ("controller.gains.anchor_gain", 0.02, 0.5)
LINEAR_K_I = ("controller.gains.sign_gain", 0.5, 10.0)
LEAK, WIDTH = ("controller.gains.leak", 0.05, 5.0), ("controller.switching.width", 0.01, 0.1)
LATE: dict[str, Any] = {"force_path": {"kind": "late"}}
LOW_PASS: dict[str, Any] = {"force_path": {"kind": "low-pass", "pole": 0.9}}
ZONE: dict[str, Any] = {
    "integral_dead_zone": [
        1.2e-3,
        2.4e-3,
    ],  # more than half of the largest bias of a tip, and of a turned base
    "switching": {"kind": "saturation", "width": 0.5},  # far from its edges, as a linear integral
}
SGN: dict[str, Any] = {"switching": {"kind": "sign"}}


class Law(NamedTuple):
    """A law.

    Attributes:
        printed: law (23), else the payload-space law.
        senses: whether it uses a wrist sensor.
        fields: of the controller.
        gains: that are fixed.
        tuned: fields with their lowest and highest values.
    """

    printed: bool
    senses: bool
    fields: dict[str, Any]
    gains: dict[str, float]
    tuned: tuple[tuple[str, float, float], ...]

    def controller(self, cell: Cell) -> dict[str, Any]:
        """Return the controller of a scenario, with tuned gains in the middle of their ranges."""
        gains = {"pose_gain": 2.0, "sign_gain": 0.2, "transient_rate": 5.0} | cell.gains[not self.printed]
        kind = cell.printed if self.printed else "payload-space"
        fields = self.fields | ({"payload_mass": cell.mass} if "payload_mass" in self.fields else {})
        return {"kind": kind, "gains": gains | self.gains} | fields


LAWS = {
    "printed, tuned": Law(True, False, SGN, {}, (GAMMA, ALPHA)),
    "printed, tuned, alpha 0": Law(True, False, SGN, {"sign_gain": 0.0}, (GAMMA,)),
    "printed, tuned, K_f": Law(
        True,
        True,
        SGN | LOW_PASS,
        {},
        (GAMMA, ALPHA, ("controller.gains.force_gain", 0.0, 8.0)),
    ),
    "payload, sgn": Law(False, False, SGN, {"leak": 0.0}, (GAMMA, ALPHA)),
    "payload, saturation": Law(
        False, False, {"switching": {"kind": "saturation", "width": 0.05}}, {"leak": 0.0}, (GAMMA, K_I, WIDTH)
    ),
    "zeroed leaky": Law(False, False, {"zero_at_grasp": True}, {}, (GAMMA, K_I, LEAK)),
    "dead zone": Law(False, False, ZONE, {}, (GAMMA, LINEAR_K_I)),
    "own wrench": Law(False, True, {"payload_mass": 0.0}, {}, (GAMMA, K_I, (G[0], 0.002, 0.2))),
    "anchored": Law(False, True, LATE | {"anchor_bias": "none"}, {}, (GAMMA, K_I, G)),
}


class Trial(NamedTuple):
    """A trial.

    Attributes:
        changes: of the scenario.
        random: whether anything in it is; then the median over the seeds counts.
        wrist: it changes only what wrist sensors say, and laws without one are not run.
    """

    changes: dict[str, Any]
    random: bool = False
    wrist: bool = False


def bias(metres: float) -> dict[str, Any]:
    """Return a bias of the first arm: its model has the tip too far along the tip's own x axis."""
    return {"cell.arms.left.calibration_error.tip.xyz": [metres, 0.0, 0.0]}


def trials(cell: Cell, heavy: Path) -> dict[str, Trial]:
    """Return the trials of a cell by name.

    Args:
        cell: the cell.
        heavy: URDF of its arm with all masses and inertias doubled.
    """
    run_end, faults = cell.changes["duration"], cell.faults

    def load(newton: float) -> dict[str, Any]:
        wrench = [0.0, newton, 0.0, 0.0, 0.0, 0.0]
        return {
            "events": [{"kind": "wrench-pulse", "time": 0.0, "duration": run_end, "wrench": wrench}],
        }

    def wrist(**errors: Any) -> dict[str, Any]:
        return {"sensors.wrist": errors}

    noise = {"force": 1.0, "moment": 0.05}
    encoder = {"resolution": 1e-5, "noise": 1e-5}
    arms = ("left", "right")
    friction = {
        f"cell.arms.{arm}.friction": {
            "viscous": 1.0,
            "coulomb": faults["friction"],
            "stiction": 1.5 * faults["friction"],
        }
        for arm in arms
    }
    rate = 80.0 if cell.base.startswith("adept") else 500.0
    moderate = (
        bias(1e-4) | load(0.2 * faults["load"]) | {"sensors.encoder": encoder} | wrist(noise=noise, delay=1)
    )
    compensation = {
        "weight compensated 5 % too much": Trial({"actuators.gravity_compensation.mass_error": 0.05})
    }
    return {
        "nominal": Trial({}),
        "bias 0.1 mm": Trial(bias(1e-4)),
        "bias 1 mm": Trial(bias(1e-3)),
        "unknown load": Trial(load(faults["load"])),
        "bias 0.1 mm and load": Trial(bias(1e-4) | load(faults["load"])),
        "one arm twice as heavy": Trial({"cell.arms.right.urdf": str(heavy)}),
        "base turned by 1 mrad": Trial({"cell.arms.left.calibration_error.base.rpy": [0.0, 0.0, 1e-3]}),
        "joint zeros off by 1 mrad": Trial({"cell.arms.left.calibration_error.joint_offset": 1e-3}),
        "holding torque 5 % off": Trial({"sensors.holding_torque_error": 0.05}),
        **(compensation if "actuators.gravity_compensation" in cell.changes else {}),
        "encoder noise": Trial({"sensors.encoder": encoder}, random=True),
        "velocity by differences": Trial(
            {
                "sensors.encoder": {"resolution": 1e-5},
                "sensors.velocity": {"kind": "difference", "cutoff_hz": faults["cutoff"]},
            }
        ),
        "wrist noise 1 N": Trial(wrist(noise=noise), random=True, wrist=True),
        "wrist offset 1 N, drift": Trial(
            {
                "arm_sensors.left": {
                    "wrist": {"offset": {"force": 1.0, "moment": 0.05}, "drift": {"force": 0.1}}
                }
            },
            wrist=True,
        ),
        "wrist at a quarter rate": Trial(wrist(rate_hz=rate / 4), wrist=True),
        "wrist 3 ticks late": Trial(wrist(delay=3), wrist=True),
        "wrist lost half-way, bias 1 mm": Trial(
            bias(1e-3) | wrist(lost=[[run_end / 2, run_end]]), wrist=True
        ),
        "friction, stiction": Trial(friction),
        "torque lag": Trial({"actuators.lag": faults["lag"]}),
        "torque rate limit": Trial({"actuators.rate_limit": faults["rate"]}),
        "5 % of ticks missed": Trial({"actuators.missed_ticks": 0.05}, random=True),
        "an arm loses its torque": Trial({"arm_actuators.right": {"torque_lost_at": run_end / 2}}),
        TUNED_ON: Trial(moderate, random=True),
    }


MEASURES = ("position_mm", "orientation_mrad", "force_N", "moment_Nm")
METRIC = "front_window:judged"


def doubled(urdf: str, folder: Path) -> Path:
    """Write the URDF of an arm with all masses and inertias doubled, and return its path."""
    import xml.etree.ElementTree as ElementTree

    tree = ElementTree.parse(find_urdf(urdf).path)
    for inertial in tree.iter("inertial"):
        for part in (*inertial.iter("mass"), *inertial.iter("inertia")):
            for name, value in part.attrib.items():
                part.set(name, repr(2.0 * float(value)))
    path = folder / f"{urdf}-twice-as-heavy.urdf"
    folder.mkdir(parents=True, exist_ok=True)
    tree.write(path)
    return path


def span(low: float, high: float) -> Span:
    """Return a range; one over more than three decades is searched in logarithms."""
    is_wide = low > 0.0 and high > 1e3 * low
    return Span(low=low, high=high, scale="log" if is_wide else "linear")


def tune(cell: Cell, law: Law, trial: Trial, folder: Path) -> cp.sweeps.TuneResult:
    """Search the gains of a law in the trial on which all laws are tuned."""
    scenario = cp.Scenario.load(cell.base, cell.changes | trial.changes | {"seed": TUNED_SEED})
    return cp.tune(
        scenario.override({"controller": law.controller(cell)}),
        {field: span(low, high) for field, low, high in law.tuned},
        minimize="cost",
        metrics=[METRIC],
        out=folder,
        generations=GENERATIONS,
        population=SIZE // len(law.tuned),
        execution=cp.Execution(workers=0),
    )


def medians(
    cell: Cell, law: Law, gains: Mapping[str, float], trial: Trial, seeds: int, folder: Path
) -> dict[str, Any]:
    """Return the medians of the measures of a law in a trial, how many runs failed, and why."""
    changes = {"controller": law.controller(cell)} | dict(gains) | trial.changes
    plan = cp.SweepPlan(
        base=cp.Scenario.load(cell.base, cell.changes),
        changes=changes,
        repeats=seeds if trial.random else 1,
        metrics=(METRIC,),
    )
    try:
        result = cp.sweep(plan, out=folder, execution=cp.Execution(workers=0, quiet=True))
    except FieldError:  # at or beyond a bound of its gains: refused before any run
        return {"runs": len(plan), "failed": len(plan), "why": "FieldError"} | dict.fromkeys(
            MEASURES, math.inf
        )
    row: dict[str, Any] = {"runs": len(plan), "failed": result.counts()["failed"]}
    row["why"] = result.failures[0].kind if result.failures else ""
    for name in MEASURES:
        values = result.values(name).values.ravel() if result.metric_names else np.full(len(plan), math.inf)
        row[name] = float(np.median(np.where(np.isfinite(values), values, math.inf)))
    return row


def rows_of(
    cell_name: str, laws: Sequence[str], seeds: int, out: Path
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the table that a row belongs to, "gains", "tuning" or "judged", and the row."""
    cell = CELLS[cell_name]
    tests = trials(cell, doubled(cell.urdf, out))
    for law_name in laws:
        law = LAWS[law_name]
        folder = out / cell_name / law_name.replace(",", "").replace(" ", "-")
        found = tune(cell, law, tests[TUNED_ON], folder / "tune")
        place = {"cell": cell_name, "law": law_name}
        for field, low, high in law.tuned:
            value = found.best.parameters[field]
            yield "gains", place | {"field": field, "value": value, "low": low, "high": high}
        position, force = (found.history.values(name).values.ravel() for name in ("position_mm", "force_N"))
        for x, y in zip(position, force, strict=True):
            yield "tuning", place | {"position_mm": float(x), "force_N": float(y)}
        for trial_name, trial in tests.items():
            if trial.wrist and not law.senses:
                continue
            where = folder / trial_name.replace(",", "").replace(" ", "-").replace("%", "percent")
            row = medians(cell, law, found.best.parameters, trial, seeds, where)
            print(f"{cell_name:6} {law_name:20} {trial_name:32}", row, flush=True)
            yield "judged", place | {"trial": trial_name} | row


def main() -> None:
    """Run what is missing, write the tables and draw the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", nargs="+", choices=CELLS, default=list(CELLS))
    parser.add_argument(
        "--seeds", nargs=2, type=int, default=(10, 10), help="of random trials, for each cell"
    )
    parser.add_argument(
        "--laws", nargs="+", choices=LAWS, default=list(LAWS), help="the others keep their rows"
    )
    parser.add_argument("--out", type=Path, default=Path("out") / "studies" / "front")
    parser.add_argument("--draw", action="store_true", help="only draw the figures from the tables")
    asked = parser.parse_args()
    if not asked.draw:
        seeds = dict(zip(CELLS, asked.seeds, strict=True))
        for cell in asked.cells:
            tables: dict[str, list[dict[str, Any]]] = {"gains": [], "tuning": [], "judged": []}
            for table, row in rows_of(cell, asked.laws, seeds[cell], asked.out):
                tables[table].append({name: digits(value) for name, value in row.items()})
            for table, new in tables.items():
                rows = merged(DATA / f"{cell}-{table}.csv", new)
                with (DATA / f"{cell}-{table}.csv").open("w", newline="", encoding="utf-8") as file:
                    writer = csv.DictWriter(file, rows[0], lineterminator="\n")
                    writer.writeheader()
                    writer.writerows(rows)
    print(front_figures.numbers(DATA))
    front_figures.draw(DATA, HERE.parent / "docs" / "images")


def merged(file: Path, new: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of a table with those of some laws replaced, in the order of the laws."""
    with file.open(newline="", encoding="utf-8") as lines:
        kept = [row for row in csv.DictReader(lines) if row["law"] not in {each["law"] for each in new}]
    return sorted([*kept, *new], key=lambda row: list(LAWS).index(row["law"]))


def digits(value: Any) -> Any:
    """Return a number with six digits; anything else as it is."""
    return f"{value:.6g}" if isinstance(value, float) else value


if __name__ == "__main__":
    main()
