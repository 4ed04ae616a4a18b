"""Samples of a batch, with the names and shapes of a single run's and a leading axis of runs."""

from __future__ import annotations

from typing import Any

import numpy as np

from coop_pin.arrays import Array
from coop_pin.batch.arm_code import frames, payload_jacobian
from coop_pin.batch.kernel import Layout
from coop_pin.batch.numpy_emitter import evaluate
from coop_pin.batch.preparation import Prepared
from coop_pin.batch.tape import Tape
from coop_pin.batch.traced_array import inputs, plain
from coop_pin.chain.cell_chain import determinate_rows
from coop_pin.model.cell_model import ArmPlace
from coop_pin.results.quantities import Samples, quantities
from coop_pin.simulation.plant import CHANNELS


def samples(prepared: Prepared, layout: Layout, record: Array) -> Samples:
    """Return the recorded quantities of all runs, shape (runs, samples, ...).

    The condition numbers of the Jacobians are worked out where they are asked for: jacobian_conditions.

    Args:
        prepared: the batch.
        layout: of the record's slots.
        record: shape (samples, slots, runs).
    """
    run, scenario = prepared.runs[0], prepared.scenarios[0]
    places, ticks, every = run.plant.chain.model.arms, run.timeline.ticks, scenario.clock.record_every
    kept = [tick for tick in range(ticks + 1) if tick % every == 0 or tick == ticks]

    def field(name: str) -> Array:
        slots = layout.slots(name)
        values = record[:, slots.ravel()]
        return np.moveaxis(values, 2, 0).reshape(record.shape[2], record.shape[0], *slots.shape)

    q, v, desired = field("q"), field("v"), prepared.references[:, kept]
    pose = np.zeros((*q.shape[:2], 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = field("R_WP"), field("p_WP"), 1.0
    determined, errors, work = (
        determinate_rows(run.plant.chain, run.plant.q),
        field("closure_errors"),
        field("work"),
    )
    drive_velocity = _joined(
        [own @ place.drive.T for own, place in zip(_split(v, places), places, strict=True)]
    )
    found: Samples = {
        "time": np.broadcast_to([run.timeline.time(tick) for tick in kept], q.shape[:2]),
        "configuration": np.concatenate(
            [_configuration(own, place) for own, place in zip(_split(q, places), places, strict=True)], axis=2
        ),
        "velocity": v,
        "payload_pose": pose,
        "payload_twist": field("V_WP"),
        "desired_pose": desired[..., :16].reshape(*desired.shape[:2], 4, 4),
        "desired_twist": desired[..., 16:22],
        "desired_squeeze": desired[..., 28:].reshape(*desired.shape[:2], -1, 6),
        "tip_position": field("tips"),
        "interaction_wrench": np.where(determined, field("wrenches"), np.nan),
        "external_wrench": field("external"),
        "closure_distance": errors[..., 0],
        "closure_angle": errors[..., 1],
        "kinetic_energy": field("kinetic"),
        "potential_energy": field("potential"),
        **{f"work_{channel}": work[..., index] for index, channel in enumerate(CHANNELS)},
        "work_payload_change": field("payload_energy"),
        "torque": _per_joint(field("torque"), places),
        "commanded_torque": _per_joint(field("commanded"), places),
        "saturated": np.nan_to_num(_per_joint(field("saturated"), places)) > 0.0,
        "drive_velocity": _per_joint(drive_velocity, places),
        "joint_position": _per_joint(q, places),
        "joint_velocity": _per_joint(v, places),
    }
    names = {quantity.name for quantity in quantities(scenario)}
    if "seen_pose" in names:
        found["seen_pose"] = _seen_poses(prepared, q)
    if "measured_internal_wrench" in names:
        found |= _measured(prepared, kept, field("measured"))
    return found


def jacobian_conditions(prepared: Prepared, index: int, joint_position: Array) -> Array:
    """Return the condition number of each arm's payload Jacobian at the samples of a run, (samples, m)."""
    rows, found = prepared.scenarios[0].cell.task_rows, []
    for arm, angles in zip(prepared.constants[index].arms, np.moveaxis(joint_position, 1, 0), strict=True):
        tape, joints = Tape(), len(arm.drive)
        seen = frames(arm.seen, inputs(tape, joints))
        J = plain(rows.select(payload_jacobian(seen.S, seen.p_WP)).dot(arm.to_joints))
        found.append(np.linalg.cond(_values(tape, J, angles[:, :joints])))
    return np.stack(found, axis=1)


def _seen_poses(prepared: Prepared, q: Array) -> Array:
    """Return the payload poses that each arm's own kinematics see, shape (runs, samples, m, 4, 4)."""
    m = len(prepared.constants[0].arms)
    poses = np.zeros((*q.shape[:2], m, 4, 4))
    poses[..., 3, 3] = 1.0
    for index, constants in enumerate(prepared.constants):
        edges = np.cumsum([len(arm.drive) for arm in constants.arms])[:-1]
        for column, (arm, own) in enumerate(
            zip(constants.arms, np.split(q[index], edges, axis=1), strict=True)
        ):
            tape = Tape()
            seen = frames(arm.seen, inputs(tape, own.shape[1]))
            X = np.concatenate((plain(seen.R_WP), plain(seen.p_WP)[:, None]), axis=1)
            poses[index, :, column, :3] = _values(tape, X, own)
    return poses


def _values(tape: Tape, outputs: Any, q: Array) -> Array:
    """Return the values of an array of outputs at joint positions, shape (samples, n)."""
    values = evaluate(tape, list(outputs.flat), list(q.T))
    columns = [np.broadcast_to(value, len(q)) for value in values]
    return np.stack(columns, axis=1).reshape(len(q), *outputs.shape)


def _measured(prepared: Prepared, kept: list[int], measured: Array) -> Samples:
    """Return the internal wrenches that the controllers get, in their rows of six, and their age in ticks."""
    scenario = prepared.scenarios[0]
    delay = scenario.controller.force_path.delay  # type: ignore[union-attr]
    wrenches = np.full((*measured.shape[:3], 6), np.nan)
    wrenches[..., scenario.cell.task_rows.indices] = measured
    age = np.array([delay if tick > delay else np.inf for tick in kept], dtype=np.float64)
    return {
        "measured_internal_wrench": wrenches,
        "measured_internal_wrench_age": np.broadcast_to(age, measured.shape[:2]),
    }


def _split(values: Array, places: tuple[ArmPlace, ...]) -> list[Array]:
    return np.split(values, np.cumsum([len(place.drive) for place in places])[:-1], axis=2)


def _joined(parts: list[Array]) -> Array:
    return np.concatenate(parts, axis=2)


def _per_joint(values: Array, places: tuple[ArmPlace, ...]) -> Array:
    """Return values of all joints or drives by arm, NaN beyond an arm's own, shape (runs, samples, m, k)."""
    parts = _split(values, places)
    table = np.full((*values.shape[:2], len(parts), max(part.shape[2] for part in parts)), np.nan)
    for index, part in enumerate(parts):
        table[:, :, index, : part.shape[2]] = part
    return table


def _configuration(angles: Array, place: ArmPlace) -> Array:
    """Return an arm's entries of q at angles, with cosine and sine of continuous joints, (..., nq)."""
    columns: list[Array] = []
    for joint, is_continuous in enumerate(place.angles.continuous):
        angle = angles[..., joint]
        columns += [np.cos(angle), np.sin(angle)] if is_continuous else [angle]
    return np.stack(columns, axis=-1)
