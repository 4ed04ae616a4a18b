"""Recorded run: its states and forces on its plant again, tick by tick, with what the sensors measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.control import ArmMeasurement, ArmReference, CellCommand
from coop_pin.description.events import Surroundings
from coop_pin.model.cell_model import ArmPlace
from coop_pin.results.run_result import RunResult
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.simulation import Simulation
from coop_pin.simulation.tick import TickInputs

_RECORDED = (
    "configuration",
    "velocity",
    "torque",
    "commanded_torque",
    "saturated",
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
    times, plant = result.data["time"].values.tolist(), simulation.plant
    at = PinocchioPlant(simulation.chain, result.scenario.plant, plant.q)
    recorded = {name: np.nan_to_num(result.data[name].values) for name in _RECORDED}
    for k, t in enumerate(times):
        sample = {name: values[k] for name, values in recorded.items()}
        q, v = sample["configuration"], sample["velocity"]
        plant.restore(plant.state()._replace(q=q, v=v, time=t, force=at.force))
        inputs = simulation.observe()
        at.restore(plant.state())
        yield _recorded_tick(at, simulation.slots, sample, inputs)
        if k + 1 < len(times):  # the last one may diverge, as the run did
            commanded = [
                tau[: len(slot.drive)]
                for tau, slot in zip(sample["commanded_torque"], simulation.slots, strict=True)
            ]
            simulation.step(CellCommand(commanded, None))


def _recorded_tick(
    at: PinocchioPlant, slots: Sequence[ArmPlace], sample: Mapping[str, Array], inputs: TickInputs
) -> RecordedTick:
    """Return one tick of the cell.

    Args:
        at: Plant at the state of the tick.
        slots: Positions of the arms in q and v.
        sample: Recorded quantities of the tick, by name.
        inputs: Measurements and references that the law gets.
    """
    drives = [slice(len(slot.drive)) for slot in slots]
    at.drive([tau[k] for tau, k in zip(sample["torque"], drives, strict=True)])
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
            tau=sample["torque"][i, drives[i]],
            commanded=sample["commanded_torque"][i, drives[i]],
            saturated=sample["saturated"][i, drives[i]].astype(bool),
            F=sample["interaction_wrench"][i],
            f=sample["internal_wrench"][i, rows],
            f_d=sample["desired_internal_wrench"][i, rows],
            measured=inputs.measurements[i],
            reference=inputs.references[i],
        )
        for i, slot in enumerate(slots)
    )
    return RecordedTick(at.time, q, v, a, at.surroundings, arms)
