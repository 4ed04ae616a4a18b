"""Recorded run: its states and forces on its plant again, tick by tick, with what the sensors measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.control import ArmMeasurement, ArmReference, CellCommand
from coop_pin.description.events import Surroundings
from coop_pin.results.run_result import RunResult
from coop_pin.simulation.devices.drives import Applied
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.simulation import Simulation

_RECORDED = (
    "configuration",
    "velocity",
    "torque",
    "commanded_torque",
    "interaction_wrench",
    "internal_wrench",
    "desired_internal_wrench",
)


class ArmTick(NamedTuple):
    """One tick of one arm, as plant and sensors had it.

    Attributes:
        q: Configuration, shape (nq,).
        v: Joint velocities, shape (k,).
        a: Joint accelerations under the torques of the tick, shape (k,).
        friction: Generalised friction of the joints, shape (k,).
        forces: Generalised force of friction and drive torques, shape (k,).
        tau: Drive torques held from the tick on, shape (k,).
        commanded: Drive torques that the controller asked for, shape (k,).
        saturated: Drives whose torque was limited, shape (k,).
        F: Interaction wrench about P, indeterminate rows zero, shape (6,).
        f: Internal wrench, task rows, shape (k_0,).
        f_d: Desired internal wrench, task rows, shape (k_0,).
        measured: Measurement of the arm.
        reference: Reference of the arm.
    """

    q: Array
    v: Array
    a: Array
    friction: Array
    forces: Array
    tau: Array
    commanded: Array
    saturated: Mask
    F: Array
    f: Array
    f_d: Array
    measured: ArmMeasurement
    reference: ArmReference


class RecordedTick(NamedTuple):
    """One tick of the cell.

    Attributes:
        t: Time, s.
        q: Configuration, shape (nq,).
        v: Velocity, shape (nv,).
        a: Acceleration of the closed chain under the torques of the tick, shape (nv,).
        surroundings: Payload, and what acts on it, from the tick on.
        arms: Arms in the order of the cell.
    """

    t: float
    q: Array
    v: Array
    a: Array
    surroundings: Surroundings
    arms: tuple[ArmTick, ...]


def recorded_ticks(result: RunResult, simulation: Simulation) -> Iterator[RecordedTick]:
    """Yield every tick of a run; by the same seed the sensors measure what they measured in the run.

    Args:
        result: Run with every tick kept; measurements and accelerations are those of the run only if its
            drives deliver their torques at once.
        simulation: Simulation of its scenario, at the start; its plant is put to each recorded state.

    Raises:
        ArgumentError: a grasp is compliant.
    """
    result.scenario.cell.require_rigid("the monitor of a law's proof")
    scenario, plant, sensing, slots = result.scenario, simulation.plant, simulation.sensing, simulation.slots
    at, data = PinocchioPlant(simulation.chain, scenario.plant, plant.q), result.data
    recorded = {name: np.nan_to_num(data[name].values) for name in _RECORDED}
    applied: Applied | None = None
    for k, (t, signals) in enumerate(zip(data["time"].values.tolist(), simulation.signals(), strict=False)):
        sample = {name: values[k] for name, values in recorded.items()}
        q, v = sample["configuration"], sample["velocity"]
        torques, commanded = (
            [tau[: len(slot.drive)] for tau, slot in zip(sample[name], slots, strict=True)]
            for name in ("torque", "commanded_torque")
        )
        for kind, time, *_ in simulation.timeline.stages(k):
            match kind:
                case "measure":
                    plant.restore(plant.state()._replace(q=q, v=v, time=t))
                    references = simulation.references(t)
                    if applied is None:
                        measured = sensing.start(q, v, references, signals.sensors)
                    else:
                        measured = sensing.measure(t, plant, applied, signals.sensors)
                case "happen":
                    plant.surround(scenario.surroundings_at(simulation.timeline.just_after(time)))
                case "command":
                    command = CellCommand(commanded, None)
                    applied = simulation.actuation.apply(t, command, signals.missed)
                    plant.drive(torques)
                case "record":
                    assert applied is not None
                    yield _recorded_tick(at, simulation, sample, measured, references, applied)


def _recorded_tick(
    at: PinocchioPlant,
    simulation: Simulation,
    sample: Mapping[str, Array],
    measured: Sequence[ArmMeasurement],
    references: Sequence[ArmReference],
    applied: Applied,
) -> RecordedTick:
    """Return one tick of the cell.

    Args:
        at: Plant on the chain of the simulation, which takes the state of its plant.
        simulation: Simulation at the tick, with the torques of the tick.
        sample: What was recorded of it, by name.
        measured: Measurements of the arms.
        references: References of the arms.
        applied: Torques of the drives.
    """
    at.restore(simulation.plant.state())
    chain, q, v, rows = at.chain, at.q, at.v, list(at.chain.cell.task_rows.indices)
    friction, pushed = chain.transmission.friction(v), at.generalised_force()
    a = np.array(chain.mechanism.solver.acceleration(q, v, pushed))
    forces = pushed - chain.payload_jacobian(q).T @ at.payload_wrench(q, v, at.time)
    arms = tuple(
        ArmTick(
            q=q[slot.q_slice],
            v=v[slot.v_slice],
            a=a[slot.v_slice],
            friction=friction[slot.v_slice],
            forces=forces[slot.v_slice],
            tau=sample["torque"][i, : len(slot.drive)],
            commanded=sample["commanded_torque"][i, : len(slot.drive)],
            saturated=applied.saturated[i],
            F=sample["interaction_wrench"][i],
            f=sample["internal_wrench"][i, rows],
            f_d=sample["desired_internal_wrench"][i, rows],
            measured=measured[i],
            reference=references[i],
        )
        for i, slot in enumerate(simulation.slots)
    )
    return RecordedTick(at.time, q, v, a, at.surroundings, arms)
