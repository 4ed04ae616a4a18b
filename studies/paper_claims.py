"""What the 2007 paper got right: its five claims, each with the runs that judge it.

Runs the paper's experiment with the printed law at three alphas and three other laws under seven trials, and
over the force gain; finished runs are kept in out/studies/paper_claims. The whole curve over alpha is that of
studies/alpha.py. Writes the tables in studies/paper_claims, studies/losses.csv, the tables in
docs/studies/paper-claims.md, and docs/images/study-paper-claims.png.

Usage: python studies/paper_claims.py [--draw]
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import claims_figure
import claims_tables
import numpy as np
import pandas as pd
from pages import IMAGES, save_image, write_block

import coop_pin as cp
from coop_pin.comparison import Trial, controllers_for
from coop_pin.comparison.trials import changes_of

HERE = Path(__file__).parent
DATA = HERE / "paper_claims"
LOSSES = HERE / "losses.csv"
PAGE = HERE.parent / "docs" / "studies" / "paper-claims.md"
METRIC = "claims_window:judged"
PRINTED = {"printed, α = 0.002": 0.002, "printed, α = 0.2": 0.2, "printed, α = 0": 0.0}
"""The scenario's own law, and its alpha: as shipped, as it takes loads up, and without integral."""
LAWS = {
    "zeroed leaky": "zeroed-leaky",
    "anchored": "anchored",
    "computed torque, wrong model": "computed-torque-wrong-model",
}
"""Other laws, and their names in the table of controllers."""
BIAS, ALPHA = "cell.arms.left.calibration_error.tip.xyz", "controller.gains.sign_gain"
FORCE_GAIN = "controller.gains.force_gain"
LOAD = 100.0
"""Unknown constant force along y, N."""


def trials(scenario: cp.Scenario) -> dict[str, Trial]:
    """Return the paper's experiment and what is changed in it, by name."""
    events = [event.model_dump() for event in scenario.events]
    mass, end = scenario.cell.payload.mass, scenario.duration

    def also(**event: Any) -> Trial:
        return Trial({"events": [{"time": 0.0, **event}, *events]})

    wrench = [0.0, LOAD, 0.0, 0.0, 0.0, 0.0]
    return {
        "as published": Trial({}),
        "half the mass": also(kind="payload-change", mass=mass / 2),
        "twice the mass": also(kind="payload-change", mass=2 * mass),
        "three times the friction": Trial({}, friction=3.0),
        "unknown load": also(kind="wrench-pulse", duration=end, wrench=wrench),
        "bias 0.1 mm": Trial({BIAS: [1e-4, 0.0, 0.0]}),
        "bias 1 mm": Trial({BIAS: [1e-3, 0.0, 0.0]}),
    }


def laws(scenario: cp.Scenario) -> dict[str, dict[str, Any]]:
    """Return the descriptions of the laws: gains as shipped, none of them tuned for a trial."""
    own = scenario.controller.model_dump()
    printed = {law: own | {"gains": own["gains"] | {"sign_gain": alpha}} for law, alpha in PRINTED.items()}
    others = controllers_for(cp.Scenario.load("adept-anchored"), list(LAWS.values()), tuned=False)
    return printed | dict(zip(LAWS, others.values(), strict=True))


def plans() -> dict[str, cp.SweepPlan]:
    """Return the sweeps by name."""
    paper = cp.Scenario.load("adept-paper", {"sensors.wrist": {}})
    cases = {
        f"{law} | {name}": changes_of(paper, trial, controller)
        for law, controller in laws(paper).items()
        for name, trial in trials(paper).items()
    }
    quiet: dict[str, Any] = {
        "base": paper,
        "changes": {"events": [], "duration": 9.9875},
        "metrics": (METRIC,),
    }
    low_pass = {"controller.force_path": {"kind": "low-pass", "pole": 0.9}, "beyond_bound": True}
    filtered = quiet["changes"] | low_pass | {ALPHA: 0.0}
    return {
        "laws": cp.SweepPlan(base=paper, cases={"run": cases}, metrics=(METRIC,)),
        "force_gain": cp.SweepPlan(
            **quiet | {"changes": filtered}, axes={FORCE_GAIN: [0.0, 1.0, 3.0, 9.0, 15.0, 21.0]}
        ),
    }


def run(folder: Path) -> dict[str, pd.DataFrame]:
    """Run what is missing and return the tables."""
    found = {
        name: cp.sweep(plan, out=folder / name, execution=cp.Execution(workers=0))
        for name, plan in plans().items()
    }
    judged = found["laws"].table
    judged[["law", "trial"]] = judged["run"].str.split(" | ", regex=False, expand=True)
    numbers, shared = claims_tables.MEASURES, claims_tables.MEASURES[:-3]
    return {
        "laws": judged[["law", "trial", "status", "failure", *numbers]],
        "force_gain": found["force_gain"].table[[FORCE_GAIN, "status", "failure", *shared]],
        "series": pd.concat([series(found["laws"], law, trial) for law, trial in claims_figure.DRAWN]),
    }


def series(result: cp.SweepResult, law: str, trial: str) -> pd.DataFrame:
    """Return position and internal-force error of a run, as rms of every tenth of a second."""
    number = int(result.table.index[result.table["run"] == f"{law} | {trial}"][0])
    data = result.open(number).data.isel(time=slice(1, None))
    force = np.hypot(data.internal_axial_error, data.internal_shear_error).max("arm")
    position = 1e3 * np.sqrt((data.pose_error[:, :3] ** 2).sum("axis"))
    parts = {"position_mm": position.values, "force_N": force.values}
    bins = np.ceil(data.time.values * 10.0 - 1e-9) / 10.0
    rms = pd.DataFrame(parts).pow(2).groupby(bins).mean().pow(0.5).rename_axis("time_s").reset_index()
    return rms.assign(law=law, trial=trial)


def blocks(tables: Mapping[str, pd.DataFrame]) -> dict[tuple[Path, str], str]:
    """Return what the study writes, by page and name of its blocks."""
    return {
        (PAGE, "verdicts"): claims_tables.verdicts(curve(), pd.read_csv(HERE / "costs.csv")),
        (PAGE, "experiment"): claims_tables.experiment(tables["laws"]),
        (PAGE, "robustness"): claims_tables.robustness(tables["laws"]),
        (PAGE, "force gain"): claims_tables.force_gain(tables["force_gain"], FORCE_GAIN),
    }


def curve() -> pd.DataFrame:
    """Return medians of the printed law at 80 Hz over the starts: a row for each alpha."""
    runs = pd.read_csv(HERE / "alpha.csv")
    return runs[runs["rate_hz"] == 80.0].pivot(index="alpha", columns=["trial", "measure"], values="median")


def losses() -> pd.DataFrame:
    """Return the trials of the front in which the anchored law is not the best."""
    return claims_tables.losses(
        {cell: pd.read_csv(HERE / "front" / f"{cell}-judged.csv") for cell in ("adept", "panda")}
    )


def main() -> None:
    """Run what is missing, unless only told to draw; write the tables, the page's blocks and the figure."""
    if "--draw" not in sys.argv[1:]:
        for name, table in run(Path("out") / "studies" / "paper_claims").items():
            table.to_csv(DATA / f"{name}.csv", index=False, float_format="%.6g", lineterminator="\n")
    tables = {path.stem: pd.read_csv(path) for path in sorted(DATA.glob("*.csv"))}
    losses().to_csv(LOSSES, index=False, float_format="%.3g", lineterminator="\n")
    for (page, name), text in blocks(tables).items():
        write_block(page, name, text)
        print(text, end="\n\n")
    save_image(claims_figure.figure(tables | {"curve": curve()}, FORCE_GAIN), IMAGES / "study-paper-claims")


if __name__ == "__main__":
    main()
