"""Make the log of this folder: two Pandas whose cell is not quite as its user believes, run on MuJoCo.

    python examples/real_pair/make_log.py

The right base stands 2 mm from where the cell has it, an encoder of the left arm is off by 0.5 mrad, the
left wrist a zero of 1.5 N, and the right arm's stamps are 3 ms late. ``cell.toml`` knows of none of it.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import coop_pin as cp
from coop_pin.logs.csv_log import write_csv
from coop_pin.logs.topics import table_of

FOLDER = Path(__file__).parent
FREE, LATE, OFF = 1.0, 3e-3, 2e-3
ZERO = np.array([0.0, 1.5, 0.0, 0.0, 0.0, 0.0])
POSES = [
    {"time": 0.5, "xyz": [0.0, 0.0, 0.4]},
    {"time": 3.0, "xyz": [0.05, 0.05, 0.45], "rpy": [0.2, 0.1, 0.2]},
    {"time": 4.5, "xyz": [-0.05, 0.08, 0.5], "rpy": [-0.2, 0.15, -0.1]},
    {"time": 6.0, "xyz": [0.05, -0.08, 0.42], "rpy": [0.1, -0.2, 0.25]},
    {"time": 8.0, "xyz": [-0.05, -0.05, 0.5], "rpy": [-0.1, -0.15, -0.2]},
    {"time": 10.0, "xyz": [0.0, 0.0, 0.4]},
]
NOISE = {"force": 0.5, "moment": 0.02}


def believed() -> cp.Scenario:
    """Return the cell as its user believes it."""
    sensors = {"encoder": {"resolution": 1e-5}, "wrist": {"noise": NOISE}}
    motion = {"kind": "waypoints", "points": POSES}
    cell = cp.Scenario.load("two-pandas-box", {"duration": 11.0, "motion": motion, "sensors": sensors})
    table = table_of(cell).replace(free=(0.1, FREE - 0.1), desired="")
    return cell.replace(name="real-pair", summary="Two Pandas, of which a log says what is off", log=table)


def real(cell: cp.Scenario) -> cp.Scenario:
    """Return the cell as it is; what its law believes is the other one."""
    right, sensors = cell.cell.arms["right"].base, cell.sensors.model_dump(exclude_none=True)
    moved = np.array(right.xyz) - right.matrix[:3, :3] @ (OFF, 0.0, 0.0)
    offset = [0.0, 0.0, 0.0, 5e-4, 0.0, 0.0, 0.0]
    wrist = sensors["wrist"] | {"offset": {"force": ZERO[:3].tolist()}}
    return cell.override(
        {
            "cell.arms.right.base.xyz": moved.tolist(),
            "cell.arms.right.calibration_error.base.xyz": [OFF, 0.0, 0.0],
            "arm_sensors.left": {"encoder": sensors["encoder"] | {"offset": offset}, "wrist": wrist},
            "clock.record_every": 5,
        }
    )


def logged(cell: cp.Scenario) -> cp.logs.Record:
    """Return the record of a run, behind an interval in which the hands were free."""
    record = cp.logs.Record.of_run(cp.run(real(cell), engine="mujoco", warn=False))
    rng, arms = np.random.default_rng(1), {}
    for name, arm in record.arms.items():
        before = np.arange(0.0, FREE, 0.01)
        n, late = len(before), LATE * (name == "right")
        reads = (name == "left") * ZERO + rng.normal(size=(n, 6)) * np.repeat((0.5, 0.02), 3)
        time = np.append(before, arm.time + FREE) + late
        arms[name] = replace(
            arm,
            time=time,
            position=np.vstack((np.tile(arm.position[0], (n, 1)), arm.position)).round(9),
            velocity=np.full((len(time), 7), np.nan),
            effort=np.vstack((np.tile(arm.effort[1], (n, 1)), arm.effort)).round(4),
            wrench_time=time,
            wrench=np.vstack((reads, arm.wrench)).round(4),
        )
    return replace(record, arms=arms)


if __name__ == "__main__":
    scenario = believed()
    scenario.save(FOLDER / "cell.toml", commented=True)
    write_csv(logged(scenario).topics(scenario), FOLDER / "log.csv")
