"""Single runs that check a batch of a user's law: the first of its runs and a random one, to the end.

Random ticks see what a law computes, not what it counts, draws or reads besides; a whole run sees that, too.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from coop_pin.build_controller import build_controller
from coop_pin.description.scenario import Scenario
from coop_pin.errors import TracingError
from coop_pin.results import RunResult
from coop_pin.simulation import Simulation, simulate

Item = TypeVar("Item")

CHECKED = 2
"""Runs of a family that are repeated singly."""
_FIRST_TICKS = 200
"""Ticks of a run by itself that are repeated singly."""
_AGREEMENT = 1e-9
"""Largest difference of a quantity or metric, relative to its largest value or to 1, whichever is more."""


def checked(runs: Sequence[Item]) -> list[Item]:
    """Return the first of some runs and a random other one, which depends on their number only."""
    first, *others = runs
    return [first, *random.Random(len(others)).sample(others, min(len(others), CHECKED - 1))]


def difference(batch: Mapping[str, Any], expected: Mapping[str, Any]) -> str:
    """Return in which quantity or metric runs differ and by how much; nothing if they agree.

    Args:
        batch: Numbers of a run of the batch by name: floats or arrays.
        expected: Those of the single run.
    """
    for name, value in expected.items():
        single = np.asarray(value)
        if single.dtype.kind != "f" or name not in batch:
            continue
        scale = max(1.0, np.abs(single[np.isfinite(single)]).max(initial=0.0))
        if not np.allclose(batch[name], single, rtol=0.0, atol=_AGREEMENT * scale, equal_nan=True):
            with np.errstate(invalid="ignore"):
                errors = np.nan_to_num(np.abs(np.asarray(batch[name]) - single), nan=np.inf)
            return f"{name} differs by {errors.max():.3g}"
    return ""


def require_agreement(scenario: Scenario, samples: Mapping[str, Any]) -> None:
    """Refuse a batch of a user's law that differs from a single run.

    Args:
        scenario: Scenario of one of its runs.
        samples: Samples of that run.

    Raises:
        TracingError: It differs, or the single run fails.
    """
    try:
        expected = simulate(scenario, build_controller(scenario)).data
    except Exception as error:  # of a user's class, or of a run that fails
        reason = f"a single run ends with {type(error).__name__}: {error}"
    else:
        reason = difference(samples, {str(name): array.values for name, array in expected.items()})
    if reason:
        raise TracingError(told(scenario, reason))


def require_agreement_at_first(result: RunResult) -> None:
    """Refuse a run of a user's law as compiled code whose first ticks differ from those of a single run.

    Args:
        result: Result of the run.

    Raises:
        TracingError: They differ.
    """
    scenario, samples = result.scenario, result.arrays
    every = scenario.clock.record_every
    run = Simulation(scenario, build_controller(scenario))
    for _ in range(min(run.timeline.ticks, every * math.ceil(_FIRST_TICKS / every)) + 1):
        run.tick()
    single = run.result().data
    count = single.sizes["time"]
    timed = [name for name, values in single.data_vars.items() if "time" in values.dims]
    batch = {str(name): np.asarray(samples[name])[:count] for name in timed}
    if reason := difference(batch, {str(name): single[name].values for name in timed}):
        raise TracingError(told(scenario, reason))


def told(scenario: Scenario, reason: str) -> str:
    """Return the message for a batch that differs from a single run in a stated quantity."""
    law = scenario.controller.user_code[0]
    return (
        f"a batch of its controller {law!r} differs from a single run ({reason}):"
        " it keeps state besides that of init and step, or depends on more than its arguments"
    )
