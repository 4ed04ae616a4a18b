"""Samples of a batch, with the names and shapes of a single run's and a leading axis of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_pin.arrays import Array
from coop_pin.batch.kernel import Layout
from coop_pin.batch.preparation import Prepared
from coop_pin.chain.cell_chain import determinate_rows
from coop_pin.model.cell_model import ArmPlace
from coop_pin.results.quantities import QUANTITIES, Samples
from coop_pin.simulation.plant import CHANNELS
from coop_pin.spatial import internal_wrenches

_Sources = dict[str, Callable[[], NDArray[Any]]]


_MARGIN = 1e-9
"""Of bounds of condition numbers, for rounding."""


class RunSamples(dict[str, NDArray[Any]]):
    """Quantities of all runs of a batch by name, made when first asked for, shape (runs, samples, ...)."""

    def __init__(self, prepared: Prepared, layout: Layout, records: Sequence[Array]) -> None:
        """Name nothing yet.

        Args:
            prepared: the batch.
            layout: of the records' slots.
            records: of blocks of its runs, as a Machine returns them.
        """
        super().__init__()
        self._prepared, self._layout, self._records = prepared, layout, records
        self._plant, scenario = prepared.plants[0], prepared.scenarios[0]
        self._places, self._rows = self._plant.run.plant.chain.model.arms, scenario.cell.task_rows
        last, every = self._plant.run.timeline.ticks, scenario.clock.record_every
        self._kept = [tick for tick in range(last + 1) if tick % every == 0 or tick == last]
        self._sources = self._state() | self._drives() | self._measured()
        self._sources |= {
            quantity.name: partial(quantity.source, self) for quantity in QUANTITIES if quantity.source
        }
        self._sources["internal_wrench"] = self._internal_wrenches

    def __missing__(self, name: str) -> NDArray[Any]:
        with np.errstate(all="ignore"):  # of runs that are not valid
            values = self[name] = self._sources[name]()
        return values

    def recorded(self) -> Samples:
        """Return the quantities of some of the runs that are not computed from others."""
        tables = {id(plant): plant.table for plant in self._prepared.plants}.values()
        return {each.name: self[each.name] for table in tables for each in table if each.source is None}

    def conditions(self, allowed: float) -> Array:
        """Return the condition number of each arm's payload Jacobian, shape (runs, samples, m).

        Those of runs that keep below what is allowed are upper bounds, which cost little.
        """
        found = self._field("condition_bounds")
        is_beyond = ~(found <= allowed * (1.0 - _MARGIN)).all(axis=(1, 2))
        if is_beyond.any():
            found[is_beyond] = self["jacobian_condition"][is_beyond]
        return found

    def _internal_wrenches(self) -> Array:
        shares = [scenario.cell.shares for scenario in self._prepared.scenarios]
        return np.stack(
            [internal_wrenches(F, own) for F, own in zip(self["interaction_wrench"], shares, strict=True)]
        )

    def _field(self, name: str) -> Array:
        slots, count = self._layout.slots(name), len(self._prepared.scenarios)
        mine = slice(slots.min(), slots.max() + 1)
        blocks = [np.moveaxis(record[:, :, mine], 3, 1) for record in self._records]
        parts = [block.reshape(-1, len(self._kept), *slots.shape) for block in blocks]
        return (parts[0] if len(parts) == 1 else np.concatenate(parts))[:count]

    def _signal(self, name: str) -> Array:
        slots, given = self._plant.layout.slots(name), self._prepared.signals
        places = {id(signals): place for place, signals in enumerate(given)}
        shape = (len(given), len(self._kept), *slots.shape)
        if len(places) == 1:
            return np.broadcast_to(given[0][self._kept][:, slots], shape)
        return np.stack([signals[self._kept][:, slots] for signals in given])

    def _split(self, name: str) -> list[Array]:
        return np.split(
            self._field(name), np.cumsum([len(place.drive) for place in self._places])[:-1], axis=2
        )

    def _table(self, name: str) -> Array:
        return _per_joint(self._split(name))

    def _at_drives(self, parts: Sequence[Array]) -> Array:
        return _per_joint([own @ place.drive.T for own, place in zip(parts, self._places, strict=True)])

    def _six(self, rows: Array) -> Array:
        """Return rows of wrenches in their places, NaN elsewhere."""
        full = np.full((*rows.shape[:-1], 6), np.nan)
        full[..., self._rows.indices] = rows
        return full

    def _pose(self) -> Array:
        R, p = self._field("R_WP"), self._field("p_WP")
        pose = np.zeros((*p.shape[:2], 4, 4))
        pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = R, p, 1.0
        return pose

    def _determined(self) -> Array:
        run = self._plant.run
        return np.where(determinate_rows(run.plant.chain, run.plant.q), self._field("wrenches"), np.nan)

    def _configuration(self) -> Array:
        parts = zip(self._split("q"), self._places, strict=True)
        return np.concatenate([place.angles.configuration(own) for own, place in parts], axis=2)

    def _state(self) -> _Sources:
        """Return what gives the quantities of payload and cell."""
        field, signal = self._field, self._signal
        return {
            "time": lambda: signal("time"),
            "velocity": lambda: field("v"),
            "payload_pose": self._pose,
            "payload_twist": lambda: field("V_WP"),
            "desired_pose": lambda: signal("pose"),
            "desired_twist": lambda: signal("twist"),
            "desired_squeeze": lambda: signal("squeeze"),
            "tip_position": lambda: field("tips"),
            "interaction_wrench": self._determined,
            "external_wrench": lambda: field("external"),
            "closure_distance": lambda: field("closure_errors")[..., 0],
            "closure_angle": lambda: field("closure_errors")[..., 1],
            "kinetic_energy": lambda: field("kinetic"),
            "potential_energy": lambda: field("potential"),
            "work_payload_change": lambda: field("payload_energy"),
            **{f"work_{name}": partial(self._work, place) for place, name in enumerate(CHANNELS)},
        }

    def _work(self, channel: int) -> Array:
        return self._field("work")[..., channel]

    def _drives(self) -> _Sources:
        """Return what gives the quantities of joints and drives."""
        return {
            "configuration": self._configuration,
            "torque": lambda: self._table("torque"),
            "commanded_torque": lambda: self._table("commanded"),
            "saturated": lambda: np.nan_to_num(self._table("saturated")) > 0.0,
            "drive_velocity": lambda: self._at_drives(self._split("v")),
            "joint_position": lambda: self._table("q"),
            "joint_velocity": lambda: self._table("v"),
            "jacobian_condition": lambda: _conditions(
                self._field("jacobians"), self._rows.size, self._places
            ),
        }

    def _measured(self) -> _Sources:
        """Return what gives the quantities that only some runs have."""
        rows, has_wrist = self._rows.indices, np.array(self._plant.shape.has_wrist)[:, None]
        return {
            "requested_torque": lambda: self._table("requested"),
            "drive_position": lambda: self._at_drives(self._split("q")),
            "measured_drive_position": lambda: self._table("seen_q"),
            "measured_drive_velocity": lambda: self._table("seen_v"),
            "seen_pose": lambda: self._field("seen_poses"),
            "measured_wrench": lambda: np.where(
                has_wrist, self._six(self._field("readings")[..., rows]), np.nan
            ),
            "measured_wrench_age": lambda: self._signal("wrist_age"),
            "measured_internal_wrench": lambda: self._six(self._field("measured")),
            "measured_internal_wrench_age": lambda: self._signal("age"),
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


def _per_joint(parts: Sequence[Array]) -> Array:
    """Return values of the joints or drives of each arm, NaN beyond its own, shape (runs, samples, m, k)."""
    table = np.full((*parts[0].shape[:2], len(parts), max(part.shape[2] for part in parts)), np.nan)
    for index, part in enumerate(parts):
        table[:, :, index, : part.shape[2]] = part
    return table
