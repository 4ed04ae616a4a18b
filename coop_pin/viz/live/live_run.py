"""Interactive simulation in a background thread: gains, payload mass and squeeze can be changed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.errors import CoopPinError, FieldError, UserCodeError
from coop_pin.description.events import PayloadChange, WrenchPulse
from coop_pin.description.scenario import Scenario
from coop_pin.reference.squeeze import ConstantSqueeze
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Observer
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulate import RealtimePacer
from coop_pin.simulation.simulation import Simulation

_JOIN_S = 5.0
_ROUNDED_DOWN = 1.0 - 1e-12


def squeeze_force(scenario: Scenario) -> float:
    """Return the largest desired internal force on an arm at t = 0, N."""
    return float(np.linalg.norm(scenario.squeeze_wrenches[:, :3], axis=1).max())


class Change(NamedTuple):
    """Change of a run under way.

    Attributes:
        start: s.
        end: s; of a push later than the start.
        text: change, with the new value.
    """

    start: float
    end: float
    text: str


class LiveRun:
    """Interactive simulation: start, pause, reset, push, and changes of gains, payload mass and squeeze.

    A change acts at the next tick and outlasts a reset.

    Attributes:
        scenario: scenario with all changes; the next reset starts from it.
        error: the error that ended the run; None if there is none.
        squeeze: largest desired internal force on an arm, N.
        changes: changes since the start or the last reset.
        on_end: function that is called from the run's thread when the run finishes or fails.
        on_change: function that is called after a change of gains, mass or squeeze, a push and a reset.
    """

    error: CoopPinError | None

    def __init__(
        self, scenario: Scenario, *, view: Observer | None = None, realtime_rate: float = 1.0
    ) -> None:
        """Prepare a run, paused at the start.

        Args:
            scenario: the scenario.
            view: observer that is called at every tick.
            realtime_rate: simulated seconds per second of wall time.

        Raises:
            UnreachablePoseError: an arm does not reach its grasp at the start.
            OutOfRangeError: the real-time rate is not greater than zero.
        """
        self.scenario, self.squeeze, self.error = scenario, squeeze_force(scenario), None
        self.changes: tuple[Change, ...] = ()
        self.on_end: Callable[[], None] = lambda: None
        self.on_change: Callable[[], None] = lambda: None
        self._view, self._pace = view, RealtimePacer(realtime_rate)
        self._simulation = Simulation(scenario, build_controller(scenario))
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def time(self) -> float:
        """Time of the next tick, s."""
        return self._simulation.time

    @property
    def is_running(self) -> bool:
        """Whether the run's thread is running."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def is_finished(self) -> bool:
        """Whether the run has finished or failed."""
        return self._simulation.is_finished or self.error is not None

    @property
    def realtime_rate(self) -> float:
        """Simulated seconds per second of wall time."""
        return self._pace.rate

    @realtime_rate.setter
    def realtime_rate(self, rate: float) -> None:
        self._pace = RealtimePacer(rate)

    def start(self) -> None:
        """Start or resume the run; a finished run stays as it is."""
        if self.is_running or self.is_finished:
            return
        self._stop.clear()
        self._pace = RealtimePacer(self._pace.rate)
        self._thread = threading.Thread(target=self._run, name="coop_pin live run", daemon=True)
        self._thread.start()

    def pause(self) -> None:
        """Pause the run."""
        self._stop.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(_JOIN_S)

    def reset(self) -> None:
        """Pause, and return to the start with the current values."""
        self.pause()
        self._simulation, self.error = Simulation(self.scenario, build_controller(self.scenario)), None
        self.squeeze, self.changes = squeeze_force(self.scenario), ()
        self.on_change()

    def step(self) -> None:
        """Do one tick, whether running or not; a finished run stays as it is."""
        with self._lock:
            if not self.is_finished:
                self._simulation.tick()
                if self._view is not None:
                    self._view(self._simulation.snapshot())

    def result(self) -> RunResult:
        """Return the recording since the last reset; at least one tick must have been done."""
        with self._lock:
            return self._simulation.result()

    def change(self, fields: Mapping[str, Any]) -> None:
        """Change fields of the controller, for example ``{"controller.gains.pose_gain": 3.0}``.

        Raises:
            ScenarioError: the value is not allowed; nothing has changed.
        """
        changed = self.scenario.override(fields)
        controller = build_controller(changed)
        with self._lock:
            self.scenario = changed
            self._simulation.replace_controller(controller)
        self._changed(", ".join(f"{_name(field)} {_said(value)}" for field, value in fields.items()))

    def change_mass(self, mass: float) -> None:
        """Change the mass of the payload, kg.

        Raises:
            ScenarioError: the mass is not greater than zero; nothing has changed.
        """
        payload = self.scenario.cell.payload.with_mass(mass)
        with self._lock:
            self.scenario = self.scenario.replace(cell=self.scenario.cell.replace(payload=payload))
            if not self._simulation.is_finished:
                self._simulation.add_event(PayloadChange(time=self._simulation.time, mass=mass))
        self._changed(f"payload {mass:.3g} kg")

    def change_squeeze(self, newtons: float) -> None:
        """Replace the squeeze by that of the scenario at t = 0, scaled to a largest force on an arm, N.

        Raises:
            FieldError: the scenario has no squeeze to scale.
        """
        wrenches, present = self.scenario.squeeze_wrenches, squeeze_force(self.scenario)
        if not present > 0.0:
            raise FieldError("is zero and cannot be scaled; give the scenario a squeeze first", "squeeze")
        table = {
            name: tuple(newtons / present * row)
            for name, row in zip(self.scenario.cell.arms, wrenches, strict=True)
        }
        squeeze = ConstantSqueeze(wrenches=table)
        with self._lock:
            if newtons > 0.0:  # a zero squeeze would lose its direction
                self.scenario = self.scenario.replace(squeeze=squeeze)
            self._simulation.replace_squeeze(squeeze)
            self.squeeze = newtons
        self._changed(f"squeeze {newtons:.3g} N")

    def push(self, wrench: tuple[float, ...], duration: float) -> None:
        """Apply an external wrench to the payload from the next tick on.

        Args:
            wrench: wrench about P in world axes, N and N m, six numbers.
            duration: s; shortened to the end of the run.
        """
        with self._lock:
            time = self._simulation.time
            left = (self._simulation.scenario.duration - time) * _ROUNDED_DOWN
            if not left > 0.0:
                return
            pulse = WrenchPulse(time=time, duration=min(duration, left), wrench=wrench)
            self._simulation.add_event(pulse)
        self._changed(f"push {np.linalg.norm(wrench[:3]):.3g} N", pulse.duration)

    def _changed(self, text: str, duration: float = 0.0) -> None:
        self.changes += (Change(self.time, self.time + duration, text),)
        self.on_change()

    def _run(self) -> None:
        while not self._stop.is_set() and not self.is_finished:
            self._pace.wait_until(self.time)
            try:
                self.step()
            except CoopPinError as error:  # kept for the user: nothing above this thread would catch it
                self.error = error
            except Exception as error:  # a user's controller may raise anything
                self.error = UserCodeError(self.time, error)
                self.error.__cause__ = error
        if self.is_finished:
            self.on_end()


def _name(field: str) -> str:
    return field.rpartition(".")[2].replace("_", " ")


def _said(value: Any) -> str:
    """Return a field's value in a few characters."""
    if isinstance(value, int | float | str):
        return f"{value:.3g}" if isinstance(value, float) else str(value)
    return "changed"
