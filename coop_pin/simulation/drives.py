"""Drives: from commanded drive torques to those that act, see description/actuators.py for the equations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask, frozen
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.joint_limits import JointLimits, per_joint

_NO_LAG, _NO_RATE_LIMIT = 1e-30, 1e300
"""Stand for none in the equations of TorqueResponse: their product is large, too."""

SAME = 1e-9
"""Two times closer than this part of a tick are the same instant."""


class Applied(NamedTuple):
    """Torques at a tick, for each arm, N m, shape (k,); read-only.

    Attributes:
        commanded: torques by the controller.
        requested: torques asked of the drives: the last command that arrived and the robot's gravity
            compensation.
        torques: torques that act at the tick.
        saturated: mask of those that the torque limits cut, or their rate limits over the whole tick.
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
        at_once: mask of the drives with neither lag nor rate limit.
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
        return state.target - state.sign * error

    def mean(self, state: ResponseState, s: float, duration: float) -> Array:
        """Return the mean torques over a duration that begins at s: their exact impulse, shape (drives,)."""
        error = self._integrated_error(state, s + duration) - self._integrated_error(state, s)
        return state.target - state.sign * error / duration

    def _integrated_error(self, state: ResponseState, s: float) -> Array:
        """Return the integral of |u - tau| from t_k over s."""
        m = np.minimum(s, state.ramp / self.rate)
        decayed = m - self.lag * np.expm1((m - s) / self.lag)
        return (state.ramp - 0.5 * self.rate * m) * m + state.rest * decayed

    def is_limited(self, state: ResponseState, duration: float) -> Mask:
        """Return which torques still change at their largest rate after a duration, s, shape (drives,)."""
        return state.ramp > (1.0 + SAME) * self.rate * duration

    def cut(self, state: ResponseState, duration: float) -> Array:
        """Return the part of the change that the rate limit leaves out over a duration, N m, (drives,)."""
        left_out = np.where(self.is_limited(state, duration), state.ramp - self.rate * duration, 0.0)
        return state.sign * left_out


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
    ) -> tuple[Array, Array, Mask, Array, Array]:
        """Return the arm's entries of Applied after the first one, and its last command that arrived.

        Args:
            last: Last command that arrived, N m, shape (k,).
            command: Command of this tick, likewise.
            missed: Whether it is missed, a mask.
            weight: Torque that the robot adds, N m, shape (k,); None without gravity compensation.
        """
        arrived = np.where(missed, last, command) if self.misses else command
        requested = arrived if weight is None else arrived + weight
        torque = np.minimum(np.maximum(requested, -self.limit), self.limit)
        is_cut, reported = np.not_equal(torque, requested), command + (torque - requested)
        return requested, torque, frozen(is_cut), frozen(reported), arrived if self.misses else last


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
        entries = [
            arm.step(
                state.last[index],
                gives[index] * commanded[index] if arm.keeps_weight else commanded[index],
                missed[index],
                None if arm.carried is None else arm.carried * weight(index),
            )
            for index, arm in enumerate(self.arms)
        ]
        requested, torques, saturated, reported, last = zip(*entries, strict=True)
        applied = Applied(commanded, requested, torques, saturated, reported)
        if self.response is None or state.response is None:
            return applied, DriveState(last, None)
        response = self.response.step(state.response, s, np.concatenate(torques))
        limited = self.split(self.response.is_limited(response, self.period))
        left_out = self.response.cut(response, self.period)
        applied = applied._replace(
            torques=self.acting(self.response.at(response, 0.0), gives),
            saturated=[frozen(np.logical_or(*masks)) for masks in zip(saturated, limited, strict=True)],
            reported=[*map(frozen, self.acting(np.concatenate(reported) - left_out, gives))],
        )
        return applied, DriveState(last, response)

    def acting(self, torques: Array, gives: Sequence[float]) -> list[Array]:
        """Return the torques of each arm, zero where they are lost, of those of all drives."""
        return [
            torque if arm.keeps_weight else factor * torque
            for arm, factor, torque in zip(self.arms, gives, self.split(torques), strict=True)
        ]

    def split(self, values: Any) -> list[Any]:
        """Return the part of each arm of the values of all drives."""
        return [values[arm.entries] for arm in self.arms]


def cell_drives(scenario: Scenario, slots: Sequence[ArmPlace], limits: Sequence[JointLimits]) -> CellDrives:
    """Return the drives of a cell.

    Args:
        scenario: Cell, actuators and clock.
        slots: Positions of the arms in the cell's model.
        limits: Limits of each arm.

    Raises:
        FieldError: the number of rate limits differs from the number of an arm's joints.
    """
    arms = tuple(map(partial(_arm_drives, scenario), slots, limits))
    return CellDrives(arms, _response(scenario, [slot.name for slot in slots], arms), scenario.clock.period)


def _arm_drives(scenario: Scenario, slot: ArmPlace, limits: JointLimits) -> ArmDrives:
    """Return the drives of an arm before lag."""
    options = scenario.actuators_of(slot.name)
    robot = options.gravity_compensation
    carried = None if robot is None else 1.0 + robot.mass_error
    keeps_weight = options.commands_lost_at is not None
    return ArmDrives(limits.torque, carried or None, options.missed_ticks > 0.0, keeps_weight, slot.v_slice)


def _response(scenario: Scenario, names: Sequence[str], arms: Sequence[ArmDrives]) -> TorqueResponse | None:
    """Return the response of all drives; None if each delivers and holds."""
    options, rates = [scenario.actuators_of(name) for name in names], []
    for name, arm, each in zip(names, arms, options, strict=True):
        path = (
            f"arm_actuators.{name}.rate_limit" if name in scenario.arm_actuators else "actuators.rate_limit"
        )
        limit = np.inf if each.rate_limit is None else each.rate_limit
        rates.append(per_joint(np.array(limit), len(arm.limit), path))
    rate = np.concatenate(rates)
    lag = np.repeat([each.lag for each in options], [len(arm.limit) for arm in arms])
    is_lost = any(each.torque_lost_at is not None for each in options)
    if not (is_lost or lag.any() or np.isfinite(rate).any()):
        return None
    return TorqueResponse.of_drives(lag, rate)
