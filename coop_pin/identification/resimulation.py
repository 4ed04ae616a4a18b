"""Re-simulation: the internal force of every parameter from runs with that cause alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import TracingError
from coop_pin.compiled.simulate import simulate_batch
from coop_pin.description.scenario import Scenario
from coop_pin.identification.effects import Effects, friction_parameters
from coop_pin.identification.error_changes import error_changes
from coop_pin.identification.estimate import Parameter
from coop_pin.identification.friction import DriveFriction
from coop_pin.model.transmission import friction as stated_friction
from coop_pin.results.run_result import RunResult

_PART = 0.1
"""Part of a drive's friction that is taken away."""
_NEAR = 0.5
"""Time about the start in which the run may have begun, s."""


class CauseRuns:
    """Runs of a cell with some causes alone, without noise of the sensors.

    Attributes:
        times: times of the log, s, shape (n,).
        effects: forces by single parameters: quotients by the size of each, its estimate or its prior where
            that is larger, since laws that switch do not answer in proportion. Of a drive's friction a tenth
            is taken away, since a cell without any may not be stable.
    """

    def __init__(
        self,
        scenario: Scenario,
        parameters: Sequence[Parameter],
        friction: Sequence[DriveFriction],
        x: Array,
        prior: Array,
        start: float,
        seen: Callable[[Array], Array],
    ) -> None:
        """Run every parameter alone.

        Args:
            scenario: cell and law that ran.
            parameters: parameters of kinematics and wrists.
            friction: friction of drives; its columns follow those of the parameters, one each.
            x: estimates of the parameters, shape (p,).
            prior: their standard deviations before, shape (p,).
            start: time of the log at which the arms hold the payload, s; the run began near it.
            seen: position of the payload by the time of the log, m, shape (n, 3).

        Raises:
            TracingError: compiled code does not have the law or the cell, or a run fails.
            MissingExtraError: llvmlite is not installed.
        """
        self._cell = scenario.override(_friction(scenario, friction, None))
        self._none = dict.fromkeys(parameters, 0.0)
        sizes = np.where(np.abs(x) > prior, x, prior)
        cells = [self._with({one: size}) for one, size in zip(parameters, sizes.tolist(), strict=True)]
        cells += [self._with({}).override(_friction(scenario, friction, one)) for one in friction]
        first, *made = self._run([self._with({}), *cells])
        signs = np.append(1.0 / sizes, np.full(len(friction), -1.0 / _PART))
        self._plain, read = self._forces(first)
        by_unit = [
            (sign * (phi - self._plain), sign * (reading - read))
            for sign, (phi, reading) in zip(signs, map(self._forces, made), strict=True)
        ]
        force, reading = (np.stack(columns, axis=-1) for columns in zip(*by_unit, strict=True))
        at, position = first.data.time.values, first.data.payload_position.values
        everything = (*parameters, *friction_parameters(friction))
        times = at + _began(at, position, start, seen)
        without = read - reading[..., len(parameters) :].sum(axis=-1)
        self.effects = Effects(times, everything, force, reading, without)

    def newtons(self, causes: Sequence[Mapping[Parameter, float]]) -> list[float]:
        """Return the norm of the force on an arm that each of some causes makes alone, mean over the run, N.

        Args:
            causes: values of the parameters of each cause.
        """
        made = self._run([self._with({}), *map(self._with, causes)])[1:]
        forces = [self._forces(one)[0] - self._plain for one in made]
        return [float(np.linalg.norm(one, axis=2).max(axis=1).mean()) for one in forces]

    def _with(self, values: Mapping[Parameter, float]) -> Scenario:
        return self._cell.override(error_changes(self._cell, {**self._none, **values}, noise=False))

    def _run(self, cells: Sequence[Scenario]) -> list[RunResult]:
        batch = simulate_batch(cells)
        if not batch.is_valid.all():
            raise TracingError("a run with one cause alone fails")
        return [batch.result(k) for k in range(len(cells))]

    def _forces(self, result: RunResult) -> tuple[Array, Array]:
        """Return the internal force on each arm, and that which wrists read, N, shape (n, m, rows)."""
        data, cell = result.data, self._cell.cell
        rows = [k for k in cell.task_rows.indices if k < 3]
        F = data.measured_wrench if "measured_wrench" in data else data.interaction_wrench
        F = np.nan_to_num(F.values)[:, :, rows]
        internal = F - np.array(cell.shares)[:, None] * F.sum(axis=1, keepdims=True)
        return data.internal_wrench.values[:, :, rows], internal


def _began(times: Array, position: Array, start: float, seen: Callable[[Array], Array]) -> float:
    """Return the time of the log at which its motion is that of a run, s."""
    near = start + np.linspace(-_NEAR, _NEAR, 201)
    kept = slice(None, None, max(len(times) // 200, 1))
    off = [np.linalg.norm(seen(times[kept] + shift) - position[kept]) for shift in near]
    return float(near[int(np.argmin(off))])


def _friction(
    scenario: Scenario, friction: Sequence[DriveFriction], less: DriveFriction | None
) -> dict[str, Any]:
    """Return the changes that give the arms the estimated friction, and less of it to one drive."""
    changes: dict[str, Any] = {}
    for name in dict.fromkeys(one.arm for one in friction):
        stated = stated_friction(scenario.cell.arms[name], name)
        rows = {"viscous": stated.viscous.tolist(), "coulomb": stated.coulomb.tolist()}
        for one in friction:
            if one.arm == name:
                factor = 1.0 - _PART * (one is less)
                rows["viscous"][one.drive] = factor * max(one.viscous, 0.0)
                rows["coulomb"][one.drive] = factor * max(one.coulomb, 0.0)
        changes[f"cell.arms.{name}.friction"] = rows
    return changes
