"""The plant between two ticks: held torques, friction and pushes on the closed chain."""

from __future__ import annotations

import numpy as np

from coop_pin.arrays import Array
from coop_pin.chain.cell_chain import CellChain, Observation
from coop_pin.chain.integrators import INTEGRATORS, configuration_space
from coop_pin.description.plant import PlantOptions
from coop_pin.simulation.actuation import Transmission

CHANNELS = ("actuation", "friction", "external")
"""The forces that do work on the chain besides gravity."""

_ALL = np.ones(len(CHANNELS))


class Plant:
    """The moving state of a cell.

    Attributes:
        chain: the cell's closed chain.
        drives: its drives.
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        external: wrench on the payload about P in world axes, N and N m, shape (6,).
        work: done so far by each of CHANNELS, J, shape (3,).
    """

    def __init__(self, chain: CellChain, options: PlantOptions, q: Array) -> None:
        model = chain.mechanism.model
        self.chain, self.drives = chain, Transmission(chain.cell, chain.model.arms, model.nv)
        self.q, self.v = q, np.zeros(model.nv)
        self.external, self.work = np.zeros(6), np.zeros(len(CHANNELS))
        self._forces, self._pushed = np.zeros((len(CHANNELS), model.nv)), False
        self._integrator = INTEGRATORS[options.integrator](configuration_space(model))
        self._project = options.project == "step"
        self._solve = chain.mechanism.solver.acceleration

    def hold(self, drive_torques: list[Array]) -> None:
        """Hold drive torques from now on."""
        self._forces[0] = self.drives.torque(drive_torques)

    def push(self, external: Array) -> None:
        """Push the payload with a constant wrench from now on."""
        self.external, self._pushed = external, bool(external.any())
        self._forces[2] = 0.0

    def generalised_force(self) -> Array:
        """Return the generalised force of torques, friction and push at the present state, shape (nv,)."""
        return _ALL.dot(self._apply(self.q, self.v))

    def observe(self) -> Observation:
        """Return what the chain does at the present state, under the present forces."""
        return self.chain.observe(self.q, self.v, self.generalised_force(), self.external)

    def interaction_wrenches(self) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes, shape (m, 6)."""
        return self.chain.interaction_wrenches(self.q, self.v, self.generalised_force(), self.external)

    def advance(self, t: float, h: float) -> None:
        """Move on from time t by h seconds."""
        step = self._integrator.step(self._rate, t, self.q, self.v, h)
        self.q, self.v = step.q, step.v
        self.work = self.work + step.work
        if self._project:
            self.q = self.chain.mechanism.project_configuration(self.q)
            self.v = self.chain.mechanism.project_velocity(self.q, self.v)

    def _rate(self, _t: float, q: Array, v: Array) -> tuple[Array, Array]:
        forces = self._apply(q, v)
        return self._solve(q, v, _ALL.dot(forces)), forces.dot(v)

    def _apply(self, q: Array, v: Array) -> Array:
        """Return the generalised force of each channel, shape (3, nv)."""
        forces = self._forces
        forces[1] = self.drives.friction(v)
        if self._pushed:
            forces[2] = self.chain.payload_jacobian(q).T.dot(self.external)
        return forces
