"""Controllers of the comparison: descriptions, gains that a cell sets, stored gains, and computing time."""

from __future__ import annotations

import csv
import functools
import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from coop_pin.base.arrays import as_count, typed
from coop_pin.base.errors import ArgumentError, FieldError, FileReadError, NameNotFoundError, TracingError
from coop_pin.base.schema.base import Description
from coop_pin.base.spatial import weight_wrench
from coop_pin.base.user_files import read_toml, read_user_file
from coop_pin.comparison.trials import benchmark_scenario
from coop_pin.control.gains import gain_vector
from coop_pin.description.scenario import Scenario
from coop_pin.design.suggestion import suggest
from coop_pin.feasibility import Reachability, reachability
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.cell_arm import CellArm
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.exchange import heard
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import motion_stability

_FOLDER = Path(__file__).parent
GAINS = _FOLDER / "gains.csv"
"""Tuned gains: scenario, controller, field, value, range, budget (runs, duration, seed) and cost."""
_GAINS_BYTES, _LONGEST_LINE = 10_000_000, 1000
_T_LAMBDA = 0.9
"""Largest T lambda of a joint damping along the motion; laws that use it add their pose gain, T gamma."""
_POSES = 9
"""Poses along the motion at which T lambda is looked at."""

Controllers = Mapping[str, Any] | Sequence[str]
"""Names of controllers of the table, or descriptions ("module:Class", a table of fields) by name."""


@functools.cache
def _table() -> dict[str, Any]:
    return read_toml(_FOLDER / "controllers.toml", kind="the table of controllers")


def controller_names() -> list[str]:
    """Return the names of the controllers that come with coop_pin."""
    return list(_table()["controllers"])


def tuned_ranges(name: str) -> dict[str, tuple[float, float]]:
    """Return the ranges of a controller's tuned fields, by path within it; none for others."""
    return {path: (low, high) for path, (low, high) in _table()["vary"].get(name, {}).items()}


@typed
def controllers_for(
    scenario: Scenario, controllers: Controllers, *, tuned: bool = True, gains: str | Path = GAINS
) -> dict[str, dict[str, Any]]:
    """Return the descriptions of controllers for a scenario, with stored tuned gains where there are any.

    Args:
        scenario: cell, whose gains fill in what a controller leaves to the cell.
        controllers: names, or descriptions by name.
        tuned: whether stored gains are used.
        gains: table of stored gains.

    Raises:
        NameNotFoundError: there is no controller of a name.
        FileReadError: the table of gains cannot be read.
        FieldError: a description is neither "module:Class" nor a table of fields.
    """
    table, descriptions = _table(), dict[str, dict[str, Any]]()
    stored = stored_gains(scenario.name, gains) if tuned else {}
    values = functools.cache(functools.partial(_cell_values, scenario))
    for name, chosen in _by_name(controllers).items():
        if isinstance(chosen, str) and ":" in chosen:
            chosen = {"kind": "user", "target": chosen}
        elif isinstance(chosen, str):
            if chosen not in table["controllers"]:
                raise NameNotFoundError(
                    "controller", chosen, table["controllers"], "the table; a class reads 'module:Class'"
                )
            of_cell = {path: values()[value] for path, value in table["cell"].get(chosen, {}).items()}
            chosen = _changed(table["controllers"][chosen], of_cell | stored.get(chosen, {}))
        elif isinstance(chosen, Description):
            chosen = chosen.model_dump()
        if not isinstance(chosen, Mapping):
            raise FieldError(
                f"is {chosen!r}; it must be 'module:Class' or a table of fields", f"controllers.{name}"
            )
        descriptions[name] = dict(chosen)
    return descriptions


def _by_name(controllers: Controllers) -> Mapping[str, Any]:
    return controllers if isinstance(controllers, Mapping) else {name: name for name in controllers}


def gains_used(
    scenario: Scenario, controllers: Controllers, *, tuned: bool, gains: str | Path
) -> dict[str, str]:
    """Return which gains the controllers of ``controllers_for`` have, by name.

    "tuned" stands for stored ones, "untuned" for the middle ones of the table, "given" for a description's.
    """
    stored = stored_gains(scenario.name, gains) if tuned else {}
    return {
        name: ("tuned" if chosen in stored else "untuned")
        if isinstance(chosen, str) and ":" not in chosen
        else "given"
        for name, chosen in _by_name(controllers).items()
    }


def stored_gains(scenario: str, path: str | Path = GAINS) -> dict[str, dict[str, float]]:
    """Return the stored gains of a scenario's name: field and value by controller, shared ones included.

    Raises:
        FileReadError: the file is not a table as ``tune_controllers`` writes it.
    """
    gains: dict[str, dict[str, float]] = {}
    content = read_user_file(path, limit=_GAINS_BYTES, kind="a table of gains")
    lines = content.decode(errors="replace").splitlines()
    for number, text in enumerate(lines, 1):
        if len(text) > _LONGEST_LINE:
            detail = f"has {len(text)} characters; a row has at most {_LONGEST_LINE}"
            raise FileReadError(detail, str(path), number)
    for line, row in enumerate(csv.DictReader(lines), 2):
        try:
            name, value = row["controller"], float(row["value"])
            field, is_wanted = row["field"], row["scenario"] == scenario
            is_known = field in tuned_ranges(name)
        except (KeyError, TypeError, ValueError):
            is_known = False
        if not is_known:
            columns = "scenario, controller, field and value, as coop-pin compare --tune writes them"
            raise FileReadError(f"reads {row}; a row must have {columns}", str(path), line)
        if is_wanted:
            gains.setdefault(name, {})[field] = value
    return gains | {name: gains[other] for name, other in _table()["shared"].items() if other in gains}


def _changed(table: dict[str, Any], changes: Mapping[str, float]) -> dict[str, Any]:
    """Return a table with fields changed, by dotted path; those of inner tables too."""
    table = {key: dict(value) if isinstance(value, dict) else value for key, value in table.items()}
    for path, value in changes.items():
        inner, _, field = path.rpartition(".")
        (table[inner] if inner else table)[field] = value
    return table


def _cell_values(scenario: Scenario) -> dict[str, Any]:
    """Return what the table of controllers leaves to the cell, by name."""
    law: Any = scenario.controller
    rows = scenario.cell.task_rows
    if law.kind != "payload-space":
        law = suggest(scenario).scenario.controller  # proposes no other law
    K = gain_vector(law.gains.sliding_gain, rows.size)
    redundant = any(len(CellArm(scenario.cell, name).drive) > rows.size for name in scenario.cell.arms)
    printed = "sliding-mode-redundant" if redundant else "sliding-mode"
    # Spare joints that turn with the motion have no spring that could follow it: the cell's own law has none.
    spring = float(np.min(law.posture.stiffness) > 0.0)
    return {
        "sliding": K.tolist(),
        "half": (K / 2.0).tolist(),
        "quarter": (K / 4.0).tolist(),
        "tenth": (K / 10.0).tolist(),
        "fivefold": (5.0 * K).tolist(),
        "damping": _damping(scenario.model_dump_json(), printed, tuple(K)),
        "weight": rows.select(weight_wrench(scenario.cell.payload.mass, scenario.cell.gravity)).tolist(),
        "printed": printed,
        "posture": law.posture.model_dump(),
        "spare torque": (40.0 * spring, 8.0),
        "spare acceleration": (25.0 * spring, 10.0),
        "spare rate": 4.0 * spring,
    }


@functools.lru_cache(maxsize=16)
def _damping(text: str, printed: str, K: tuple[float, ...]) -> list[float] | float:
    """Return K_d of the printed law for all arms, with T lambda along the motion at most 0.9.

    The diagonal of J^T (K / 2m) J at the start, the largest of all arms, times one factor; one number where
    arms have different numbers of joints.

    Args:
        text: The scenario, as JSON.
        printed: Kind of law (23) for its arms.
        K: Gain of the payload-space law on the task rows.
    """
    scenario = benchmark_scenario(Scenario.model_validate_json(text))
    cell, chain = scenario.cell, CellChain(scenario.cell, scenario.plant)
    q = chain.configuration(scenario.start.matrix)
    jacobians = (CellArm(cell, arm.name).task_jacobian(q[arm.q_slice]) for arm in chain.model.arms)
    diagonals = [np.diagonal(J.T @ (np.array(K)[:, None] * J)) / (2.0 * len(cell.arms)) for J in jacobians]
    alike = len({part.size for part in diagonals}) == 1
    K_d = np.max(diagonals, axis=0) if alike else np.array(min(part.min() for part in diagonals))
    gains = {"pose_gain": 1.0, "sign_gain": 0.0, "transient_rate": 1.0}
    while True:
        damping: list[float] | float = K_d.tolist()
        trial = {"kind": printed, "gains": gains | {"damping_gain": damping}}
        if (largest := t_lambda(scenario.override({"controller": trial}))) <= _T_LAMBDA:
            return damping
        # Dampers of spare joints are part of it and stay, so that one division leaves a rest.
        K_d = K_d * (0.95 * _T_LAMBDA / largest)


def t_lambda(scenario: Scenario) -> float:
    """Return T lambda of a scenario's law without noise, the largest of nine poses along the motion."""
    ideal = scenario.with_ideal_sensors.replace(events=(), seed=0)
    return _t_lambda(ideal.model_dump_json())


@functools.lru_cache(maxsize=64)
def _t_lambda(text: str) -> float:
    """Return T lambda along the motion of a scenario as JSON."""
    scenario = Scenario.model_validate_json(text)
    reach = reach_of_any_law(scenario, _POSES)
    return motion_stability(Simulation(scenario, build_controller(scenario)), reach).value


@dataclass(frozen=True)
class _AnyLaw:
    """A scenario, compared by all but its law."""

    text: str
    scenario: Scenario = field(compare=False)


def reach_of_any_law(scenario: Scenario, poses: int = 401) -> Reachability:
    """Return what ``reachability`` does, which knows no law, computed once for all gains of a search."""
    return _reach(_AnyLaw(scenario.model_dump_json(exclude={"controller"}), scenario), poses)


@functools.lru_cache(maxsize=8)
def _reach(of: _AnyLaw, poses: int) -> Reachability:
    return reachability(of.scenario, poses=poses)


_TICKS = 100


@typed
def tick_costs(scenario: Scenario, controllers: Controllers, *, rounds: int = 1) -> pd.DataFrame:
    """Return the cost of controllers for each arm and tick, and what they need.

    ``us`` is the least time of a hundred ticks in Python, of this machine, and ``ratio`` that to the
    first controller's. ``operations`` counts those of the law of the first arm with its
    kinematics, as exported to C; where they cannot be counted it is NaN, and ``not_counted`` says why.
    ``needs`` is what a controller uses besides kinematics, ``sent`` how many numbers of 8 bytes cross between
    the arms in a tick.

    Args:
        scenario: the cell.
        controllers: names, or descriptions by name, as for ``compare``.
        rounds: number of times that all controllers are timed, one after the other.

    Raises:
        ArgumentError: the number of rounds is not a count.
        CoopPinError: a run fails.
    """
    rounds, base = as_count("rounds", rounds, 1), benchmark_scenario(scenario)
    short = base.override({"duration": _TICKS * base.clock.period})
    chosen = {
        name: short.override({"controller": controller})
        for name, controller in controllers_for(scenario, controllers).items()
    }
    times = [[_least_us(timed) for timed in chosen.values()] for _ in range(rounds)]
    table = pd.DataFrame({"us": np.min(times, axis=0)}, index=list(chosen))
    table["ratio"] = table["us"] / table["us"].iloc[0]
    needs = [timed.controller.needs for timed in chosen.values()]
    counted = [_operations(timed, used) for timed, used in zip(chosen.values(), needs, strict=True)]
    table["operations"], table["not_counted"] = zip(*counted, strict=True)
    table["sent"] = [
        Simulation(timed, build_controller(timed)).traffic().numbers for timed in chosen.values()
    ]
    table["needs"] = [", ".join(used) or "nothing" for used in needs]
    return table


def _least_us(scenario: Scenario) -> float:
    """Return the least time of a tick of a scenario's controller for each arm, us."""
    law, times = build_controller(scenario), list[float]()
    run = Simulation(scenario, law)
    run.tick()
    while not run.is_finished:
        measurements, references, *_ = run.observe()
        inputs = heard(law, measurements, references, run.controller_state, run.exchange.at_once)
        start = time.perf_counter()
        command = law.step(inputs, references, run.controller_state)
        times.append(time.perf_counter() - start)
        run.step(command)
    return 1e6 * min(times) / len(scenario.cell.arms)


def _operations(scenario: Scenario, needs: Sequence[str]) -> tuple[float, str]:
    """Return the operations of a tick of the first arm's law, or why they cannot be counted."""
    if {"model", "regressor"} & {*needs}:
        return math.nan, "its model is Pinocchio's compiled code"
    from coop_pin.compiled.laws.c_export import export_c  # slow to load

    try:
        with tempfile.TemporaryDirectory() as folder:
            law = export_c(scenario, next(iter(scenario.cell.arms)), folder)
    except (TracingError, ArgumentError) as error:
        return math.nan, str(error)
    return float(sum(law.flops.values())), ""
