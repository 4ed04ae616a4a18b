"""Samples of a batch, with the names and shapes of a single run's and a leading axis of runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InvalidStateError
from coop_pin.base.spatial import internal_wrenches
from coop_pin.compiled.constants import Desired
from coop_pin.compiled.plant.plant_code import observation_field, observed
from coop_pin.compiled.preparation import Prepared
from coop_pin.compiled.prepared_plant import PreparedPlant
from coop_pin.results.quantities import condition_numbers, padded
from coop_pin.results.quantity import Samples
from coop_pin.tracing.kernel import CACHE_LINE, Layout

_MARGIN, _LARGEST_BOUND = 1e-6, 1e3
"""Of bounds of condition numbers: for rounding, and up to which they are that accurate."""
_TURNED = 2048
"""Samples of all runs whose axes are exchanged at once: more leave the processor's caches."""
_LINE, _AT_ONCE = CACHE_LINE // 8, 20_000
"""Runs in a cache line of a record; samples of all runs of a part: more leave the caches."""


def kept_of(ticks: int, every: int, first: int = 0) -> NDArray[np.int64]:
    """Return which of some ticks are kept: those whose number ``every`` divides, and the last.

    Args:
        ticks: Number of ticks.
        every: Number of ticks from one kept one to the next.
        first: Number of the first tick.
    """
    index = np.arange(ticks)
    return index[((first + index) % every == 0) | (index == ticks - 1)]


class RunSamples(Mapping[str, Any]):
    """Quantities of some runs of a batch by name, shape (runs, samples, ...), computed on first use."""

    def __init__(
        self,
        prepared: Prepared,
        layout: Layout,
        records: Sequence[Array],
        every: int = 1,
        *,
        is_part: bool = False,
    ) -> None:
        """Make nothing yet.

        Args:
            prepared: Batch.
            layout: Layout of the records' slots.
            records: Records of blocks of its runs, as a Machine returns them.
            every: Number of ticks from one sample to the next; the last tick is one, too.
            is_part: Whether quantities may be views of the records.
        """
        self._prepared, self._layout, self._is_part = prepared, layout, is_part
        self._kept, self._every = kept_of(len(records[0]), every), every
        self._records: Sequence[Array] | None = records
        self._plant, scenario = prepared.plants[0], prepared.scenarios[0]
        self._arms, self._rows = self._plant.slots, scenario.cell.task_rows
        self._recorded, self._made = self._state(), dict[str, Any]()
        self._table = {each.name: each for plant in dict.fromkeys(prepared.plants) for each in plant.table}

    def __iter__(self) -> Iterator[str]:
        """Yield the names."""
        return iter(self._table)

    def __len__(self) -> int:
        """Return the number of quantities."""
        return len(self._table)

    def __getitem__(self, name: str) -> Any:
        """Return a quantity, or what sources need of the joints."""
        if name not in self._made:
            with np.errstate(all="ignore"):  # of runs that are not valid
                self._made[name] = self._computed(name)
        return self._made[name]

    def _computed(self, name: str) -> Any:
        if name in self._recorded:
            return self._recorded[name]()
        quantity = self._table[name]
        if quantity.read is None:
            assert quantity.source is not None
            return quantity.source(self)
        values = self._field(name)
        if quantity.dims == "arm joint":
            values = padded(self._by_arm(values))
        elif quantity.dims == "arm axis":
            rows, values = values, np.full((*values.shape[:-1], 6), np.nan)
            values[..., self._rows.indices] = rows
        return values if quantity.fill is not False else values > 0.0

    def extremes(self, allowed: float) -> Samples:
        """Return the extremes in time of what metrics and trust need no more of, as one or two samples.

        Args:
            allowed: Condition number; of runs that keep below it, upper bounds are given, which cost little.
        """
        errors, bounds = self._largest("closure_errors"), self._largest("condition_bounds")
        is_beyond = ~(bounds <= (1.0 - _MARGIN) * min(allowed, _LARGEST_BOUND)).all(axis=1)
        if is_beyond.any():
            bounds[is_beyond] = condition_numbers([J[is_beyond] for J in self["jacobian"]]).max(axis=1)
        cut = self._largest("saturated")[:, None]
        cuts = {"saturated": padded(self._by_arm(cut)) > 0.0} if (cut <= 0.0).all() else {}
        return cuts | {
            "joint_position": padded(self._by_arm(self._extremes("q"))),
            "torque": self._extremes("torque")[:, :, None],
            "jacobian_condition": bounds[:, None],
            "closure_distance": errors[:, None, :, 0],
            "closure_angle": errors[:, None, :, 1],
        }

    def parts(self) -> Iterator[tuple[slice, RunSamples]]:
        """Yield the samples of a few runs after the other, which stay in the caches: slices and samples."""
        first = 0
        for record in self._blocks():
            lines = -(-record.shape[2] // _LINE)
            size = _LINE * -(-lines // max(1, round(len(record) * record.shape[2] / _AT_ONCE)))
            for start in range(0, record.shape[2], size):
                block = record[:, :, start : start + size]
                runs = slice(first, first + block.shape[2])
                yield runs, RunSamples(self._prepared.part(runs), self._layout, [block], is_part=True)
                first = runs.stop

    def release(self) -> None:
        """Drop the records; samples that were not read until now cannot be computed any more."""
        self._records = None

    def _recorded_of(self, name: str, entry: Any) -> tuple[list[Array], tuple[int, ...]]:
        """Return what was recorded of a field, blocks (samples, entries, runs), and its shape in a sample.

        Raises:
            InvalidStateError: as of BatchResult.release.
        """
        slots = self._layout.slots(name)[entry]
        blocks = [record[:, slots.min() : slots.max() + 1] for record in self._blocks(name)]
        return blocks if self._every == 1 else [block[self._kept] for block in blocks], slots.shape

    def _blocks(self, name: str = "a part") -> Sequence[Array]:
        """Return the records; raises as _recorded_of."""
        if self._records is None:
            raise InvalidStateError(f"the batch was released before {name!r} was read; read samples before")
        return self._records

    def _field(self, name: str, entry: Any = ...) -> Array:
        """Return a copy of what was recorded of a field, (runs, samples, ...); raises as _recorded_of.

        It has one layout for any number of runs: numpy's functions choose their order of operations by it.

        Args:
            name: Name of the field.
            entry: Index of a single entry in a sample; all of them when omitted.
        """
        blocks, shape = self._recorded_of(name, entry)
        out = np.empty((sum(block.shape[2] for block in blocks), len(self._kept), *shape))
        first = 0
        for block in blocks:
            runs, size = out[first : first + block.shape[2]], max(1, _TURNED // block.shape[2])
            for start in range(0, len(block), size):
                part = block[start : start + size]
                runs[:, start : start + size] = np.moveaxis(part.reshape(len(part), *shape, -1), -1, 0)
            first += len(runs)
        return out

    def _numbers(self, name: str, entry: Any = ...) -> Array:
        """Return a number, (runs, samples); of a part a view, whose sums would have another order."""
        (block, *others), _ = self._recorded_of(name, entry)
        return self._field(name, entry) if others or not self._is_part else block[:, 0].T

    def _extremes(self, name: str) -> Array:
        """Return the least and the largest values of a field, (runs, 2, ...); raises as _recorded_of."""
        return np.stack((self._largest(name, np.minimum), self._largest(name)), axis=1)

    def _largest(self, name: str, of: np.ufunc = np.maximum) -> Array:
        """Return the largest values of a field, or the least, (runs, ...); raises as _recorded_of."""
        blocks, shape = self._recorded_of(name, ...)
        values = np.concatenate([of.reduce(block, axis=0) for block in blocks], axis=1).T
        return np.array(values, order="C").reshape(len(values), *shape)

    def _desired(self, read: Callable[[Desired], Array]) -> Array:
        """Return what a function reads of Desired."""
        return self.of_plants(lambda plant: read(plant.desired)[self._kept])

    def of_plants(self, read: Callable[[PreparedPlant], Array]) -> Array:
        """Return what a function reads of the plants, (runs, ...); one plant is read once."""
        plants = self._prepared.plants
        by_plant = {plant: read(plant) for plant in {*plants}}
        if len(by_plant) > 1:
            return np.stack([by_plant[plant] for plant in plants])
        return np.broadcast_to(values := by_plant[plants[0]], (len(plants), *values.shape))

    def _by_arm(self, values: Array) -> list[Array]:
        """Return the part of each arm of values of all joints or drives."""
        return np.split(values, np.cumsum([len(arm.drive) for arm in self._arms]), axis=-1)[:-1]

    def _shares(self) -> Array:
        """Return the load shares of the arms, shape (runs, m)."""
        return self.of_plants(lambda plant: plant.scenario.cell.shares)

    def _load_shares(self) -> Array:
        return np.repeat(self._shares()[:, None], len(self._kept), axis=1)

    def _jacobians(self) -> list[Array]:
        values, k_0 = self._field("jacobians"), self._rows.size
        ends = k_0 * np.cumsum([len(arm.drive) for arm in self._arms])
        return [J.reshape(*J.shape[:2], k_0, -1) for J in np.split(values, ends[:-1], axis=-1)]

    def _configuration(self) -> Array:
        pairs = zip(self["angles"], self._arms, strict=True)
        free = self._field("q")[..., sum(len(arm.drive) for arm in self._arms) :]
        return np.concatenate([*(arm.angles.configuration(q) for q, arm in pairs), free], axis=2)

    def _observed(self, name: str) -> Array:
        """Return a field of an Observation."""
        if not self._layout.slots(name).shape:
            return self._numbers(name)
        values = observation_field(name, self._field(name), self._plant.of_springs)
        return np.where(self._plant.determined, values, np.nan) if name == "interaction_wrench" else values

    def _state(self) -> dict[str, Callable[[], Any]]:
        """Return what gives the quantities that are read neither from measurements nor from others."""
        field, cell = self._field, self._plant.constants.cell
        return {
            "time": lambda: self._desired(lambda desired: desired.time),
            "desired_pose": lambda: self._desired(lambda desired: desired.target.X_WP_d),
            "desired_twist": lambda: self._desired(lambda desired: desired.target.V_WP_d),
            "desired_squeeze": lambda: self._desired(lambda desired: desired.squeeze),
            "angles": lambda: self._by_arm(field("q")),
            "rates": lambda: self._by_arm(field("v")),
            "drive": lambda: [arm.drive for arm in self._arms],
            "jacobian": self._jacobians,
            "configuration": self._configuration,
            "velocity": lambda: field("v"),
            "pose_entries": lambda: [
                [self._numbers("payload_pose", (i, j)) for j in range(4)] for i in range(3)
            ],
            "internal_wrench": lambda: np.stack(
                list(map(internal_wrenches, self["interaction_wrench"], self._shares()))
            ),
            "closure_distance": lambda: field("closure_errors")[..., 0],
            "closure_angle": lambda: field("closure_errors")[..., 1],
            **{name: partial(self._observed, name) for name in observed(cell)},
            **{name: partial(self._numbers, "work", index) for index, name in enumerate(cell.works)},
            **({"load_share": self._load_shares} if cell.compliant else {}),
        }
