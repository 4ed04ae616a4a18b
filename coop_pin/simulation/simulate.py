"""From a scenario and a controller to a result: every tick of a simulation, watched and paced if wanted."""

from __future__ import annotations

import math
from collections.abc import Callable

from coop_pin.control.interface import CellController
from coop_pin.description.scenario import Scenario
from coop_pin.errors import CoopPinError, RunInterruptedError, UserCodeError
from coop_pin.results import Observer, RunResult, ThrottledObserver
from coop_pin.simulation.realtime import RealtimePacer
from coop_pin.simulation.simulation import Simulation

Progress = Callable[[int, int], None]
"""(ticks done, ticks in all) -> None."""


def simulate(
    scenario: Scenario,
    controller: CellController,
    progress: Progress | None = None,
    view: Observer | None = None,
    realtime_rate: float | None = None,
) -> RunResult:
    """Run a controller on the plant of a scenario.

    Args:
        scenario: what to run.
        controller: who decides; it sees measurements only.
        progress: called after every tick.
        view: sees every tick, for example what coop_pin.viz.open_view returns.
        realtime_rate: simulated seconds in one second of wall time; inf is as fast as possible. When omitted
            1 with a view, otherwise inf.

    Raises:
        UnreachablePoseError: the start is out of an arm's reach.
        SingularJacobianError: an arm became singular.
        DivergedError: the motion left the range of finite, closed motion.
        UserCodeError: the controller, motion or squeeze raised something else.
        RunInterruptedError: Ctrl-C; it carries the result up to then as ``result``.
        Any CoopPinError raised after the first tick carries the result up to then as ``result``.
    """
    run = Simulation(scenario, controller)
    steady = RealtimePacer((1.0 if view else math.inf) if realtime_rate is None else realtime_rate)
    try:
        while not run.is_finished:
            steady.wait_until(run.time)
            run.tick()
            if view is not None:
                view(run.moment())
            if progress is not None:
                progress(run.ticks_done - 1, run.timeline.ticks)
        if isinstance(view, ThrottledObserver):
            view.show(run.moment())
    except CoopPinError as error:
        error.result = run.result() if run.ticks_done else None
        raise
    except (
        Exception
    ) as error:  # a user's controller, motion or squeeze may raise anything; nothing computed is lost
        broken = UserCodeError(run.time, error)
        broken.result = run.result() if run.ticks_done else None
        raise broken from error
    except KeyboardInterrupt:
        kept = run.result() if run.ticks_done else None
        raise RunInterruptedError(kept.end if kept else math.nan, kept) from None
    return run.result()
