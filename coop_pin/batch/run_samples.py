"""Samples of a batch, with the names and shapes of a single run's and a leading axis of runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from coop_pin.arrays import Array
from coop_pin.batch.preparation import Prepared
from coop_pin.chain.cell_chain import determinate_rows
from coop_pin.errors import InvalidStateError
from coop_pin.model.cell_model import ArmPlace
from coop_pin.results.quantities import Samples
from coop_pin.simulation.plant import CHANNELS
from coop_pin.spatial import internal_wrenches
from coop_pin.tracing.kernel import Layout

_Sources = dict[str, Callable[[], NDArray[Any]]]
"""What gives quantities, by name."""
_MARGIN, _LARGEST_BOUND = 1e-6, 1e3
"""Of bounds of condition numbers: for rounding, and up to which they are that accurate."""


class RunSamples(Mapping[str, NDArray[Any]]):
    """Quantities that some runs of a batch have, by name, shape (runs, samples, ...); made when asked for."""

    def __init__(self, prepared: Prepared, layout: Layout, records: Sequence[Array]) -> None:
        """Make nothing yet.

        Args:
            prepared: the batch.
            layout: of the records' slots.
            records: of blocks of its runs, as a Machine returns them.
        """
        self._prepared, self._layout = prepared, layout
        self._records: Sequence[Array] | None = records
        self._plant, scenario = prepared.plants[0], prepared.scenarios[0]
        self._places, self._rows = self._plant.run.plant.chain.model.arms, scenario.cell.task_rows
        last, every = self._plant.run.timeline.ticks, scenario.clock.record_every
        self._kept = [tick for tick in range(last + 1) if tick % every == 0 or tick == last]
        tables = {id(plant): plant.table for plant in prepared.plants}.values()
        recorded, self._made = self._state() | self._joints(), dict[str, NDArray[Any]]()
        self._sources: _Sources = {
            each.name: recorded.get(each.name) or partial(cast(Any, each.source), self)
            for table in tables
            for each in table
        }

    def __iter__(self) -> Iterator[str]:
        """Yield the names."""
        return iter(self._sources)

    def __len__(self) -> int:
        """Return the number of quantities."""
        return len(self._sources)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a quantity."""
        if name not in self._made:
            with np.errstate(all="ignore"):  # of runs that are not valid
                self._made[name] = self._sources[name]()
        return self._made[name]

    def extremes(self, allowed: float) -> Samples:
        """Return the extremes in time of what metrics and trust need no more of, as one or two samples.

        Args:
            allowed: condition number; of runs that keep below it, upper bounds are given, which cost little.
        """
        errors, bounds = (self._field(name).max(axis=1) for name in ("closure_errors", "condition_bounds"))
        is_beyond = ~(bounds <= (1.0 - _MARGIN) * min(allowed, _LARGEST_BOUND)).all(axis=1)
        if is_beyond.any():
            jacobians = self._field("jacobians")[is_beyond]
            bounds[is_beyond] = _conditions(jacobians, self._rows.size, self._places).max(axis=1)
        positions, torque = self["joint_position"], self._field("torque")
        return {
            "joint_position": np.stack((positions.min(axis=1), positions.max(axis=1)), axis=1),
            "torque": np.stack((torque.min(axis=1), torque.max(axis=1)), axis=1)[:, :, None],
            "jacobian_condition": bounds[:, None],
            "closure_distance": errors[:, None, :, 0],
            "closure_angle": errors[:, None, :, 1],
        }

    def release(self) -> None:
        """Drop the records; samples that were not asked for until now cannot be made any more."""
        self._records = None

    def _field(self, name: str) -> Array:
        """Return a copy of what was recorded of a field of the block; raises as BatchResult.release."""
        if self._records is None:
            raise InvalidStateError(f"the batch was released before {name!r} was read; read samples before")
        slots = self._layout.slots(name)
        mine = slice(slots.min(), slots.max() + 1)
        # Of one layout for any number of runs: numpy's functions choose their order of operations by it.
        blocks = [np.moveaxis(record[:, mine], 2, 0) for record in self._records]
        runs = [np.array(block, order="C").reshape(-1, len(self._kept), *slots.shape) for block in blocks]
        return runs[0] if len(runs) == 1 else np.concatenate(runs)

    def _signal(self, name: str) -> Array:
        slots, given = self._plant.layout.slots(name), self._prepared.signals
        known = {id(signals): signals[self._kept][:, slots] for signals in given}
        return np.stack([known[id(signals)] for signals in given])

    def _by_arm(self, name: str) -> list[tuple[Array, ArmPlace]]:
        ends = np.cumsum([len(place.drive) for place in self._places])
        return list(zip(np.split(self._field(name), ends[:-1], axis=2), self._places, strict=True))

    def _per_joint(self, name: str) -> Array:
        return _padded([own for own, _ in self._by_arm(name)])

    def _at_drives(self, name: str) -> Array:
        return _padded([own @ place.drive.T for own, place in self._by_arm(name)])

    def _six(self, rows: Array) -> Array:
        """Return rows of wrenches in their places, NaN elsewhere."""
        full = np.full((*rows.shape[:-1], 6), np.nan)
        full[..., self._rows.indices] = rows
        return full

    def _pose(self) -> Array:
        positions = self._field("p_WP")
        pose = np.zeros((*positions.shape[:2], 4, 4))
        pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = self._field("R_WP"), positions, 1.0
        return pose

    def _state(self) -> _Sources:
        """Return what gives the quantities of payload and cell."""
        field, signal, plant = self._field, self._signal, self._plant.run.plant
        determined = determinate_rows(plant.chain, plant.q)
        shares = [scenario.cell.shares for scenario in self._prepared.scenarios]
        return {
            "time": lambda: signal("time"),
            "velocity": lambda: field("v"),
            "payload_pose": self._pose,
            "payload_twist": lambda: field("V_WP"),
            "desired_pose": lambda: signal("pose"),
            "desired_twist": lambda: signal("twist"),
            "desired_squeeze": lambda: signal("squeeze"),
            "tip_position": lambda: field("tips"),
            "interaction_wrench": lambda: np.where(determined, field("wrenches"), np.nan),
            "internal_wrench": lambda: np.stack(
                list(map(internal_wrenches, self["interaction_wrench"], shares))
            ),
            "external_wrench": lambda: field("external"),
            "closure_distance": lambda: field("closure_errors")[..., 0],
            "closure_angle": lambda: field("closure_errors")[..., 1],
            "kinetic_energy": lambda: field("kinetic"),
            "potential_energy": lambda: field("potential"),
            **{
                f"work_{name}": partial(lambda channel: field("work")[..., channel], channel)
                for channel, name in enumerate(CHANNELS)
            },
            "work_payload_change": lambda: field("payload_energy"),
        }

    def _joints(self) -> _Sources:
        """Return what gives the quantities of joints, drives and sensors."""
        field, signal, per_joint, places = self._field, self._signal, self._per_joint, self._places
        rows, has_wrist = self._rows.indices, np.array(self._plant.shape.has_wrist)[:, None]
        return {
            "configuration": lambda: np.concatenate(
                [place.angles.configuration(q) for q, place in self._by_arm("q")], axis=2
            ),
            "torque": lambda: per_joint("torque"),
            "commanded_torque": lambda: per_joint("commanded"),
            "saturated": lambda: per_joint("saturated") > 0.0,
            "drive_velocity": lambda: self._at_drives("v"),
            "joint_position": lambda: per_joint("q"),
            "joint_velocity": lambda: per_joint("v"),
            "jacobian_condition": lambda: _conditions(field("jacobians"), self._rows.size, places),
            "requested_torque": lambda: per_joint("requested"),
            "drive_position": lambda: self._at_drives("q"),
            "measured_drive_position": lambda: per_joint("seen_q"),
            "measured_drive_velocity": lambda: per_joint("seen_v"),
            "seen_pose": lambda: field("seen_poses"),
            "measured_wrench": lambda: np.where(has_wrist, self._six(field("readings")[..., rows]), np.nan),
            "measured_wrench_age": lambda: signal("wrist_age"),
            "measured_internal_wrench": lambda: self._six(field("measured")),
            "measured_internal_wrench_age": lambda: signal("age"),
        }


def _conditions(jacobians: Array, rows: int, places: Sequence[ArmPlace]) -> Array:
    """Return the condition number of each arm's payload Jacobian, shape (runs, samples, m); NaN after NaN."""
    parts = np.split(jacobians, rows * np.cumsum([len(place.drive) for place in places])[:-1], axis=2)
    conditions = np.full((*jacobians.shape[:2], len(places)), np.nan)
    for index, part in enumerate(parts):
        is_finite = np.isfinite(part).all(axis=2)
        conditions[is_finite, index] = np.linalg.cond(
            part[is_finite].reshape(-1, rows, part.shape[2] // rows)
        )
    return conditions


def _padded(parts: Sequence[Array]) -> Array:
    """Return values of the joints or drives of each arm, NaN beyond its own, shape (runs, samples, m, k)."""
    table = np.full((*parts[0].shape[:2], len(parts), max(part.shape[2] for part in parts)), np.nan)
    for index, part in enumerate(parts):
        table[:, :, index, : part.shape[2]] = part
    return table
