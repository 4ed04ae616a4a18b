"""Computing time of controllers, for each arm and tick, and what they need."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence

import numpy as np
import pandas as pd

from coop_pin.base.arrays import as_count, typed
from coop_pin.base.errors import ArgumentError, TracingError
from coop_pin.comparison.controllers import Controllers, controllers_for
from coop_pin.comparison.trials import benchmark_scenario
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.network import heard
from coop_pin.simulation.simulation import Simulation

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
