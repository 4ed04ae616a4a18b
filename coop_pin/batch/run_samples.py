"""Samples of a batch, with the names and shapes of a single run's and a leading axis of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from coop_pin.arrays import Array
from coop_pin.batch.kernel import Layout
from coop_pin.batch.preparation import Prepared
from coop_pin.chain.cell_chain import determinate_rows
from coop_pin.model.cell_model import ArmPlace
from coop_pin.results.quantities import Samples, quantities
from coop_pin.simulation.plant import CHANNELS


def samples(prepared: Prepared, layout: Layout, record: Array) -> Samples:
    """Return the recorded quantities of all runs, shape (runs, samples, ...).

    Args:
        prepared: the batch.
        layout: of the record's slots.
        record: shape (samples, slots, runs).
    """
    records = _Records(prepared, layout, record)
    names = {quantity.name for quantity in quantities(prepared.scenarios[0])}
    groups = {name: values() for name, values in records.measured().items() if name in names}
    return records.state() | records.drives() | groups


class _Records:
    """Record of a batch, read by names."""

    def __init__(self, prepared: Prepared, layout: Layout, record: Array) -> None:
        self._prepared, self._layout, self._record = prepared, layout, record
        self._plant, scenario = prepared.plants[0], prepared.scenarios[0]
        self._places, self._rows = self._plant.run.plant.chain.model.arms, scenario.cell.task_rows
        last, every = self._plant.run.timeline.ticks, scenario.clock.record_every
        self._kept = [tick for tick in range(last + 1) if tick % every == 0 or tick == last]
        self._angles, self._velocities = self._split("q"), self._split("v")

    def _field(self, name: str) -> Array:
        slots, record = self._layout.slots(name), self._record
        values = np.moveaxis(record[:, slots.ravel()], 2, 0)
        return values.reshape(record.shape[2], record.shape[0], *slots.shape)

    def _signal(self, name: str) -> Array:
        slots = self._plant.layout.slots(name)
        values = np.stack([signals[self._kept][:, slots.ravel()] for signals in self._prepared.signals])
        return values.reshape(*values.shape[:2], *slots.shape)

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

    def state(self) -> Samples:
        """Return the quantities of payload and cell."""
        field, signal, run = self._field, self._signal, self._plant.run
        positions, errors = field("p_WP"), field("closure_errors")
        pose = np.zeros((*positions.shape[:2], 4, 4))
        pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = field("R_WP"), positions, 1.0
        determined = determinate_rows(run.plant.chain, run.plant.q)
        work = [*np.moveaxis(field("work"), 2, 0), field("payload_energy")]
        return {
            "time": signal("time"),
            "velocity": field("v"),
            "payload_pose": pose,
            "payload_twist": field("V_WP"),
            "desired_pose": signal("pose"),
            "desired_twist": signal("twist"),
            "desired_squeeze": signal("squeeze"),
            "tip_position": field("tips"),
            "interaction_wrench": np.where(determined, field("wrenches"), np.nan),
            "external_wrench": field("external"),
            "closure_distance": errors[..., 0],
            "closure_angle": errors[..., 1],
            "kinetic_energy": field("kinetic"),
            "potential_energy": field("potential"),
            **{f"work_{name}": done for name, done in zip((*CHANNELS, "payload_change"), work, strict=True)},
        }

    def drives(self) -> Samples:
        """Return the quantities of joints and drives."""
        configurations = [
            place.angles.configuration(own) for own, place in zip(self._angles, self._places, strict=True)
        ]
        return {
            "configuration": np.concatenate(configurations, axis=2),
            "torque": self._table("torque"),
            "commanded_torque": self._table("commanded"),
            "saturated": np.nan_to_num(self._table("saturated")) > 0.0,
            "drive_velocity": self._at_drives(self._velocities),
            "joint_position": _per_joint(self._angles),
            "joint_velocity": _per_joint(self._velocities),
            "jacobian_condition": _conditions(self._field("jacobians"), self._rows.size, self._places),
        }

    def measured(self) -> dict[str, Callable[[], Array]]:
        """Return what gives the quantities that only some runs have."""
        rows, has_wrist = self._rows.indices, np.array(self._plant.shape.has_wrist)[:, None]
        return {
            "requested_torque": lambda: self._table("requested"),
            "drive_position": lambda: self._at_drives(self._angles),
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
