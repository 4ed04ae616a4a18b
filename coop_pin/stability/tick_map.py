"""Map of a run's whole state over ticks, its derivative by central differences, and names of its modes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coop_pin.base.arrays import Array
from coop_pin.base.errors import ArgumentError
from coop_pin.simulation.devices.torque_response import ResponseState
from coop_pin.simulation.run_state import RunState
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.modes import Motions

MEMORY = "memory"
"""Name of modes that neither move the chain nor change an internal wrench."""
_STEP = 1e-5
"""Step of the differences, rad, m, N, N m and their rates."""
_KINK = 0.05
"""Difference of the two one-sided slopes, as a part of the slopes, from which the map is not smooth."""
_SAME = 1e-9
"""Part of a memory that may change in a tick, and part of it by other states, while it counts as constant."""
_MICRO = 1e6
"""A mode moves if it does so by more um and urad than N and N m of internal wrench: fast ones need forces."""
_SEEN = 1e-4
"""Part of a mode below which neither motion, um and urad, nor internal wrench is in it."""


class TickMap:
    """Map x -> x' of the state of a run over N ticks about its present state.

    x holds the motions y that the closures leave, their speeds w, and memories: forces of the drives just
    before the tick, torques in lag, torques that drives have reported, sensors and force path, the law,
    servos, messages.

    Attributes:
        moving: number of the entries y and w.
    """

    def __init__(self, simulation: Simulation, ticks: int) -> None:
        """Take the present state of a simulation as origin.

        Args:
            simulation: Simulation between two ticks, at least one after its start; its state changes.
            ticks: N.
        """
        self._simulation, self._ticks, self._origin = simulation, ticks, simulation.state()
        chain, q = simulation.chain, simulation.plant.q
        self._chain, self._motions = chain.mechanism, Motions.at(chain, q)
        self._linked = chain.model.linked
        self._arms, self._rows, self._R_WP = (
            chain.model.arms,
            chain.cell.task_rows,
            chain.payload_pose(q)[:3, :3],
        )
        self._driven = np.concatenate([np.r_[slot.v_slice] for slot in self._arms])
        self._shares = np.array([chain.cell.share(slot.name) for slot in self._arms])
        self._basis = self._motions.basis
        self.moving = 2 * self._basis.shape[1]
        self._end = self._origin

    def jacobian(self) -> tuple[Array, Array, int]:
        """Return dx'/dx and the internal wrenches by x, without constants, and the number of these.

        Raises:
            ArgumentError: the map is not smooth at the origin, or the law keeps what is no number.
        """
        numbers, n = [*_numbers(self._memories(self._origin))], self._basis.shape[1]
        count = 2 * n + sum(number.size for number in numbers)
        scalars = np.repeat([number.ndim == 0 for number in numbers], [number.size for number in numbers])
        rest = np.zeros(count)
        self._response(rest)  # on the closures, as the others: the state of a run is off them by its rounding
        self._end = self._simulation.state()
        middle, columns, counters = self._response(rest), [], []
        for k, unit in enumerate(_STEP * np.eye(count)):
            ahead, behind = self._response(unit), self._response(-unit)
            slope, kink = (ahead - behind) / (2.0 * _STEP), (ahead + behind - 2.0 * middle) / _STEP
            is_smooth = np.abs(kink).max() <= _KINK * (1.0 + np.abs(slope).max())
            counters.append(not is_smooth)
            if not is_smooth and not (k >= 2 * n and scalars[k - 2 * n]):
                raise ArgumentError(
                    f"the tick at t = {self._simulation.time:.6g} s is not smooth: a torque or rate limit, or"
                    f" the edge of a boundary layer, is within {_STEP:g} of the state; take another time,"
                    " smaller gains or a wider layer"
                )
            columns.append(slope)
        slopes = np.array(columns).T
        A, outputs = slopes[:count], slopes[count:]
        is_held = np.abs(A - np.eye(count)).max(axis=1) < _SAME
        dropped = (is_held & (np.arange(count) >= 2 * n)) | np.array(counters)
        return A[np.ix_(~dropped, ~dropped)], outputs[:, ~dropped], int(dropped.sum())

    def mode_name(self, mode: NDArray[np.complex128], wrenches: NDArray[np.complex128]) -> str:
        """Return what moves most in a mode, or whose internal wrench changes.

        Args:
            mode: eigenvector x.
            wrenches: internal wrenches in it in payload axes, task rows of one arm after the other.
        """
        n, period = self._basis.shape[1], self._simulation.scenario.clock.period
        y = max(mode[:n], period * mode[n : 2 * n], key=np.linalg.norm)
        moved, pulled = _MICRO * np.linalg.norm(y), np.linalg.norm(wrenches)
        if moved + pulled < _SEEN * np.linalg.norm(mode):
            return MEMORY
        if moved < pulled:
            arm, row = np.unravel_index(np.argmax(np.abs(wrenches)), (len(self._arms), self._rows.size))
            of_arm = f" of {self._arms[arm].name}" if len(self._arms) > 2 else ""
            kind = "moment" if self._rows.indices[row] > 2 else "force"
            return f"internal {kind} {_axis(self._rows.axes[row])}{of_arm}"
        if self._motions.is_spare(y):
            speeds = np.abs(self._basis @ y)
            mover = max(self._arms, key=lambda slot: np.linalg.norm(speeds[slot.v_slice]))
            if (linked := self._linked) is not None:
                of_joints = speeds[linked.v_slice]
                if np.linalg.norm(of_joints) > np.linalg.norm(speeds[mover.v_slice]):
                    return f"payload's joint {linked.joint_names[np.argmax(of_joints)]}"
            return f"posture of {mover.name}"
        return f"payload {_axis(self._rows.axes[np.argmax(np.abs(self._motions.payload @ y))])}"

    def _response(self, deviation: Array) -> Array:
        """Return x' and internal wrenches after N ticks from a deviation x."""
        self._simulation.restore(self._moved(deviation))
        for _ in range(self._ticks):
            self._simulation.tick()
        return self._coordinates()

    def _coordinates(self) -> Array:
        """Return x about the end of the undisturbed ticks, and internal wrenches, at the present state."""
        state, plant = self._simulation.state(), self._simulation.plant
        y = self._basis.T @ pin.difference(self._chain.model, self._end.plant.q, state.plant.q)
        wrenches = plant.interaction_wrenches()
        internal = wrenches - self._shares[:, None] * wrenches.sum(axis=0)
        turned = (internal.reshape(-1, 2, 3) @ self._R_WP).reshape(-1, 6)
        memories = [np.ravel(number) for number in _numbers(self._memories(state))]
        x = np.concatenate(
            (y, self._basis.T @ state.plant.v, *memories, self._rows.select(turned.T).T.ravel())
        )
        return np.where(np.isfinite(x), x, 0.0)

    def _memories(self, state: RunState) -> tuple[Any, ...]:
        """Return the memories of a state: of drives, sensors, law, servos and network."""
        assert state.applied is not None
        assert state.sensing is not None
        torque, response = None, self._simulation.actuation.drives.response
        if response is not None and state.actuation.drives.response is not None:
            torque = response.at(state.actuation.drives.response, self._simulation.scenario.clock.period)
        force, drives = state.plant.force[self._driven], state.actuation.drives
        inner = drives.servos, drives.held
        sensors, reported = state.sensing.sensors, state.applied.reported
        return force, torque, reported, sensors, state.controller_state, inner, state.network

    def _moved(self, deviation: Array) -> RunState:
        """Return the origin with a deviation, on the closures."""
        state, n = self._origin, self._basis.shape[1]
        assert state.applied is not None
        assert state.sensing is not None
        q = pin.integrate(self._chain.model, state.plant.q, self._basis @ deviation[:n])
        q = self._chain.project_configuration(q)
        v = self._chain.project_velocity(q, state.plant.v + self._basis @ deviation[n : 2 * n])
        (driven, torque, reported, sensors, law, (servos, held), network), _ = _moved(
            self._memories(state), deviation[2 * n :]
        )
        force, drives = state.plant.force.copy(), state.actuation.drives._replace(servos=servos, held=held)
        force[self._driven] = driven
        if torque is not None:
            drives = drives._replace(response=ResponseState(torque, *np.zeros((3, len(torque)))))
        return state._replace(
            plant=state.plant._replace(q=q, v=v, force=force),
            actuation=state.actuation._replace(drives=drives),
            applied=state.applied._replace(reported=reported),
            sensing=state.sensing._replace(sensors=sensors),
            controller_state=law,
            network=network,
        )


def _axis(label: str) -> str:
    """Return where a task row points, of its label, "x" or "rx"."""
    return f"about {label[1]}" if label.startswith("r") else f"along {label}"


def _numbers(tree: Any) -> Iterator[Array]:
    """Yield the arrays and numbers of nested tuples and lists.

    Raises:
        ArgumentError: something else is in them.
    """
    if isinstance(tree, np.ndarray) and tree.dtype == np.float64:
        yield tree
    elif isinstance(tree, float):
        yield np.array(tree)
    elif isinstance(tree, tuple | list):
        for part in tree:
            yield from _numbers(part)
    elif not (tree is None or isinstance(tree, int | str)):
        raise ArgumentError(
            f"the law keeps a {type(tree).__name__}, which has no derivative; keep tuples of numbers and"
            " arrays"
        )


def _moved(tree: Any, deviations: Array) -> tuple[Any, Array]:
    """Return nested tuples and lists with deviations added, in the order of ``_numbers``, and the others."""
    if isinstance(tree, np.ndarray):
        return tree + deviations[: tree.size].reshape(tree.shape), deviations[tree.size :]
    if isinstance(tree, float):
        return tree + float(deviations[0]), deviations[1:]
    if isinstance(tree, tuple | list):
        parts = []
        for part in tree:
            moved, deviations = _moved(part, deviations)
            parts.append(moved)
        return (type(tree)(*parts) if hasattr(tree, "_fields") else type(tree)(parts)), deviations
    return tree, deviations
