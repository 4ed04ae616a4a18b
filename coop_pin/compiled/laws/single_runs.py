"""Single runs that check a batch of a user's law: the first of its runs and a random one, to the end.

The first ticks show what a law computes, not what it counts, draws or reads besides; a whole run shows
that, too.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from coop_pin.base.errors import TracingError
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

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


def require_agreement(scenario: Scenario, samples: Mapping[str, Any], *, to_the_end: bool = True) -> None:
    """Refuse a run of a user's law as compiled code that differs from a single run.

    Args:
        scenario: Scenario of the run.
        samples: Samples of the run.
        to_the_end: Whether all ticks are compared; the first 200 otherwise.

    Raises:
        TracingError: It differs, or the single run fails.
    """
    every = 1 if to_the_end else scenario.clock.record_every
    try:
        run = Simulation(scenario, build_controller(scenario))
        most = run.timeline.ticks if to_the_end else every * math.ceil(_FIRST_TICKS / every)
        for _ in range(min(run.timeline.ticks, most) + 1):
            run.tick()
        single = run.result().data
    except Exception as error:  # of a user's class, or of a run that fails
        reason = f"a single run ends with {type(error).__name__}: {error}"
    else:
        expected = {str(name): part.values for name, part in single.data_vars.items() if "time" in part.dims}
        count = single.sizes["time"]
        reason = difference({name: samples[name][:count] for name in expected}, expected)
    if reason:
        raise TracingError(told(scenario, reason))


def told(scenario: Scenario, reason: str) -> str:
    """Return the message for a batch that differs from a single run in a stated quantity."""
    law = scenario.controller.user_code[0]
    return (
        f"a batch of its controller {law!r} differs from a single run ({reason}):"
        " it keeps state besides that of init and step, or depends on more than its arguments"
    )
