"""Actuation: from commanded drive torques to the torques that act, see description/actuators.py."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask, frozen
from coop_pin.control.interface import CellCommand
from coop_pin.description.scenario import Scenario
from coop_pin.errors import DivergedError, ShapeError
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.joint_limits import JointLimits, per_joint
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.signals import MissedTicks
from coop_pin.spatial import weight_wrench

TORQUE_LIMIT = 1e7
"""A larger command counts as diverged, N m."""

_NO_LAG, _NO_RATE_LIMIT = 1e-30, 1e300
"""Stand for none in the equations of TorqueResponse: their product is large, too."""

_SAME = 1e-9
"""Two times closer than this part of a tick are the same instant."""


class Applied(NamedTuple):
    """Torques at a tick, for each arm, N m, shape (k,); read-only.

    Attributes:
        commanded: torques by the controller.
        requested: torques asked of the drives: the last command that arrived and the robot's gravity
            compensation.
        torques: torques that act at the tick.
        saturated: which of them the torque limits cut, or their rate limits over the whole tick.
        reported: parts of the commands that act, see ArmMeasurement.
    """

    commanded: Sequence[Array]
    requested: Sequence[Array]
    torques: Sequence[Array]
    saturated: Sequence[Mask]
    reported: Sequence[Array]


class ResponseState(NamedTuple):
    """Torques of drives after a target, in the letters of TorqueResponse; every row is of shape (drives,).

    Attributes:
        target: u, N m.
        sign: sgn(e).
        ramp: D, N m.
        rest: |e| - D, N m.
    """

    target: Array
    sign: Array
    ramp: Array
    rest: Array


class TorqueResponse(NamedTuple):
    """Response of drives with lag and rate limit: d tau/dt = clip((u - tau) / lag, -rate, rate).

    With e = u - tau(t_k) they first change by D = max(|e| - rate lag, 0) at the largest rate, then decay:

        tau(t_k + s) = u - sgn(e) (D - rate m + (|e| - D) exp(-(s - m) / lag)) with m = min(s, D / rate)

    Every row has one value for each drive.

    Attributes:
        at_once: which drives have neither lag nor rate limit.
        lag: time constant, s.
        rate: largest rate, N m/s.
    """

    at_once: Mask
    lag: Array
    rate: Array

    @classmethod
    def of_drives(cls, lag: Array, rate: Array) -> TorqueResponse:
        """Return the response of drives, shape (drives,) each; lag 0 and rate inf where none."""
        at_once = (lag == 0.0) & np.isinf(rate)
        return cls(at_once, np.maximum(lag, _NO_LAG), np.minimum(rate, _NO_RATE_LIMIT))

    def start(self, torque: Array) -> ResponseState:
        """Return the state at rest at a torque, shape (drives,)."""
        return ResponseState(torque, *np.zeros((3, len(torque))))

    def step(self, state: ResponseState, s: float, target: Array) -> ResponseState:
        """Return the state at a new target, shape (drives,), s seconds after the last."""
        error = np.where(self.at_once, 0.0, target - self.at(state, s))
        ramp = np.maximum(np.abs(error) - self.rate * self.lag, 0.0)
        return ResponseState(target, np.sign(error), ramp, np.abs(error) - ramp)

    def at(self, state: ResponseState, s: float) -> Array:
        """Return the torques s seconds after the last target, N m, shape (drives,)."""
        m = np.minimum(s, state.ramp / self.rate)
        error = state.ramp - self.rate * m + state.rest * np.exp((m - s) / self.lag)
        torque: Array = state.target - state.sign * error
        return torque

    def mean(self, state: ResponseState, s: float, duration: float) -> Array:
        """Return the mean torques over a duration that begins at s: their exact impulse, shape (drives,)."""
        error = self._integrated_error(state, s + duration) - self._integrated_error(state, s)
        torque: Array = state.target - state.sign * error / duration
        return torque

    def _integrated_error(self, state: ResponseState, s: float) -> Array:
        """Return the integral of |u - tau| from t_k over s."""
        m = np.minimum(s, state.ramp / self.rate)
        decayed = m - self.lag * np.expm1((m - s) / self.lag)
        integral: Array = (state.ramp - 0.5 * self.rate * m) * m + state.rest * decayed
        return integral

    def is_limited(self, state: ResponseState, duration: float) -> Mask:
        """Return which torques still change at their largest rate after a duration, s, shape (drives,)."""
        limited: Mask = state.ramp > (1.0 + _SAME) * self.rate * duration
        return limited

    def cut(self, state: ResponseState, duration: float) -> Array:
        """Return the part of the change that the rate limit leaves out over a duration, N m, (drives,)."""
        left_out = np.where(self.is_limited(state, duration), state.ramp - self.rate * duration, 0.0)
        torque: Array = state.sign * left_out
        return torque


class ArmDrives(NamedTuple):
    """Drives of one arm before lag: missed ticks, gravity compensation, torque limits.

    Attributes:
        limit: torque limits, N m, shape (k,).
        carried: 1 + mass_error of the robot's gravity compensation; None without.
        misses: whether ticks may be missed.
        keeps_weight: whether a loss takes the commands alone, not what the robot adds to them.
        entries: entries of the values of all drives that are its own.
    """

    limit: Array
    carried: float | None
    misses: bool
    keeps_weight: bool
    entries: slice

    def step(
        self, last: Array, command: Array, missed: Array, weight: Array | None
    ) -> tuple[tuple[Array, Array, Mask], Array]:
        """Return the torque asked for, that within the limits, and where it was cut; and the last command.

        Args:
            last: Last command that arrived, N m, shape (k,).
            command: Command of this tick, likewise.
            missed: Whether it is missed, a mask.
            weight: Torque that the robot adds, N m, shape (k,); None without gravity compensation.
        """
        if self.misses:
            last = command = np.where(missed, last, command)
        requested = command if weight is None else command + weight
        torque = np.minimum(np.maximum(requested, -self.limit), self.limit)
        return (requested, torque, frozen(np.not_equal(torque, requested))), last


class DriveState(NamedTuple):
    """Memory of the drives of a cell.

    Attributes:
        last: last command of each arm that arrived, N m, shape (k,) each.
        response: torques in lag; None if torques are held between ticks.
    """

    last: tuple[Array, ...]
    response: ResponseState | None


class CellDrives(NamedTuple):
    """Drives of all arms, see coop_pin.description.actuators for the equations.

    Attributes:
        arms: drives of each arm before lag.
        response: lag and rate limit of all drives; None if torques are held between ticks.
        period: T, s.
    """

    arms: tuple[ArmDrives, ...]
    response: TorqueResponse | None
    period: float

    def step(
        self,
        state: DriveState,
        commanded: Sequence[Array],
        missed: Array,
        weight: Callable[[int], Array],
        gives: Sequence[float],
        s: float,
    ) -> tuple[Applied, DriveState]:
        """Return what the drives make of commands, and the state.

        Args:
            state: State after the tick before.
            commanded: Torques by the controller, N m, shape (k,) each.
            missed: Masks, whether each arm misses the tick, shape (m,).
            weight: Function that returns T^-T g(q) of an arm by its index, N m, shape (k,).
            gives: 1.0 for each arm that gives torque, 0.0 for one that has lost it, or its commands.
            s: Time since the tick before, s.
        """
        requested, torques, saturated, reported, last = [], [], [], [], []
        for index, arm in enumerate(self.arms):
            carried = None if arm.carried is None else arm.carried * weight(index)
            received = gives[index] * commanded[index] if arm.keeps_weight else commanded[index]
            (asked, torque, cut), command = arm.step(state.last[index], received, missed[index], carried)
            requested.append(asked)
            torques.append(torque)
            saturated.append(cut)
            reported.append(frozen(received + (torque - asked)))
            last.append(command)
        applied = Applied(commanded, requested, torques, saturated, reported)
        if self.response is None or state.response is None:
            return applied, DriveState(tuple(last), None)
        response = self.response.step(state.response, s, np.concatenate(torques))
        limited = self.split(self.response.is_limited(response, self.period))
        left_out = self.response.cut(response, self.period)
        applied = applied._replace(
            torques=self.acting(self.response.at(response, 0.0), gives),
            saturated=[frozen(np.logical_or(*masks)) for masks in zip(saturated, limited, strict=True)],
            reported=[*map(frozen, self.acting(np.concatenate(reported) - left_out, gives))],
        )
        return applied, DriveState(tuple(last), response)

    def acting(self, torques: Array, gives: Sequence[float]) -> list[Array]:
        """Return the torques of each arm, zero where they are lost, of those of all drives."""
        return [
            torque if arm.keeps_weight else factor * torque
            for arm, factor, torque in zip(self.arms, gives, self.split(torques), strict=True)
        ]

    def split(self, values: Any) -> list[Any]:
        """Return the part of each arm of the values of all drives."""
        return [values[arm.entries] for arm in self.arms]


class Actuation:
    """Drives of all arms in a run: check a command and make torques of it.

    Attributes:
        drives: the drives.
        state: their memory.
        lost_at: when each arm loses its torque or its commands, s; inf for never.
    """

    def __init__(self, scenario: Scenario, plant: Plant, limits: Sequence[JointLimits]) -> None:
        """Start from the torques that hold the cell at rest at the plant's configuration.

        Args:
            scenario: Actuators and seed.
            plant: Its configuration.
            limits: Limits of each arm, in the order of the arms.

        Raises:
            FieldError: the number of rate limits differs from the number of an arm's joints.
        """
        self._places, self._start, cell = plant.chain.model.arms, 0.0, scenario.cell
        self._names = [place.name for place in self._places]
        self._models = [CellArm(cell, name) for name in self._names]
        self._loads = cell.shares[:, None] * weight_wrench(cell.payload.mass, cell.gravity)
        lost = [scenario.actuators_of(name).lost_at for name in self._names]
        self.lost_at = [np.inf if time is None else time for time in lost]
        arms = tuple(map(partial(_arm_drives, scenario), self._places, limits))
        period = scenario.clock.period
        self.drives = CellDrives(arms, self._response(scenario, arms), period)
        self._missed, self._gives = MissedTicks(scenario), self.gives(0.0)
        self.state = DriveState(tuple(self.holding_commands(plant.q)), None)
        if self.drives.response is not None:
            holding = [
                np.clip(self._holding_torque(index, plant.q), -arm.limit, arm.limit)
                for index, arm in enumerate(arms)
            ]
            self.state = self.state._replace(response=self.drives.response.start(np.concatenate(holding)))

    def _response(self, scenario: Scenario, arms: Sequence[ArmDrives]) -> TorqueResponse | None:
        """Return the response of all drives; None if each delivers and holds."""
        lags, rates = [], []
        for name, arm in zip(self._names, arms, strict=True):
            options, is_own = scenario.actuators_of(name), name in scenario.arm_actuators
            path = f"arm_actuators.{name}.rate_limit" if is_own else "actuators.rate_limit"
            limit = np.inf if options.rate_limit is None else options.rate_limit
            rates.append(per_joint(np.array(limit), len(arm.limit), path))
            lags.append(np.full(len(arm.limit), options.lag))
        lag, rate = np.concatenate(lags), np.concatenate(rates)
        if not lag.any() and np.isinf(rate).all() and np.isinf(self.lost_at).all():
            return None
        return TorqueResponse.of_drives(lag, rate)

    def holding_commands(self, q: Array) -> list[Array]:
        """Return the commands that hold the cell at rest, N m, shape (k,) each, read-only.

        Each arm holds its own weight, unless the robot itself does, and its load share of the payload's,
        without internal wrench.

        Args:
            q: Configuration of the cell at rest.
        """
        commands = []
        for index, arm in enumerate(self.drives.arms):
            torque = self._holding_torque(index, q)
            carried = 0.0 if arm.carried is None else arm.carried * self._weight(q, index)
            commands.append(frozen(torque - carried))
        return commands

    def apply(self, time: float, command: CellCommand, q: Array) -> Applied:
        """Return what the actuators make of a command.

        Args:
            time: Time of the tick, s.
            command: Output of the controller.
            q: Configuration of the cell, for gravity compensation.

        Raises:
            ShapeError: not one torque for each drive of each arm.
            DivergedError: a torque is not finite, or beyond 1e7 N m.
        """
        commanded = self.commanded(command)
        for name, torque in zip(self._names, commanded, strict=True):
            # "not <" also catches NaN; the squares cost a quarter of the largest.
            if (
                not torque.dot(torque) < TORQUE_LIMIT**2
                and not (largest := float(np.abs(torque).max())) < TORQUE_LIMIT
            ):
                raise DivergedError(time, f"torque of arm {name!r}, N m,", largest, TORQUE_LIMIT)
        since, self._start = time - self._start, time
        applied, self.state = self.drives.step(
            self.state,
            commanded,
            self._missed.draw(1)[0],
            partial(self._weight, q),
            () if self.is_held else self.gives(time),
            since,
        )
        return applied

    @property
    def is_held(self) -> bool:
        """Whether torques are held between ticks: no lag, no rate limit, none lost."""
        return self.drives.response is None

    def torques(self, time: float, duration: float = 0.0) -> list[Array]:
        """Return the mean torques of each arm from a time in the tick over a duration, N m, shape (k,) each.

        No arm loses its torque in between: plant steps end there. Without a duration they are those just
        before the time, which is after the last plant step.
        """
        response, state, s = self.drives.response, self.state.response, time - self._start
        assert response is not None
        assert state is not None
        if not duration:
            return self.drives.acting(response.at(state, s), self._gives)
        self._gives = self.gives(time)
        return self.drives.acting(response.mean(state, s, duration), self._gives)

    def gives(self, time: float) -> list[float]:
        """Return 1.0 for each arm that gives torque from a time on, s, and 0.0 for one that does not."""
        return [float(lost > time + _SAME * self.drives.period) for lost in self.lost_at]

    def _holding_torque(self, index: int, q: Array) -> Array:
        """Return T^-T (g(q) - J^T F) with F = c [m_0 g, 0], the arm's share of the load about P, (k,)."""
        place, model = self._places[index], self._models[index]
        rest = np.zeros(model.nv)
        tau = model.inverse_dynamics(q[place.q_slice], rest, rest, self._loads[index])
        return np.asarray(np.linalg.solve(place.drive.T, tau), dtype=np.float64)

    def _weight(self, q: Array, index: int) -> Array:
        """Return T^-T g(q): the arm's weight at its drives, N m, shape (k,)."""
        place, model = self._places[index], self._models[index]
        g = model.nonlinear_effects(q[place.q_slice], np.zeros(model.nv))
        return np.asarray(np.linalg.solve(place.drive.T, g), dtype=np.float64)

    def commanded(self, command: CellCommand) -> list[Array]:
        """Return the torques of a command as arrays.

        Raises:
            ShapeError: not one torque for each drive of each arm.
        """
        torques = [np.asarray(torque, dtype=np.float64) for torque in command.torques]
        if len(torques) != len(self._names):
            raise ShapeError(
                "the list of torques, one entry for each arm,", (len(torques),), (len(self._names),)
            )
        for name, torque, arm in zip(self._names, torques, self.drives.arms, strict=True):
            if torque.shape != arm.limit.shape:
                raise ShapeError(f"torque of arm {name!r}", torque.shape, arm.limit.shape)
        return torques


def _arm_drives(scenario: Scenario, place: ArmPlace, limits: JointLimits) -> ArmDrives:
    """Return the drives of an arm before lag."""
    options = scenario.actuators_of(place.name)
    robot = options.gravity_compensation
    carried = None if robot is None else 1.0 + robot.mass_error
    return ArmDrives(
        limits.torque,
        carried or None,
        options.missed_ticks > 0.0,
        options.commands_lost_at is not None,
        place.v_slice,
    )
