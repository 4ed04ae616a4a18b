"""Recorded run: its states and forces on its plant again, tick by tick, with what the sensors measured."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.control import ArmMeasurement, ArmReference, CellCommand
from coop_pin.description import PlantOptions
from coop_pin.description.events import Surroundings
from coop_pin.results import RunResult
from coop_pin.simulation import Simulation
from coop_pin.simulation.pinocchio_plant import PinocchioPlant

_RECORDED = (
    "configuration",
    "velocity",
    "torque",
    "commanded_torque",
    "interaction_wrench",
    "internal_wrench",
    "desired_internal_wrench",
)
_BESIDE = 1e-6
"""Part of a period by which the time just before or just after a tick differs from the tick's."""


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
    data, rows = result.data, list(result.scenario.cell.task_rows.indices)
    plant, sensing, chain, slots = simulation.plant, simulation.sensing, simulation.chain, simulation.slots
    beside, forces_at = _BESIDE * simulation.timeline.period, PinocchioPlant(chain, PlantOptions(), plant.q)
    recorded = {name: np.nan_to_num(data[name].values) for name in _RECORDED}
    applied: Any = None
    for k, (t, signals) in enumerate(zip(data["time"].values.tolist(), simulation.signals(), strict=False)):
        q, v = recorded["configuration"][k], recorded["velocity"][k]
        plant.restore(plant.state()._replace(q=q, v=v, time=t))
        references = simulation.references(t)
        if k == 0:
            measured = sensing.start(q, v, references, signals.sensors)
        else:
            plant.surround(simulation.scenario.surroundings_at(t - beside))
            measured = sensing.measure(t, plant, applied, signals.sensors)
        plant.surround(simulation.scenario.surroundings_at(t + beside))
        torques, commanded = (
            [tau[: len(slot.drive)] for tau, slot in zip(recorded[name][k], slots, strict=True)]
            for name in ("torque", "commanded_torque")
        )
        applied = simulation.actuation.apply(t, CellCommand(commanded, None), signals.missed)
        plant.drive(torques)
        forces_at.restore(plant.state())
        friction, pushed = chain.transmission.friction(v), forces_at.generalised_force()
        a = np.array(chain.mechanism.solver.acceleration(q, v, pushed))
        forces = pushed - chain.payload_jacobian(q).T @ forces_at.payload_wrench(q, v, t)
        arms = tuple(
            ArmTick(
                q=q[slot.q_slice],
                v=v[slot.v_slice],
                a=a[slot.v_slice],
                friction=friction[slot.v_slice],
                forces=forces[slot.v_slice],
                tau=torques[i],
                commanded=commanded[i],
                saturated=applied.saturated[i],
                F=recorded["interaction_wrench"][k, i],
                f=recorded["internal_wrench"][k, i, rows],
                f_d=recorded["desired_internal_wrench"][k, i, rows],
                measured=measured[i],
                reference=references[i],
            )
            for i, slot in enumerate(slots)
        )
        yield RecordedTick(t, q, v, a, forces_at.surroundings, arms)
