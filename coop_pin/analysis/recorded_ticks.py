"""Ticks of a recorded run: its states and forces on its plant again, with what the sensors measured."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.control import ArmMeasurement, ArmReference
from coop_pin.description.payload import Payload
from coop_pin.results import RunResult
from coop_pin.simulation import Simulation

_BESIDE = 1e-6
"""Part of a period by which the time just before or just after a tick differs from the tick's."""


class Tick(NamedTuple):
    """One tick of the cell, as plant and sensors had it.

    Attributes:
        t: s.
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        a: acceleration of the closed chain under the torques of the tick, shape (nv,).
        forces: generalised force of friction and drive torques, shape (nv,).
        commanded: drive torques that the controller asked for, shape (k,) each.
        F: interaction wrenches, task rows, shape (m, k_0).
        payload: at the tick.
        seen: measurement of each arm.
        references: of each arm.
    """

    t: float
    q: Array
    v: Array
    a: Array
    forces: Array
    commanded: list[Array]
    F: Array
    payload: Payload
    seen: list[ArmMeasurement]
    references: list[ArmReference]


def recorded_ticks(result: RunResult, simulation: Simulation) -> Iterator[Tick]:
    """Yield every tick of a run; by the same seed the sensors measure what they measured in the run.

    Args:
        result: every tick kept; its drives deliver their torques at once.
        simulation: of its scenario, at the start; its plant is put to each recorded state.
    """
    data, rows = result.data, list(result.scenario.cell.task_rows.indices)
    plant, sensing, chain = simulation.plant, simulation.sensing, simulation.plant.chain
    drives = [slice(len(place.drive)) for place in chain.model.arms]
    for k, t in enumerate(data["time"].values.tolist()):
        plant.q, plant.v = data["configuration"].values[k], data["velocity"].values[k]
        references = simulation.references(t)
        if k == 0:
            seen = sensing.start(plant.q, plant.v, references)
        else:
            _set_events(simulation, t - _BESIDE * simulation.timeline.period)
            cut = data["saturated"].values[k - 1]
            seen = sensing.measure(t, plant, [cut[i, own] for i, own in enumerate(drives)])
        payload = _set_events(simulation, t + _BESIDE * simulation.timeline.period)
        torques, asked = data["torque"].values[k], data["commanded_torque"].values[k]
        plant.hold(plant.transmission.torque([torques[i, own] for i, own in enumerate(drives)]))
        pushed = plant.generalised_force()
        yield Tick(
            t=t,
            q=plant.q,
            v=plant.v,
            a=np.array(chain.mechanism.solver.acceleration(plant.q, plant.v, pushed)),
            forces=pushed - chain.payload_jacobian(plant.q).T @ plant.external,
            commanded=[asked[i, own] for i, own in enumerate(drives)],
            F=np.nan_to_num(data["interaction_wrench"].values[k])[:, rows],
            payload=payload,
            seen=seen,
            references=references,
        )


def _set_events(simulation: Simulation, time: float) -> Payload:
    """Let payload and push be those of a time; return the payload."""
    plant, payload = simulation.plant, simulation.scenario.payload_at(time)
    plant.chain.set_payload(payload)
    plant.push(simulation.timeline.push_at(time))
    return payload
