"""Number of plant steps of the runs of a sweep, by measured error at its extreme points and a sample."""

from __future__ import annotations

import contextlib
import logging
import random

import numpy as np

from coop_pin.base.errors import CoopPinError, FileReadError, OutOfRangeError
from coop_pin.compiled.engine_choice import plant_of
from coop_pin.description.scenario import Scenario
from coop_pin.stability.step_size import STEPS_FIELD, fewest_steps
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.store import SweepStore

_LOG = logging.getLogger("coop_pin.sweeps")
_SAMPLE = 8
"""Random points of a plan at which the error is measured besides the extreme ones."""


def with_steps(plan: SweepPlan, store: SweepStore) -> SweepPlan:
    """Return a plan whose ``steps_per_tick = "auto"`` is decided: as the folder has it, or by measured error.

    Points that were added to the plan of the folder are measured; its number stays if it suffices.

    Args:
        plan: plan with its engine decided.
        store: folder of the plan.

    Raises:
        OutOfRangeError: no number of steps keeps the error at one of the points.
    """
    if not plan.has_open_steps:
        return plan
    least = 1
    with contextlib.suppress(FileReadError):
        stored = store.read_plan()
        if stored.steps_error_m == plan.steps_error_m and stored.changes.get(STEPS_FIELD):
            least = int(stored.changes[STEPS_FIELD])
            decided = _decided(plan, least)
            if decided == stored.model_copy(update={"engine": plan.engine}):
                return decided
    plant = plant_of("pinocchio" if plan.engine == "pinocchio" else "traced")
    steps = [least]
    for number in extreme_points(plan):
        scenario = plan.resolved(plan[number])
        if isinstance(scenario, Scenario):
            try:
                steps.append(fewest_steps(scenario, error=plan.steps_error_m, plant=plant).steps)
            except OutOfRangeError as error:
                if error.name == "error":
                    raise
            except CoopPinError:  # its run fails, too, and records why
                pass
    chosen = max(steps)
    _LOG.info("steps_per_tick %d keep %g m at %d runs", chosen, plan.steps_error_m, len(steps) - 1)
    return _decided(plan, chosen)


def _decided(plan: SweepPlan, steps: int) -> SweepPlan:
    """Return a plan with a number of steps."""
    return plan.replace(changes=plan.changes | {STEPS_FIELD: steps})


def extreme_points(plan: SweepPlan) -> list[int]:
    """Return the points of a plan with the least and largest values of each field, every case, and a sample.

    Where one dimension is at such a place, the others are in their middles, all at their least, or all at
    their largest values.
    """
    shape, generator = plan.shape, random.Random(0)
    extremes = [dimension.ends() for dimension in plan.dimensions]
    middle = [size // 2 for size in shape]
    positions = [middle, [ends[0] for ends in extremes], [ends[-1] for ends in extremes]]
    for axis, ends in enumerate(extremes):
        positions += [[*middle[:axis], end, *middle[axis + 1 :]] for end in ends]
    numbers = {int(np.ravel_multi_index(position, shape)) if shape else 0 for position in positions}
    return sorted(numbers | set(generator.sample(range(len(plan)), min(_SAMPLE, len(plan)))))
