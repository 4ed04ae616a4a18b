"""How a cell stands before anything moves, as a moment that a view can show."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.chain.cell_chain import CellChain, determinate_rows
from coop_pin.description.cell import Cell
from coop_pin.description.plant import PlantOptions
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import ArmModel
from coop_pin.results import RunResult, Snapshot
from coop_pin.spatial import rotate_vector6

_PATH_SAMPLES = 400


class InitialScene(NamedTuple):
    """A cell at rest.

    Attributes:
        cell: the description.
        plant: how its tree is laid out.
        moment: where everything stands; no wrenches, and NaN in the rows that rigid bodies do not determine.
        desired_path: where P should go, m, shape (n, 3).
    """

    cell: Cell
    plant: PlantOptions
    moment: Snapshot
    desired_path: Array


def initial_scene(what: Cell | Scenario | RunResult | str | Path) -> tuple[str, InitialScene]:
    """Return the name and the start of whatever has a cell.

    Args:
        what: a Cell, a Scenario, a result, a name in the catalogue or the path of a TOML file.

    Raises:
        ScenarioError: the scenario has mistakes.
        UnreachablePoseError: an arm does not reach its grasp at the start.
    """
    if isinstance(what, Cell):
        return "cell", standing_cell(what)
    if isinstance(what, RunResult):
        what = what.scenario
    scenario = what if isinstance(what, Scenario) else Scenario.load(what)
    return scenario.name, standing_scenario(scenario)


def standing_scenario(scenario: Scenario) -> InitialScene:
    """Return the start of a scenario.

    Raises:
        UnreachablePoseError: it is out of an arm's reach.
    """
    motion = scenario.motion.replace()
    path = np.array([motion.at(t).X_WP_d[:3, 3] for t in np.linspace(0.0, scenario.duration, _PATH_SAMPLES)])
    moment = _at_rest(
        scenario.cell, scenario.plant, scenario.start.matrix, motion.at(0.0).X_WP_d, scenario.squeeze_wrenches
    )
    return InitialScene(scenario.cell, scenario.plant, moment, path)


def standing_cell(cell: Cell) -> InitialScene:
    """Return a cell with its payload at ``payload_pose``, or where the first arm holds it in its posture.

    Raises:
        UnreachablePoseError: another arm does not reach its grasp.
    """
    if cell.payload_pose is not None:
        X_WP = cell.payload_pose.matrix
    else:
        name, arm = next(iter(cell.arms.items()))
        model = ArmModel(arm, cell.grasps[name].matrix)
        X_WP = model.payload_pose(
            model.configuration(np.zeros(model.nv) if arm.posture is None else arm.posture)
        )
    plant = PlantOptions()
    return InitialScene(
        cell, plant, _at_rest(cell, plant, X_WP, X_WP, np.zeros((len(cell.arms), 6))), X_WP[None, :3, 3]
    )


def _at_rest(cell: Cell, plant: PlantOptions, X_WP: Array, X_WP_d: Array, squeeze: Array) -> Snapshot:
    chain = CellChain(cell, plant)
    q, arms, joints = (
        chain.configuration(X_WP),
        len(cell.arms),
        max(len(place.drive) for place in chain.tree.arms),
    )
    none = np.tile(np.where(determinate_rows(chain, q), 0.0, np.nan), (arms, 1))
    return Snapshot(
        time=0.0,
        configuration=q,
        payload_pose=X_WP,
        desired_pose=X_WP_d,
        tip_position=chain.tip_positions(q),
        interaction_wrench=none,
        internal_wrench=none,
        desired_internal_wrench=rotate_vector6(X_WP[:3, :3], squeeze),
        external_wrench=np.zeros(6),
        torque=np.zeros((arms, joints)),
        saturated=np.zeros((arms, joints), dtype=bool),
        jacobian_condition=np.ones(arms),
    )
