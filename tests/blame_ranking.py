"""Blind draws of one culprit each: it costs 0.3 to 1 N, and twice what the next cause does.

    python tests/blame_ranking.py KIND PART [SEED]

prints in how many of 20 sound draws the culprit is first, and in how many the first cause names both arms.
"""

import itertools
import sys

import numpy as np
from log_cells import NOISE, believed, drawn, free_hands, late_clocks, scenario_of, with_causes

import coop_pin as cp
from coop_pin.compiled.simulate import simulate_batch
from coop_pin.identification import Priors
from coop_pin.identification.closure import ViewClosure
from coop_pin.identification.effects import effects
from coop_pin.identification.views import FRAME_AXES
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.transmission import friction

PRIORS = Priors(clock=3e-3, link=0.0, wrist=(2.0, 0.1))


def unit_costs(kind):
    """Newtons of a unit of every parameter and of 1 N m in drives that reverse, and the payload's weight."""
    scenario = scenario_of(kind)
    sensors = {"encoder": {"resolution": 1e-5}, "wrist": {"noise": NOISE}}
    answer = cp.blame(cp.run(scenario, {"sensors": sensors}, warn=False), priors=PRIORS)
    arms, record = {name: CellArm(scenario.cell, name) for name in scenario.cell.arms}, answer.record
    unit = [one._replace(viscous=0.0, coulomb=1.0) for one in answer.friction if one.is_seen]
    by_drive = effects(
        record,
        ViewClosure(record, arms, PRIORS),
        answer.scenario,
        [],
        unit,
    )
    costs = {}
    for made in (answer.effects, by_drive):
        norms = np.linalg.norm(made.force, axis=2).max(axis=1).mean(axis=0)
        costs |= dict(zip(made.parameters, norms.tolist(), strict=True))
    return costs, scenario.cell.payload.mass * np.linalg.norm(scenario.cell.gravity)


def draw(rng, kind, part, costs, load):
    """A scenario's causes, its culprit, the friction of the drives and the shares of the law."""
    scenario, target = scenario_of(kind), rng.uniform(0.3, 1.0)
    names, causes = [*scenario.cell.arms], drawn(rng, scenario, {})
    levels = {name: friction(arm, name).coulomb.copy() for name, arm in scenario.cell.arms.items()}
    share = 0.0
    for one, cost in costs.items():  # every other parameter costs less than half, alone
        values = causes.get((one.arm, one.part))
        if values is None or not cost:
            continue
        at = index_of(one, costs)
        values[at] = np.clip(values[at], -0.2 * target / cost, 0.2 * target / cost)
    culprit = None
    if part == "share":
        share = float(rng.choice((-1.0, 1.0))) * target / load
    else:
        able = [one for one, cost in costs.items() if one.part == part and cost > least(part) * target]
        culprit = able[rng.integers(len(able))]
        size = float(rng.choice((-1.0, 1.0))) * target / costs[culprit]
        if part == "friction":
            levels[culprit.arm][int(culprit.axis.split()[1]) - 1] += abs(size)
        else:
            causes[culprit.arm, part][index_of(culprit, costs)] = size
    share_of = {names[0]: 0.5 + share, names[1]: 0.5 - share}
    return culprit, causes, levels, share_of


def least(part):
    """Newtons of a unit from which on a parameter makes 1 N with an error that a cell can have."""
    return {"tip": 60.0, "base": 60.0, "joint": 60.0, "clock": 3.0, "wrist": 0.3, "friction": 0.05}[part]


def index_of(parameter, parameters):
    """Where a parameter stands among those of its part."""
    if parameter.part in ("tip", "base", "wrist"):
        return FRAME_AXES.index(parameter.axis)
    same = [one for one in parameters if (one.arm, one.part) == (parameter.arm, parameter.part)]
    return same.index(parameter)


def answers(kind, part, seeds, costs, load):
    """The culprit and the answer of every draw whose run is sound; the runs are lanes of a batch.

    Friction or a clock that cost that much may shake a cell until an arm is beyond its joint limits, or its
    motion is no solution any more: no user keeps such a log.
    """
    scenario, cells, draws = scenario_of(kind), [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        culprit, causes, levels, shares = draw(rng, kind, part, costs, load)
        cell = with_causes(scenario, causes).override({"seed": seed})
        late = {name: {"offset": float(causes[name, "clock"][0])} for name in [*scenario.cell.arms][1:]}
        changes = {"network": {"clocks": late}, "cell.load_shares": shares}
        for name in scenario.cell.arms:
            viscous = friction(scenario.cell.arms[name], name).viscous.tolist()
            changes[f"cell.arms.{name}.friction"] = {"viscous": viscous, "coulomb": levels[name].tolist()}
        cells.append(cell.override(changes))
        draws.append((culprit, causes, rng))
    batch = simulate_batch(cells)
    for k, (culprit, causes, rng) in enumerate(draws):
        result = batch.result(k)
        if not result.simulation_sound:
            continue
        record = late_clocks(free_hands(cp.logs.Record.of_run(result), causes, rng), causes)
        cell = believed(scenario, causes, cells[k]).override({"cell.load_shares": None, "network": None})
        yield culprit, cp.blame(record, cell, priors=PRIORS)
    batch.release()


def is_first(culprit, answer):
    """Whether the first cause is the culprit, or has it among what the log does not tell apart."""
    members = answer.causes[0].members
    return members[0].part == "load share" if culprit is None else culprit in members


def ranks(kind, part, seed, costs, load):
    """Of 20 sound draws: whether the culprit is first, and whether the first cause names both arms."""
    sound = itertools.islice(answers(kind, part, range(seed, seed + 32), costs, load), 20)
    return [(is_first(culprit, answer), len(answer.causes[0].arms) == 2) for culprit, answer in sound]


if __name__ == "__main__":
    draws = ranks(*sys.argv[1:3], int([*sys.argv[3:], 7000][0]), *unit_costs(sys.argv[1]))
    print(
        *sys.argv[1:], "first", sum(one for one, _ in draws), "both", sum(one for _, one in draws), len(draws)
    )
