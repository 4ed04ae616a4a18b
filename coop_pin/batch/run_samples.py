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
    run, scenario = prepared.plants[0].run, prepared.scenarios[0]
    places, every = run.plant.chain.model.arms, scenario.clock.record_every
    kept = [tick for tick in range(run.timeline.ticks + 1) if tick % every == 0 or tick == run.timeline.ticks]

    def field(name: str) -> Array:
        slots = layout.slots(name)
        values = np.moveaxis(record[:, slots.ravel()], 2, 0)
        return values.reshape(record.shape[2], record.shape[0], *slots.shape)

    def signal(name: str) -> Array:
        slots = prepared.plants[0].layout.slots(name)
        values = np.stack([signals[kept][:, slots.ravel()] for signals in prepared.signals])
        return values.reshape(*values.shape[:2], *slots.shape)

    q, v = field("q"), field("v")
    pose = np.zeros((*q.shape[:2], 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = field("R_WP"), field("p_WP"), 1.0
    determined = determinate_rows(run.plant.chain, run.plant.q)
    angles, velocities = _split(q, places), _split(v, places)
    drive_velocities = [own @ place.drive.T for own, place in zip(velocities, places, strict=True)]
    work = [*np.moveaxis(field("work"), 2, 0), field("payload_energy")]
    found: Samples = {
        "time": np.broadcast_to([run.timeline.time(tick) for tick in kept], q.shape[:2]),
        "configuration": np.concatenate(
            [place.angles.configuration(own) for own, place in zip(angles, places, strict=True)], axis=2
        ),
        "velocity": v,
        "payload_pose": pose,
        "payload_twist": field("V_WP"),
        "desired_pose": signal("pose"),
        "desired_twist": signal("twist"),
        "desired_squeeze": signal("squeeze"),
        "tip_position": field("tips"),
        "interaction_wrench": np.where(determined, field("wrenches"), np.nan),
        "external_wrench": field("external"),
        "closure_distance": field("closure_errors")[..., 0],
        "closure_angle": field("closure_errors")[..., 1],
        "kinetic_energy": field("kinetic"),
        "potential_energy": field("potential"),
        **{f"work_{name}": done for name, done in zip((*CHANNELS, "payload_change"), work, strict=True)},
        "torque": _per_joint(_split(field("torque"), places)),
        "commanded_torque": _per_joint(_split(field("commanded"), places)),
        "saturated": np.nan_to_num(_per_joint(_split(field("saturated"), places))) > 0.0,
        "drive_velocity": _per_joint(drive_velocities),
        "joint_position": _per_joint(angles),
        "joint_velocity": _per_joint(velocities),
        "jacobian_condition": _conditions(field("jacobians"), scenario.cell.task_rows.size, places),
    }
    rows, shape = scenario.cell.task_rows, prepared.plants[0].shape

    def six(values: Array) -> Array:
        """Return rows of wrenches in their places, NaN elsewhere."""
        full = np.full((*values.shape[:-1], 6), np.nan)
        full[..., rows.indices] = values
        return full

    groups: dict[str, Callable[[], Array]] = {
        "requested_torque": lambda: _per_joint(_split(field("requested"), places)),
        "drive_position": lambda: _per_joint(
            [own @ place.drive.T for own, place in zip(angles, places, strict=True)]
        ),
        "measured_drive_position": lambda: _per_joint(_split(field("seen_q"), places)),
        "measured_drive_velocity": lambda: _per_joint(_split(field("seen_v"), places)),
        "seen_pose": lambda: field("seen_poses"),
        "measured_wrench": lambda: np.where(
            np.array(shape.has_wrist)[:, None], six(field("readings")[..., rows.indices]), np.nan
        ),
        "measured_wrench_age": lambda: signal("wrist_age"),
        "measured_internal_wrench": lambda: six(field("measured")),
        "measured_internal_wrench_age": lambda: signal("age"),
    }
    names = {quantity.name for quantity in quantities(scenario)}
    return found | {name: values() for name, values in groups.items() if name in names}


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


def _split(values: Array, places: tuple[ArmPlace, ...]) -> list[Array]:
    return np.split(values, np.cumsum([len(place.drive) for place in places])[:-1], axis=2)


def _per_joint(parts: Sequence[Array]) -> Array:
    """Return values of the joints or drives of each arm, NaN beyond its own, shape (runs, samples, m, k)."""
    table = np.full((*parts[0].shape[:2], len(parts), max(part.shape[2] for part in parts)), np.nan)
    for index, part in enumerate(parts):
        table[:, :, index, : part.shape[2]] = part
    return table
