"""Five logs of two Pandas with one unknown cause each, for a person who has not seen the project.

    python tests/blame_logs.py FOLDER [SEED]

writes FOLDER/log_1.csv to log_5.csv, cell.toml, which knows of none of it, and FOLDER/.key.json, which does.
Arm, axis, size and order are drawn.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from log_cells import NOISE, free_hands, late_clocks, scenario_of

import coop_pin as cp
from coop_pin.compiled.simulate import simulate_batch
from coop_pin.identification.views import FRAME_AXES
from coop_pin.logs.csv_log import write_csv
from coop_pin.logs.topics import table_of

SIZES = {"base": 4e-3, "joint": 5e-3, "clock": 0.016, "wrist": 1.5, "share": 0.02}
"""Errors that cost about 0.5 N each, the clock 0.2 N: 0.04 s take the drives to their limits."""


def believed():
    """The cell as its user believes it: noise of the sensors, and a second of free hands in the log."""
    scenario = scenario_of("turning")
    sensors = {"encoder": {"resolution": 1e-5}, "wrist": {"noise": NOISE}}
    table = table_of(scenario).replace(free=(0.1, 0.9), desired="")
    changes = {"sensors": sensors, "clock.record_every": 5}
    return scenario.override(changes).replace(name="pair", summary="Two Pandas, one of them off", log=table)


def culprits(seed):
    """Five causes in a drawn order: part, arm, axis or number of the joint, and size."""
    rng = np.random.default_rng(seed)
    parts = [str(part) for part in rng.permutation([*SIZES])]
    sizes = [SIZES[part] * rng.uniform(0.8, 1.2) * rng.choice((-1.0, 1.0)) for part in parts]
    places = [
        (str(rng.choice(("left", "right"))), int(rng.integers(3)), int(rng.integers(1, 5))) for _ in parts
    ]
    return [
        (part, "right" if part == "clock" else arm, joint if part == "joint" else axis, float(size))
        for part, (arm, axis, joint), size in zip(parts, places, sizes, strict=True)
    ]


def real(cell, culprit):
    """The cell that has a cause, of which its law knows nothing, and the zeros and clocks of its log."""
    part, arm, at, size = culprit
    share, late, zero, counts = size * (part == "share"), size * (part == "clock"), np.zeros(6), np.zeros(7)
    changes = {}
    if part == "base":  # the arm stands elsewhere, and its law believes the cell
        off = np.eye(3)[at] * size
        base = cell.cell.arms[arm].base
        changes[f"cell.arms.{arm}.base.xyz"] = (np.array(base.xyz) - base.matrix[:3, :3] @ off).tolist()
        changes[f"cell.arms.{arm}.calibration_error.base.xyz"] = off.tolist()
    zero[at] = size * (part == "wrist")
    counts[at] = size * (part == "joint")
    for name in cell.cell.arms:
        reads, is_off = cell.sensors.model_dump(exclude_none=True), name == arm
        encoder = reads["encoder"] | {"offset": (is_off * counts).tolist()}
        wrist = reads["wrist"] | {"offset": {"force": (is_off * zero[:3]).tolist()}}
        changes[f"arm_sensors.{name}"] = {"encoder": encoder, "wrist": wrist}
    changes["network"] = {"clocks": {"right": {"offset": late}}}
    changes["cell.load_shares"] = {"left": 0.5 + share, "right": 0.5 - share}
    causes = {(name, "wrist"): (name == arm) * zero for name in cell.cell.arms}
    causes |= {(name, "clock"): np.array([(name == "right") * late]) for name in cell.cell.arms}
    return causes, cell.override(changes)


def named(culprit):
    """The culprit as the answer names it."""
    part, arm, at, size = culprit
    joints = [f"panda_joint{k}" for k in range(1, 8)]
    axis = {"joint": joints, "clock": [""] * 3, "share": [""] * 3}.get(part, list(FRAME_AXES))[at]
    return {"part": part, "arm": arm, "axis": axis, "size": size}


def main(folder, seed):
    folder, cell = Path(folder), believed()
    folder.mkdir(parents=True, exist_ok=True)
    cell.save(folder / "cell.toml", commented=True)
    drawn_causes = culprits(seed)
    made = [real(cell, culprit) for culprit in drawn_causes]
    batch = simulate_batch([scenario.override({"seed": seed + k}) for k, (_, scenario) in enumerate(made)])
    for k, (causes, _) in enumerate(made):
        record = free_hands(cp.logs.Record.of_run(batch.result(k)), causes, np.random.default_rng(seed + k))
        record = late_clocks(record, causes)
        arms = {
            name: replace(arm, velocity=np.full_like(arm.velocity, np.nan))
            for name, arm in record.arms.items()
        }
        write_csv(replace(record, arms=arms).topics(cell), folder / f"log_{k + 1}.csv")
    (folder / ".key.json").write_text(json.dumps([named(one) for one in drawn_causes], indent=1))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 62)
