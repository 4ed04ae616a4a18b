"""Logs of made-up arms: runs with drawn causes, as the arms would log them."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

import coop_pin as cp
from coop_pin.compiled.simulate import simulate_batch
from coop_pin.identification.views import FRAME_AXES

NOISE = {"force": 0.5, "moment": 0.02}
COUNT = 1e-5
TURNS = ((0, 0, 0), (0.2, 0.1, 0.2), (-0.2, 0.15, -0.1), (0.1, -0.2, 0.25), (-0.1, -0.15, -0.2), (0, 0, 0))
SHIFTS = (
    (0, 0, 0),
    (0.05, 0.05, 0.05),
    (-0.05, 0.08, 0.1),
    (0.05, -0.08, 0.02),
    (-0.05, -0.05, 0.1),
    (0, 0, 0),
)
TIMES = (0.5, 3.0, 4.5, 6.0, 8.0, 10.0)
RICH = {
    "duration": 11.0,
    "motion": {
        "kind": "waypoints",
        "points": [
            {"time": time, "xyz": [x, y, 0.4 + z], "rpy": list(turn)}
            for time, (x, y, z), turn in zip(TIMES, SHIFTS, TURNS, strict=True)
        ],
    },
}
PLANAR = {
    "duration": 11.0,
    "motion": {
        "kind": "waypoints",
        "points": [
            {"time": time, "xyz": [0.6 + x, 0.146 + y, 0.0], "rpy": [0.0, 0.0, 0.947 + turn]}
            for time, (x, y, _), (_, _, turn) in zip(TIMES, SHIFTS, TURNS, strict=True)
        ],
    },
}
SDS = {
    "tip": 5e-4,
    "base": 1e-3,
    "joint": 5e-4,
    "clock": 3e-3,
    "force": 2.0,
    "moment": 0.1,
    "mass": 0.1,
    "centre": 1e-2,
}


def scenario_of(kind):
    """The cells: two Pandas on their line or turning, the planar pair on its line or turning."""
    if kind == "adept":
        return cp.Scenario.load("adept-anchored", {"events": []})
    if kind == "adept turning":
        return cp.Scenario.load("adept-anchored", {"events": []} | PLANAR)
    return cp.Scenario.load("two-pandas-box", RICH if kind == "turning" else {})


def drawn(rng, scenario, scales):
    """Causes of every arm by (arm, part), as the parameters of a fit have them; scales by part."""
    planar, causes = scenario.cell.rows == "planar", {}
    for name in scenario.cell.arms:
        n = 3 if planar else 7
        for part in ("tip", "base"):
            causes[name, part] = rng.normal(0.0, SDS[part] * scales.get(part, 1.0), 6)
        causes[name, "joint"] = rng.normal(0.0, SDS["joint"] * scales.get("joint", 1.0), n)
        causes[name, "link"] = rng.normal(0.0, scales.get("link", 0.0), n)
        sds = np.repeat((SDS["force"], SDS["moment"]), 3) * scales.get("wrist", 1.0)
        causes[name, "wrist"] = rng.normal(0.0, sds)
        causes[name, "clock"] = rng.normal(0.0, SDS["clock"] * scales.get("clock", 1.0), 1)
        if planar:
            for part in ("tip", "base", "wrist"):
                causes[name, part][2:5] = 0.0
    causes[next(iter(scenario.cell.arms)), "clock"][:] = 0.0
    causes["", "mass"] = rng.normal(0.0, SDS["mass"] * scales.get("mass", 1.0), 1)
    causes["", "centre"] = rng.normal(0.0, SDS["centre"] * scales.get("centre", 1.0), 3)
    if planar:
        causes["", "centre"][2] = 0.0
    return causes


def with_causes(scenario, causes):
    """The scenario whose plant has a payload, and whose arms have models and wrists, that are off.

    Where the centre is elsewhere, grasps and the start are about it, and what the arms see of it is that of
    the believed grasps: X_EP_seen = T X_EP.
    """
    payload, centre = scenario.cell.payload, causes["", "centre"]
    heavier = 1.0 + float(causes["", "mass"][0])
    start = scenario.start.matrix
    changes = {
        "cell.payload.mass": heavier * payload.mass,
        "cell.payload.inertia": [heavier * value for value in payload.inertia],
        "start.xyz": (start[:3, 3] + start[:3, :3] @ centre).tolist(),
    }
    for name in scenario.cell.arms:
        grasp = scenario.cell.grasps[name]
        changes[f"cell.grasps.{name}.xyz"] = (np.array(grasp.xyz) - centre).tolist()
        poses = {
            part: {"xyz": causes[name, part][:3].tolist(), "rpy": causes[name, part][3:].tolist()}
            for part in ("tip", "base")
        }
        R_ET = pin.rpy.rpyToMatrix(causes[name, "tip"][3:])
        poses["tip"]["xyz"] = (causes[name, "tip"][:3] - R_ET @ grasp.matrix[:3, :3].T @ centre).tolist()
        rest = {
            "joint_offset": causes[name, "joint"].tolist(),
            "link_length": causes[name, "link"].tolist(),
        }
        changes[f"cell.arms.{name}.calibration_error"] = poses | rest
        zero = causes[name, "wrist"].tolist()
        wrist = {"noise": NOISE, "offset": {"force": zero[:3], "moment": zero[3:]}}
        changes[f"arm_sensors.{name}"] = {"encoder": {"resolution": COUNT}, "wrist": wrist}
    return scenario.override(changes)


def believed(scenario, causes, changed):
    """The cell of ``with_causes`` as its user believes it: payload, centre, grasps and start of the first."""
    changes = {"cell.payload": scenario.cell.payload, "cell.grasps": scenario.cell.grasps}
    changes["start"] = scenario.start
    for name in scenario.cell.arms:
        changes[f"cell.arms.{name}.calibration_error.tip.xyz"] = causes[name, "tip"][:3].tolist()
    return changed.override(changes)


def free_hands(record, causes, rng, duration=1.0):
    """The record behind an interval at rest in which the wrists read their zeros."""
    step = float(np.median(np.diff(next(iter(record.arms.values())).time)))
    before = np.arange(0.0, duration, step)
    arms = {}
    for name, arm in record.arms.items():
        n, sds = len(before), np.repeat((NOISE["force"], NOISE["moment"]), 3)
        zero = causes[name, "wrist"] + rng.normal(size=(n, 6)) * sds
        arms[name] = replace(
            arm,
            time=np.append(before, arm.time + duration),
            position=np.vstack((np.tile(arm.position[0], (n, 1)), arm.position)),
            velocity=np.vstack((np.zeros((n, arm.velocity.shape[1])), arm.velocity)),
            effort=np.vstack((np.tile(arm.effort[1], (n, 1)), arm.effort)),
            wrench_time=np.append(before, arm.wrench_time + duration),
            wrench=np.vstack((zero, arm.wrench)),
        )
    free = (0.1 * duration, 0.9 * duration)
    return replace(record, arms=arms, desired_time=record.desired_time + duration, free=free)


def late_clocks(record, causes):
    """The record whose clocks read late."""
    arms = {}
    for name, arm in record.arms.items():
        late = float(causes[name, "clock"][0])
        arms[name] = replace(arm, time=arm.time + late, wrench_time=arm.wrench_time + late)
    return replace(record, arms=arms)


def stamped(record, zero):
    """The record with stamps that begin at another time."""
    arms = {
        name: replace(arm, time=arm.time + zero, wrench_time=arm.wrench_time + zero)
        for name, arm in record.arms.items()
    }
    return replace(record, arms=arms, desired_time=record.desired_time + zero)


def logged(scenario, causes, seed=0, free=True):
    """What the arms log of a run with causes, and the cell as its user believes it."""
    changed = with_causes(scenario, causes).override({"seed": seed})
    result = cp.run(changed, warn=False)
    record = cp.logs.Record.of_run(result)
    if free:
        record = free_hands(record, causes, np.random.default_rng(seed))
    return late_clocks(record, causes), believed(scenario, causes, changed)


def all_logged(scenario, seeds, scales=None, size=16):
    """Causes, record and believed cell of every seed, as of ``logged``; the runs are lanes of a batch."""
    for k in range(0, len(seeds), size):
        some = seeds[k : k + size]
        causes = [drawn(np.random.default_rng(seed), scenario, scales or {}) for seed in some]
        cells = [
            with_causes(scenario, one).override({"seed": seed})
            for one, seed in zip(causes, some, strict=True)
        ]
        batch = simulate_batch(cells)
        for i, (seed, one) in enumerate(zip(some, causes, strict=True)):
            record = cp.logs.Record.of_run(batch.result(i))
            record = late_clocks(free_hands(record, one, np.random.default_rng(seed)), one)
            yield one, record, believed(scenario, one, cells[i])
        batch.release()


def truth(fit, causes, mass=0.0):
    """The true values of the parameters of a fit, NaN for the inertia; first moments about the believed P."""
    values, more = [], float(causes["", "mass"][0])
    for one in fit.parameters:
        if one.part == "mass" and not one.arm:
            values.append(mass * more)
        elif one.part == "first moment":
            values.append(mass * (1.0 + more) * causes["", "centre"]["xyz".index(one.axis)])
        elif not one.arm:
            values.append(np.nan)
        elif one.part in ("tip", "base", "wrist"):
            values.append(causes[one.arm, one.part][FRAME_AXES.index(one.axis)])
        else:
            same = [other.axis for other in fit.parameters if (other.arm, other.part) == (one.arm, one.part)]
            values.append(causes[one.arm, one.part][same.index(one.axis)])
    return np.array(values)


def force_of(answer, members, causes):
    """The mean norm of the force that the true values of some parameters make."""
    made = answer.effects
    columns_of = [made.parameters.index(one) for one in members]
    x = [
        causes[one.arm, one.part][FRAME_AXES.index(one.axis)]
        if one.part == "wrist"
        else truth(answer.kinematics, causes)[answer.kinematics.parameters.index(one)]
        for one in members
    ]
    return float(np.linalg.norm(made.force[..., columns_of] @ np.array(x), axis=2).max(axis=1).mean())
