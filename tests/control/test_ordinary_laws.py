"""Laws as ordinary people write them: the default engine of a sweep against single runs in new processes."""

import inspect
import json
import logging
import os
import random
import warnings

import numpy as np
import pytest
from cells import SCENARIOS
from ordinary_laws import GRIDS, LAWS

import coop_pin as cp

HERE = cp.Execution(workers=0, quiet=True)
MASSES = (2.0, 2.8)
COLUMNS = ("position_error_max_m", "torque_peak_Nm", "internal_force_error_max_N")
ENGINES = {"planar": "auto", "spatial": "compiled"}
"""By the cell: for "auto" these ticks of a spatial one would be too few to be compiled."""
CHANGES = {
    "planar": {"duration": 5.0, "clock.rate_hz": 80.0},
    "spatial": {"duration": 1.2, "clock.rate_hz": 500.0},
}
TOLD_BY_NAME = "which all runs share", "others in each run", "another each time"
SINGLY = "one by one"
SAMPLE = random.Random(20261201).sample([*LAWS], 1)


def base_of(name, cell):
    """A scenario with the law; without gravity, which these laws do not hold."""
    law = {"kind": "user", "target": f"ordinary_laws:{name}"}
    changes = {"events": (), "beyond_bound": True, "cell.gravity": (0, 0, 0), "controller": law}
    scenario = SCENARIOS[cell]().override(changes | CHANGES[cell])
    if cell == "planar":
        return scenario
    pose = scenario.motion.pose
    return scenario.replace(
        motion=cp.motions.SwingMotion(pose=pose, axis=(0, 0, 1), amplitude=0.05, period=0.8)
    )


def axes_of(name, order):
    """Values of the law's last option and of the mass: the neutral one first, or in a random order."""
    option, dice = [*inspect.signature(LAWS[name].__init__).parameters][-1], random.Random(f"{name} {order}")
    axes = {f"controller.options.{option}": [*GRIDS[option]], "cell.payload.mass": [*MASSES]}
    return {field: dice.sample(values, len(values)) for field, values in axes.items()} if order else axes


def in_child(function):
    """What a function returns and what is told meanwhile, in a fork of this process."""
    receive, send = os.pipe()
    if (child := os.fork()) == 0:
        told, value, handler = [], None, logging.Handler()
        handler.emit = lambda record: told.append(record.getMessage())
        logging.getLogger("coop_pin").addHandler(handler)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                value = function()
            except Exception as error:
                told.append(f"{type(error).__name__}: {error}")
        with os.fdopen(send, "w") as pipe:
            json.dump((value, told + [str(warning.message) for warning in caught]), pipe)
        os._exit(0)
    os.close(send)
    with os.fdopen(receive) as pipe:
        answer = json.load(pipe)
    os.waitpid(child, 0)
    return answer


def outcome(name, cell, order, folder):
    """Whether a sweep and single runs agree, and what the sweep and a single run told."""
    base, axes = base_of(name, cell), axes_of(name, order)

    def swept():
        table = cp.sweep(base, axes, out=folder, engine=ENGINES[cell], execution=HERE).table
        return table[[*axes, *COLUMNS]].to_dict("list")

    def alone(changes, warn):
        metrics = cp.run(base.override(changes), warn=warn).metrics()
        return [metrics[column] for column in COLUMNS]

    table, told = in_child(swept)
    points = [
        dict(zip(axes, values, strict=True)) for values in zip(*(table[field] for field in axes), strict=True)
    ]
    rows = np.array([table[column] for column in COLUMNS], dtype=float).T
    neutral = GRIDS[next(iter(axes)).rpartition(".")[2]][0]
    last = max(i for i, point in enumerate(points) if next(iter(point.values())) != neutral)
    told_alone, is_equal = [], True
    # Of runs that were simulated singly in any case, the last is where others may have left something.
    for i in [last] if any(SINGLY in text for text in told) else range(len(points)):
        numbers, more = in_child(lambda i=i: alone(points[i], i == last))
        told_alone += more
        is_equal &= np.allclose(rows[i], numbers, 1e-6, 1e-9, equal_nan=True)
    return is_equal, told, told_alone


@pytest.mark.parametrize("order", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name", [name if name in SAMPLE else pytest.param(name, marks=pytest.mark.slow) for name in LAWS]
)
def test_a_law_of_everyday_differs_from_its_single_runs_only_where_it_is_told(name, cell, order, tmp_path):
    is_equal, told, told_alone = outcome(name, cell, order, tmp_path)
    print(json.dumps((name, LAWS[name].__doc__, bool(is_equal), told, told_alone)))
    assert is_equal or any(words in text for text in told for words in TOLD_BY_NAME)


def test_the_laws_are_many_and_of_many_kinds():
    assert len(LAWS) >= 100
    assert len({kind.__doc__ for kind in LAWS.values()}) == len(LAWS)
