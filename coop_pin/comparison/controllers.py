"""Controllers of the comparison: their descriptions, the gains that a cell sets, and stored tuned gains."""

from __future__ import annotations

import csv
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.base.errors import FieldError, FileReadError, NameNotFoundError
from coop_pin.base.schema.base import Description
from coop_pin.base.spatial import weight_wrench
from coop_pin.base.user_files import read_toml, read_user_file
from coop_pin.comparison.trials import benchmark_scenario
from coop_pin.control.gains import gain_vector
from coop_pin.description.scenario import Scenario
from coop_pin.design.suggestion import suggest
from coop_pin.feasibility import reachability
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.cell_arm import CellArm
from coop_pin.simulation.build_controller import build_controller
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
    """Return the stored gains of a scenario's name: field and value by controller.

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
    return gains


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
    reach = reachability(scenario, poses=_POSES)
    return motion_stability(Simulation(scenario, build_controller(scenario)), reach).value
