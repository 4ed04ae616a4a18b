"""Monitors of the convergence proofs: every term of the derivation of a law, along a recorded run."""

from __future__ import annotations

import xarray as xr

from coop_pin.base.arrays import typed
from coop_pin.base.errors import ArgumentError
from coop_pin.proof.monitored_quantities import MONITORED
from coop_pin.proof.payload_space_monitor import payload_space_monitor
from coop_pin.proof.sliding_mode_monitor import sliding_mode_monitor
from coop_pin.results.run_result import RunResult


@typed
def theorem_monitor(result: RunResult) -> xr.Dataset:
    """Return the quantities of the convergence proof of a run's law at every tick.

    Of law (23) what ``sliding_mode_monitor`` returns, of the payload-space law what ``payload_space_monitor``
    returns. Everything is computed from the recorded motion, torques and wrenches of the plant; only the
    gains are the controller's.

    Args:
        result: Run with every tick kept, of the payload-space law, or of the printed law ("sliding-mode")
            with planar or full task rows.

    Raises:
        ArgumentError: of another law, with feed-forward, or without samples at every tick.
    """
    clock, kind, rows = result.scenario.clock, result.scenario.controller.kind, result.scenario.cell.rows
    if clock.record_every != 1:
        raise ArgumentError(
            f"clock.record_every is {clock.record_every}; the integrals need every tick: run again with 1"
        )
    if result.scenario.feed_forward is not None:
        raise ArgumentError("the run has feed-forward torques, which the proofs do not; run without them")
    if kind not in MONITORED or (kind, rows) == ("sliding-mode", "positional"):
        raise ArgumentError(
            f"controller.kind is {kind!r} with rows {rows!r}; the proofs are about 'payload-space', and about"
            " 'sliding-mode' with rows 'planar' or 'full'"
        )
    return payload_space_monitor(result) if kind == "payload-space" else sliding_mode_monitor(result)


@typed
def anchor_bounded_time(result: RunResult) -> dict[str, float]:
    """Return the time for which the bound of an anchor acts, as a metric of runs and sweeps.

    Much of it says that what an anchor meets is no bias of the start: a dead arm, drives that are too weak,
    a wrong wrench, or a bias that has changed. See the page "The bounded anchor".

    Args:
        result: Run of the payload-space law, as for ``theorem_monitor``.

    Returns:
        ``anchor_bounded_s``: the time of the arm for which it is longest, s.

    Raises:
        ArgumentError: as of ``theorem_monitor``, or the run's law has no anchor.
    """
    if (kind := result.scenario.controller.kind) == "sliding-mode":
        raise ArgumentError(f"the run has the law {kind!r}, which has no anchor; use 'payload-space'")
    ticks = theorem_monitor(result)["anchor_is_bounded"].sum("time")
    return {"anchor_bounded_s": float(ticks.max()) * result.scenario.clock.period}
