"""Choice of the engine of a sweep, made once: single runs, or runs that are simulated together."""

from __future__ import annotations

import contextlib
import logging

from coop_pin.errors import CoopPinError, FieldError, FileReadError, MissingExtraError
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.store import SweepStore

_WORTH_A_BATCH = 64
"""Runs from which "auto" compiles code for them."""
_LOG = logging.getLogger("coop_pin.sweeps")


def with_engine(plan: SweepPlan, store: SweepStore, runs: int | None = None) -> SweepPlan:
    """Return a plan with its engine decided: as the folder has it, otherwise by its first run.

    Args:
        plan: the plan.
        store: its folder.
        runs: number of runs of its kind in all; the plan's own when omitted.

    Raises:
        FieldError: the plan wants batches, and its first run cannot be in one.
        MissingExtraError: it wants them, and llvmlite is not installed.
    """
    if plan.engine == "single":
        return plan
    with contextlib.suppress(FileReadError):
        kept = store.read_plan()
        if plan.engine == "auto" and kept.replace(engine="auto") == plan:
            return kept
    from coop_pin.batch import plant_reason, require_compiler, support  # slow to load

    count = len(plan) if runs is None else runs
    reason: object = f"{count} runs are fewer than {_WORTH_A_BATCH}"
    if plan.engine == "batch" or count >= _WORTH_A_BATCH:
        try:
            require_compiler()
            first = plan.scenario(0)
            # A user's code runs in workers only; if it cannot be traced, they tell why.
            reason = plant_reason(first.plant) if first.controller.user_code else support(first)
        except CoopPinError as error:
            reason = error
    if reason is None:
        return plan.replace(engine="batch")
    if plan.engine == "batch":
        if isinstance(reason, MissingExtraError):
            raise reason
        raise FieldError(f"is 'batch', but the first run cannot be simulated in one: {reason}", "engine")
    _LOG.warning("runs are simulated one by one: %s", reason)
    return plan.replace(engine="single")
