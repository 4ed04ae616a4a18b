"""Simulation of a whole scenario, from the first tick to the result, and its real-time pacing."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator

from coop_pin.base.arrays import require_type
from coop_pin.base.errors import CoopPinError, OutOfRangeError, RunInterruptedError, UserCodeError
from coop_pin.control import CellController
from coop_pin.description.scenario import Scenario
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Observer, ThrottledObserver
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import PlantMaker
from coop_pin.simulation.simulation import Simulation

_LOST_S = 0.1
"""A longer delay counts as lost, s."""


_SLOWEST = 1e-6
"""Smallest rate: a second takes eleven days."""


class RealtimePacer:
    """Real-time pacing: sleeps so that simulated time passes at a constant rate.

    Time lost on a slow computer is not made up for by running faster afterwards.

    Attributes:
        rate: simulated seconds in one second of wall time; inf never waits.
    """

    def __init__(self, rate: float) -> None:
        """Set the rate; time starts to count at the first wait.

        Raises:
            OutOfRangeError: the rate is not greater than zero.
        """
        require_type("realtime_rate", rate, int, float)
        if not rate >= _SLOWEST:
            raise OutOfRangeError("realtime_rate", rate, f"at least {_SLOWEST:g}")
        self.rate = rate
        self._origin: float | None = None

    def wait_until(self, simulated: float) -> None:
        """Sleep until wall time has reached a simulated time, s."""
        if math.isinf(self.rate):
            return
        now, due = time.monotonic(), simulated / self.rate
        if self._origin is None or now - self._origin - due > _LOST_S:
            self._origin = now - due
        if self._origin + due > now:
            time.sleep(self._origin + due - now)


Progress = Callable[[int, int], None]
"""(ticks done, ticks in all) -> None."""


def simulate(
    scenario: Scenario,
    controller: CellController,
    *,
    progress: Progress | None = None,
    view: Observer | None = None,
    realtime_rate: float | None = None,
    stop_at_breach: bool = False,
    plant: PlantMaker = PinocchioPlant,
) -> RunResult:
    """Return the result of a controller on the plant of a scenario.

    Args:
        scenario: Scenario to run.
        controller: Controller of the cell, which need not be the one that the scenario names.
        progress: Function that is called after every tick.
        view: Function that is called with a snapshot after every tick, for example what
            coop_pin.open_view returns.
        realtime_rate: simulated seconds in one second of wall time; inf is as fast as possible. When omitted
            1 with a view, otherwise inf.
        stop_at_breach: end the run at its first breach of the scenario's trust thresholds.
        plant: Maker of the plant, as of Simulation.

    Raises:
        UnreachablePoseError: the start is out of an arm's reach.
        SingularJacobianError: an arm became singular.
        DivergedError: the run diverged.
        UserCodeError: the controller, motion or squeeze raised something else.
        RunInterruptedError: Ctrl-C; it carries the result up to then as ``result``.
        Any CoopPinError raised after the first tick carries the result up to then as ``result``.
    """
    run = Simulation(scenario, controller, plant=plant)
    return run_to_end(
        run, progress=progress, view=view, realtime_rate=realtime_rate, stop_at_breach=stop_at_breach
    )


def run_to_end(
    run: Simulation,
    *,
    progress: Progress | None = None,
    view: Observer | None = None,
    realtime_rate: float | None = None,
    stop_at_breach: bool = False,
) -> RunResult:
    """Return the result of a simulation after its last tick; arguments and errors as of simulate."""
    for name, called in (("progress", progress), ("view", view)):
        require_type(name, called, Callable, type(None))  # type: ignore[arg-type]
    pacer = RealtimePacer((1.0 if view else math.inf) if realtime_rate is None else realtime_rate)
    with errors_with_results(lambda: run.result() if run.ticks_done else None, lambda: run.time):
        while not run.is_finished:
            pacer.wait_until(run.time)
            run.tick()
            if view is not None:
                view(run.snapshot())
            if progress is not None:
                progress(run.ticks_done - 1, run.timeline.ticks)
            if stop_at_breach and run.recorder.breaches():
                break
        if isinstance(view, ThrottledObserver):
            view.show(run.snapshot())
    return run.result()


@contextlib.contextmanager
def errors_with_results(so_far: Callable[[], RunResult | None], time: Callable[[], float]) -> Iterator[None]:
    """Give the errors of a run the result up to them; raises as simulate.

    Args:
        so_far: Function that returns the result so far, if there is one.
        time: Function that returns the time of the next tick, s.
    """
    try:
        yield
    except CoopPinError as error:
        error.result = _marked(so_far(), error)
        raise
    except (Exception, SystemExit) as error:  # a user's controller, motion or squeeze may raise anything
        user_error = UserCodeError(time(), error)
        user_error.result = _marked(so_far(), user_error)
        raise user_error from error
    except KeyboardInterrupt:
        result = so_far()
        raise RunInterruptedError(result.end if result else math.nan, result) from None


_UNLOADED = (
    "arms that hold nothing are kept slow by actuators.gravity_compensation, a bound (controller.anchor_bias)"
    " or a guard (controller.slip_guard)"
)
"""Advice for arms that ran away after the payload dropped."""


def _marked(result: RunResult | None, error: CoopPinError) -> RunResult | None:
    """Return the result up to an error, marked with its class; a divergence tells of a dropped payload."""
    if result is not None:
        result.data.attrs[RunResult.ENDED_BY] = type(error).__name__
        if isinstance(error, ArithmeticError) and math.isfinite(result.dropped_at):
            error.args = (f"{result.friction_text}; {_UNLOADED}. Then: {error}",)
    return result
