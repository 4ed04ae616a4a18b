"""Golden files: today's numbers, bit for bit; a change that should move no number is shown to move none.

They hold for the machine and the libraries they were recorded with. A change that means to change numbers
records them anew, and says why::

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python tests/test_golden.py --record [case ...]
"""

import functools
import itertools
import sys
import warnings
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from cells import SCENARIOS, cell_and_start, random_velocity
from linkages import bead, bennett, four_bar, sarrus
from test_closed_chain import CASES as CELLS
from test_closed_chain import chain_of, cut_arm, cut_state, opened_by_a_decimetre
from test_mechanisms import ladder, sled

import coop_pin as cp
from coop_pin.chain.integrators import RungeKutta, configuration_space
from coop_pin.description import Stabilisation
from coop_pin.errors import ConstraintSolveError, UrdfWarning
from coop_pin.spatial import make_pose

GOLDEN = Path(__file__).parent / "golden"
EVERY = 0.1
FORMULATIONS = ("auto", "proximal", "kkt")

# ---------------------------------------------------------------- what is asked of the package

RECORDED = {
    "q": "configuration",
    "v": "velocity",
    "torque": "torque",
    "commanded_torque": "commanded_torque",
    "interaction": "interaction_wrench",
    "internal": "internal_wrench",
}


def run_of(scenario):
    data = cp.run(scenario).data
    each = round(EVERY / float(data["time"].values[1]))
    return {"time": data["time"].values[::each]} | {
        name: data[kept].values[::each] for name, kept in RECORDED.items()
    }


def motion_of(chain, q, v, duration=2.0, step=5e-3, torque=None, project=True):
    motion = chain.integrate(q, v, duration=duration, step=step, torque=torque, project=project)
    return samples_of(chain, *(part[:: round(EVERY / step)] for part in motion))


def recovery_of(plant, q, step=2e-3, duration=0.3):
    """Off the closures, which their stabilisation closes again."""
    chain, v, states = (
        plant.mechanism,
        np.zeros(plant.mechanism.model.nv),
        [(0.0, q, np.zeros(plant.mechanism.model.nv))],
    )
    integrator, none = RungeKutta(configuration_space(chain.model)), np.zeros(0)
    for k in range(round(duration / step)):
        q, v, _ = integrator.step(
            lambda _t, q, v: (chain.solver.acceleration(q, v, np.zeros(len(v))), none), 0.0, q, v, step
        )
        states.append((step * (k + 1), q, v))
    return samples_of(chain, *(np.array(part) for part in zip(*states[:: round(EVERY / step)], strict=True)))


def samples_of(chain, time, q, v):
    """States, and how the chain answers a torque in each of them; NaN where it finds no answer."""
    tau = 0.3 * np.arange(chain.model.nv)
    answers = []
    for at in zip(q, v, strict=True):
        try:
            acceleration, wrenches, rank, _ = chain.forward_dynamics(*at, tau)
        except ConstraintSolveError:
            acceleration, wrenches, rank = (
                np.full(len(tau), np.nan),
                np.full((len(chain.closures.closures), 6), np.nan),
                -1,
            )
        answers.append((acceleration, wrenches, rank))
    acceleration, wrenches, rank = (np.array(part) for part in zip(*answers, strict=True))
    return {"time": time, "q": q, "v": v, "acceleration": acceleration, "wrenches": wrenches, "rank": rank}


def chain_of_cell(case, rows, formulation):
    """The arms and payload of a cell with its closures as they are, or with other rows."""
    plant, q = chain_of(case)
    held = [
        cp.Closure(closure.frame_a, closure.frame_b, rows) for closure in plant.mechanism.closures.closures
    ]
    chain = plant.mechanism
    gains = chain.stabilisation
    return cp.ClosedChain(chain.model, held, stabilisation=gains, formulation=formulation), q


# ---------------------------------------------------------------- mechanisms


def of_four_bars(loops, formulation="auto", angle=np.pi / 2, rate=-1.0, **options):
    chain = four_bar.four_bars(loops, formulation=formulation)
    return motion_of(chain, *four_bar.start(chain, loops, angle, rate), **options)


def of_continuous_four_bars():
    revolute = four_bar.rod
    with mock.patch.object(
        four_bar, "rod", lambda *where: revolute(*where).replace('"revolute"', '"continuous"')
    ):
        return of_four_bars(2)


def of_bennett(rows, formulation="auto"):
    chain, start = bennett(rows, formulation=formulation)
    return motion_of(chain, *start)


def of_sarrus(formulation="auto"):
    chain, rest = sarrus(formulation=formulation)
    start = chain.assemble(rest + 0.03, chain.velocity({"lower_pin": 0.6}))
    return motion_of(chain, *start, torque=lambda _t, q, _v: 60.0 * (rest - q))


def of_bead(rows):
    return motion_of(bead(rows, make_pose((0.0, 0.0, 0.0), (0.4, -0.7, 1.3))), np.zeros(3), np.zeros(3))


def of_ladder():
    chain = ladder()
    return motion_of(
        chain, *chain.assemble(chain.configuration({"a_pin": 0.3, "rod_pin": 2.0})), duration=1.0
    )


def of_sled():
    return motion_of(sled(), [0.0], [0.5], torque=lambda t, _q, v: [np.cos(3.0 * t) - 0.5 * v[0]])


def of_cell(case, rows, formulation):
    """A cell is let go while it moves; damped."""
    chain, q = chain_of_cell(case, rows, formulation)
    return motion_of(chain, q, 0.2 * random_velocity(chain, q, 6), torque=lambda _t, _q, v: -0.2 * v)


def of_opened_cell(case, formulation):
    plant, _ = chain_of(
        case, formulation=formulation, stabilisation=Stabilisation(frequency=12.0, damping_ratio=0.3)
    )
    return recovery_of(plant, opened_by_a_decimetre(plant, case[0]))


def of_cut_arm(name, link, hinge):
    cell, _ = cell_and_start(name)
    gravity = (0.0, -9.81, 0.0) if name == "planar" else (0.0, 0.0, -9.81)
    arm = cp.ArmModel(cell.arms["right"], cell.grasps["right"].matrix, gravity)
    link = arm.model.njoints - 1 if link == "last" else 2
    chain, cut = cut_arm(arm, link, hinge)
    state = cut_state(
        arm, chain, cut, link, hinge, np.array(cell.arms["right"].posture), np.linspace(-0.3, 0.3, arm.nv)
    )
    return motion_of(chain, *state, torque=lambda _t, _q, v: -2.0 * v)


# ---------------------------------------------------------------- the cases

CASES = {f"scenario {name}": functools.partial(run_of, name) for name in cp.scenario_names()}
for loops, formulation in itertools.product((1, 2, 3), FORMULATIONS):
    CASES[f"four-bars {loops} {formulation}"] = functools.partial(of_four_bars, loops, formulation)
CASES["four-bars 2 from the singular pose"] = functools.partial(of_four_bars, 2, angle=0.0, rate=-5.0)
CASES["four-bars 2 not projected"] = functools.partial(of_four_bars, 2, project=False)
CASES["four-bars 2 continuous"] = of_continuous_four_bars
for rows, formulation in itertools.product(("point", "axis", "full"), FORMULATIONS):
    if (rows, formulation) != ("axis", "proximal"):
        CASES[f"bennett {rows} {formulation}"] = functools.partial(of_bennett, rows, formulation)
CASES["sarrus"] = of_sarrus
CASES["bead on a wire"] = functools.partial(of_bead, (True, True, False, False, False, False))
CASES["ladder"] = of_ladder
CASES["sled"] = of_sled
SOLVED = {"full": FORMULATIONS, "point": FORMULATIONS[1:], "planar": ("auto",), "axis": ("auto",)}
for cell, (rows, formulations) in itertools.product(CELLS, SOLVED.items()):
    for formulation in formulations:
        CASES[f"cell {' '.join(cell)} {rows} {formulation}"] = functools.partial(
            of_cell, cell, rows, formulation
        )
for cell, formulation in itertools.product(CELLS, FORMULATIONS[1:]):
    CASES[f"cell {' '.join(cell)} opened {formulation}"] = functools.partial(
        of_opened_cell, cell, formulation
    )
for arm, link, hinge in itertools.product(SCENARIOS, ("last", "middle"), (False, True)):
    CASES[f"arm {arm} {link} {'hinged' if hinge else 'welded'}"] = functools.partial(
        of_cut_arm, arm, link, hinge
    )


def measured(case):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UrdfWarning)  # links between the slides have no mass
        return CASES[case]()


def golden_file(case):
    return GOLDEN / f"{case.replace(' ', '-')}.npz"


def record(cases):
    GOLDEN.mkdir(exist_ok=True)
    for case in cases:
        np.savez_compressed(golden_file(case), **measured(case))
        print(case)


@pytest.mark.parametrize("case", CASES)
def test_the_numbers_are_those_of_the_golden_file_bit_for_bit(case):
    now = measured(case)
    with np.load(golden_file(case)) as golden:
        assert sorted(now) == sorted(golden.files)
        for name in golden.files:
            then = golden[name]
            assert now[name].shape == then.shape, name
            assert np.array_equal(now[name], then, equal_nan=True), (
                f"{name} is off by up to {np.nanmax(np.abs(now[name] - then)):.3g}"
            )


def test_every_golden_file_has_its_case():
    assert set(GOLDEN.iterdir()) == {golden_file(case) for case in CASES}


if __name__ == "__main__":
    if sys.argv[1:2] != ["--record"]:
        sys.exit("usage: python tests/test_golden.py --record [case ...]")
    record(sys.argv[2:] or CASES)
