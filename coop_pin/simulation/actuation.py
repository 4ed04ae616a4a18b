"""Actuation: from commanded drive torques to the torques that act, see description/actuators.py.

Like the plant, the actuation holds state that changes in place: last commands, torques in lag, lost arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask, frozen
from coop_pin.control.interface import CellCommand
from coop_pin.description.scenario import Scenario
from coop_pin.errors import DivergedError, ShapeError
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.joint_limits import JointLimits, per_joint
from coop_pin.simulation.noise import generator
from coop_pin.simulation.plant import Plant
from coop_pin.spatial import weight_wrench

TORQUE_LIMIT = 1e7
"""A larger command counts as diverged, N m."""

_NO_LAG, _NO_RATE_LIMIT = 1e-30, 1e300
"""Stand for none in the equations of TorqueResponse: their product is large, too."""

_SAME = 1e-9
"""Two times closer than this part of a tick are the same instant."""


class Applied(NamedTuple):
    """Torques at a tick, for each arm, N m, shape (k,).

    Attributes:
        commanded: by the controller.
        requested: of the drives: the last command that arrived and the robot's gravity compensation.
        torques: that act at the tick.
        saturated: which of them the torque limits cut, or their rate limits over the whole tick; read-only.
        force: the generalised force of the torques, N m, shape (nv,).
    """

    commanded: list[Array]
    requested: list[Array]
    torques: list[Array]
    saturated: list[Mask]
    force: Array


class ArmActuation:
    """What one arm makes of a command before lag: missed ticks, gravity compensation, torque limits.

    Attributes:
        limit: of the torques, N m, shape (k,).
        carried: 1 + mass_error of the robot's gravity compensation, 0 without.
    """

    def __init__(self, scenario: Scenario, place: ArmPlace, limit: Array, q: Array) -> None:
        """Start with the command that holds the arm at q, the configuration of the cell."""
        options, cell, self.limit = scenario.actuators_of(place.name), scenario.cell, limit
        self._place, self._model = place, ArmModel.from_cell(cell, place.name)
        share = cell.shares[list(cell.arms).index(place.name)]
        self._load = share * weight_wrench(cell.payload.mass, cell.gravity)
        robot, self._missed = options.gravity_compensation, options.missed_ticks
        self.carried = 0.0 if robot is None else 1.0 + robot.mass_error
        self._random = generator(scenario.seed, f"{place.name}/missed_ticks") if self._missed else None
        self._last = self.holding_command(q)

    def holding_torque(self, q: Array) -> Array:
        """Return T^-T (g(q) - J^T F) with F = c [m_0 g, 0], the arm's share of the load about P, (k,)."""
        rest = np.zeros(len(self.limit))
        return self._at_drives(self._model.inverse_dynamics(q[self._place.q_slice], rest, rest, self._load))

    def holding_command(self, q: Array) -> Array:
        """Return the command that makes the drives hold: without what the robot itself adds, shape (k,)."""
        torque = self.holding_torque(q)
        return torque - self._carried_weight(q) if self.carried else torque

    def torque(self, command: Array, q: Array) -> tuple[Array, Array, Mask]:
        """Return the torque asked for, that within the limits, and where it was cut, (k,); read-only."""
        if self._random is not None:
            if self._random.random() < self._missed:
                command = self._last
            self._last = command = command.copy()
        asked = command + self._carried_weight(q) if self.carried else command
        torque: Array = np.minimum(np.maximum(asked, -self.limit), self.limit)
        return asked, torque, frozen(torque != asked)

    def _carried_weight(self, q: Array) -> Array:
        """Return (1 + mass_error) T^-T g(q): the arm's weight by the robot's model of itself, (k,)."""
        rest = np.zeros(len(self.limit))
        return self.carried * self._at_drives(self._model.nonlinear_effects(q[self._place.q_slice], rest))

    def _at_drives(self, tau: Array) -> Array:
        """Return T^-T tau, shape (k,)."""
        return np.asarray(np.linalg.solve(self._place.drive.T, tau), dtype=np.float64)


class TorqueResponse(NamedTuple):
    """Torques of drives with lag and rate limit: d tau/dt = clip((u - tau) / lag, -rate, rate).

    With e = u - tau(t_k) they first change by D = max(|e| - rate lag, 0) at the largest rate, then decay:

        tau(t_k + s) = u - sgn(e) (D - rate m + (|e| - D) exp(-(s - m) / lag)) with m = min(s, D / rate)

    Every row has one value for each drive.

    Attributes:
        at_once: which drives have neither lag nor rate limit.
        lag: s.
        rate: N m/s.
        target: u, N m.
        sign: sgn(e).
        ramp: D, N m.
        rest: |e| - D, N m.
    """

    at_once: Mask
    lag: Array
    rate: Array
    target: Array
    sign: Array
    ramp: Array
    rest: Array

    @classmethod
    def at_rest(cls, lag: Array, rate: Array, torque: Array) -> TorqueResponse:
        """Return the response at rest at a torque, shape (drives,) each; lag 0 and rate inf where none."""
        at_once = (lag == 0.0) & np.isinf(rate)
        lag, rate = np.maximum(lag, _NO_LAG), np.minimum(rate, _NO_RATE_LIMIT)
        return cls(at_once, lag, rate, torque, *np.zeros((3, len(torque))))

    def follow(self, s: float, target: Array) -> TorqueResponse:
        """Return the response to new torques to follow, shape (drives,), s seconds after the last."""
        error = np.where(self.at_once, 0.0, target - self.at(s))
        ramp = np.maximum(np.abs(error) - self.rate * self.lag, 0.0)
        return self._replace(target=target, sign=np.sign(error), ramp=ramp, rest=np.abs(error) - ramp)

    def at(self, s: float) -> Array:
        """Return the torques s seconds after the last target, N m, shape (drives,)."""
        m = np.minimum(s, self.ramp / self.rate)
        error = self.ramp - self.rate * m + self.rest * np.exp((m - s) / self.lag)
        torque: Array = self.target - self.sign * error
        return torque

    def mean(self, s: float, duration: float) -> Array:
        """Return the mean torques over a duration that begins at s: their exact impulse, shape (drives,)."""
        error = self._integrated_error(s + duration) - self._integrated_error(s)
        torque: Array = self.target - self.sign * error / duration
        return torque

    def _integrated_error(self, s: float) -> Array:
        """Return the integral of |u - tau| from t_k over s."""
        m = np.minimum(s, self.ramp / self.rate)
        decayed = m - self.lag * np.expm1((m - s) / self.lag)
        integral: Array = (self.ramp - 0.5 * self.rate * m) * m + self.rest * decayed
        return integral

    def is_limited(self, duration: float) -> Mask:
        """Return which torques still change at their largest rate after a duration, s, shape (drives,)."""
        limited: Mask = self.ramp > (1.0 + _SAME) * self.rate * duration
        return limited


class Actuation:
    """Actuators of all arms: check a command, make torques of it, map them to generalised forces.

    Attributes:
        arms: what each makes of its commands.
        response: of all drives; None if torques are held between ticks.
        lost_at: when each arm loses its torque, s; inf for never.
    """

    def __init__(self, scenario: Scenario, plant: Plant, limits: Sequence[JointLimits]) -> None:
        """Start from the torques that hold the cell at rest at the plant's configuration.

        Args:
            scenario: for actuators and seed.
            plant: for its configuration and transmission.
            limits: of each arm, in the order of the arms.

        Raises:
            FieldError: the number of rate limits differs from the number of an arm's joints.
        """
        places = plant.chain.model.arms
        self._transmission, self._period = plant.transmission, scenario.clock.period
        self.arms = {
            place.name: ArmActuation(scenario, place, limit.torque, plant.q)
            for place, limit in zip(places, limits, strict=True)
        }
        lost = [scenario.actuators_of(name).torque_lost_at for name in self.arms]
        self.lost_at = [np.inf if time is None else time for time in lost]
        self._edges = np.cumsum([len(place.drive) for place in places])[:-1]
        self._gives, self._start = self.gives(0.0), 0.0
        self.response = self._lagging(scenario, plant.q)

    def _lagging(self, scenario: Scenario, q: Array) -> TorqueResponse | None:
        """Return the response of all drives from the holding torques; None if each delivers and holds."""
        lags, rates = [], []
        for name, arm in self.arms.items():
            options, own = scenario.actuators_of(name), name in scenario.arm_actuators
            path = f"arm_actuators.{name}.rate_limit" if own else "actuators.rate_limit"
            limit = np.inf if options.rate_limit is None else options.rate_limit
            rates.append(per_joint(np.array(limit), len(arm.limit), path))
            lags.append(np.full(len(arm.limit), options.lag))
        lag, rate = np.concatenate(lags), np.concatenate(rates)
        if not lag.any() and np.isinf(rate).all() and np.isinf(self.lost_at).all():
            return None
        holding = [np.clip(arm.holding_torque(q), -arm.limit, arm.limit) for arm in self.arms.values()]
        return TorqueResponse.at_rest(lag, rate, np.concatenate(holding))

    def holding_commands(self, q: Array) -> list[Array]:
        """Return the commands that hold the cell at rest, N m, shape (k,) each, read-only.

        Each arm holds its own weight, unless the robot itself does, and its load share of the payload's,
        without internal wrench.

        Args:
            q: configuration of the cell at rest.
        """
        return [frozen(arm.holding_command(q)) for arm in self.arms.values()]

    def apply(self, time: float, command: CellCommand, q: Array) -> Applied:
        """Return what the actuators make of a command.

        Args:
            time: of the tick, s.
            command: the controller's output.
            q: configuration of the cell, for gravity compensation.

        Raises:
            ShapeError: not one torque for each drive of each arm.
            DivergedError: a torque is not finite, or beyond 1e7 N m.
        """
        commanded, requested = self.commanded(command), []
        torques, saturated = [], []
        for (name, arm), asked in zip(self.arms.items(), commanded, strict=True):
            largest = float(np.abs(asked).max())
            if not largest < TORQUE_LIMIT:  # also catches NaN
                raise DivergedError(time, f"torque of arm {name!r}, N m,", largest, TORQUE_LIMIT)
            wanted, torque, cut = arm.torque(asked, q)
            requested.append(wanted)
            torques.append(torque)
            saturated.append(cut)
        if self.response is not None:
            self.response = self.response.follow(time - self._start, np.concatenate(torques))
            self._start, self._gives = time, self.gives(time)
            limited = np.split(self.response.is_limited(self._period), self._edges)
            saturated = [frozen(cut | late) for cut, late in zip(saturated, limited, strict=True)]
            torques = self._acting(self.response.at(0.0))
        return Applied(commanded, requested, torques, saturated, self._transmission.torque(torques))

    def force(self, response: TorqueResponse, time: float) -> Array:
        """Return the generalised force just before a time, after the last tick, N m, shape (nv,)."""
        return self._transmission.torque(self._acting(response.at(time - self._start)))

    def mean_force(self, response: TorqueResponse, time: float, duration: float) -> Array:
        """Return the mean generalised force from a time over a duration in the tick, N m, shape (nv,).

        No arm loses its torque in between: plant steps end there.
        """
        self._gives = self.gives(time)
        return self._transmission.torque(self._acting(response.mean(time - self._start, duration)))

    def gives(self, time: float) -> list[float]:
        """Return 1.0 for each arm that gives torque from a time on, s, and 0.0 for one that does not."""
        return [float(lost > time + _SAME * self._period) for lost in self.lost_at]

    def _acting(self, torques: Array) -> list[Array]:
        """Return the torques of each arm, zero where they are lost."""
        parts = np.split(torques, self._edges)
        return [gives * torque for gives, torque in zip(self._gives, parts, strict=True)]

    def commanded(self, command: CellCommand) -> list[Array]:
        """Return the torques of a command as arrays.

        Raises:
            ShapeError: not one torque for each drive of each arm.
        """
        torques = [np.asarray(torque, dtype=np.float64) for torque in command.torques]
        if len(torques) != len(self.arms):
            raise ShapeError(
                "the list of torques, one entry for each arm,", (len(torques),), (len(self.arms),)
            )
        for (name, arm), torque in zip(self.arms.items(), torques, strict=True):
            if torque.shape != arm.limit.shape:
                raise ShapeError(f"torque of arm {name!r}", torque.shape, arm.limit.shape)
        return torques
