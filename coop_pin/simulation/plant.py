"""Plant between two ticks: held torques, friction and external wrench on the closed chain.

For speed, plant and chain hold state that changes in place: ``Plant.advance`` replaces q, v and work,
``hold`` and ``push`` the forces, ``CellChain.set_payload`` the payload's inertia, and each call of the
dynamics overwrites the buffers of Pinocchio's ``Data`` and of the solvers. Everything else that a simulation
hands out (measurements, references, controller states, snapshots, results) is a value.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coop_pin.arrays import Array
from coop_pin.chain.cell_chain import CellChain, Observation
from coop_pin.chain.closure_set import ClosureError
from coop_pin.chain.integrators import INTEGRATORS, configuration_space
from coop_pin.description.plant import PlantOptions
from coop_pin.simulation.transmission import Transmission

CHANNELS = ("actuation", "friction", "external")
"""The forces that do work on the chain besides gravity."""

_ALL = np.ones(len(CHANNELS))


class Plant:
    """Closed chain in motion: its state and the forces on it.

    Attributes:
        engine: name of what computes the motion.
        chain: the cell's closed chain.
        transmission: between its drives and joints, with friction.
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        external: wrench on the payload about P in world axes, N and N m, shape (6,).
        work: done so far by each of CHANNELS, J, shape (3,).
    """

    engine = "pinocchio"

    def __init__(self, chain: CellChain, options: PlantOptions, q: Array) -> None:
        """Start at rest, without torques.

        Args:
            chain: Closed chain of the cell.
            options: Integrator and projection.
            q: Configuration on the closures, shape (nq,).
        """
        model = chain.mechanism.model
        self.chain, self.transmission = chain, Transmission(chain.cell, chain.model.arms, model.nv)
        self.q, self.v = q, np.zeros(model.nv)
        self.external, self.work = np.zeros(6), np.zeros(len(CHANNELS))
        self._forces, self._pushed = np.zeros((len(CHANNELS), model.nv)), False
        self._integrator = INTEGRATORS[options.integrator](configuration_space(model))
        self._project = options.project == "step"
        self._errors: tuple[Array | None, list[ClosureError]] = None, []
        self._solve = chain.mechanism.solver.acceleration

    def hold(self, force: Array) -> None:
        """Hold the generalised force of the actuators from now on, N m, shape (nv,)."""
        self._forces[0] = force

    def drive(self, torques: Sequence[Array]) -> None:
        """Hold drive torques of each arm from now on, N m, shape (k,) each."""
        self.hold(self.transmission.torque(torques))

    def push(self, external: Array) -> None:
        """Push the payload with a constant wrench about P in world axes from now on, shape (6,)."""
        self.external, self._pushed = external, bool(external.any())
        self._forces[2] = 0.0

    @property
    def force(self) -> Array:
        """Held generalised force of the actuators, N m, shape (nv,)."""
        return self._forces[0]

    def generalised_force(self) -> Array:
        """Return the generalised force of torques, friction and push at the present state, shape (nv,)."""
        return _ALL.dot(self._apply(self.q, self.v))

    def observe(self, q: Array, v: Array, force: Array, external: Array) -> Observation:
        """Return poses, wrenches and energy at n states, with the present payload.

        Args:
            q: Configurations, shape (n, nq).
            v: Velocities, shape (n, nv).
            force: Generalised forces of the actuators, N m, shape (n, nv).
            external: Wrenches on the payload about P in world axes, shape (n, 6).

        Raises:
            OutOfRangeError: a wrench is not finite.
        """
        tau = force + np.array([self.transmission.friction(rates) for rates in v])
        for index in np.flatnonzero(external.any(axis=1)):
            tau[index] += self.chain.payload_jacobian(q[index]).T.dot(external[index])
        return self.chain.observe(q, v, tau, external)

    def interaction_wrenches(self) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes, shape (m, 6)."""
        return self.chain.unchecked_wrenches(self.q, self.v, self.generalised_force(), self.external)

    def closure_errors(self) -> list[ClosureError]:
        """Return the closure error between tip and grasp of each arm at the present state."""
        q = self.q
        if self._errors[0] is not q:  # asked twice a tick
            self._errors = q, self._closure_errors(q)
        return self._errors[1]

    def _closure_errors(self, q: Array) -> list[ClosureError]:
        return self.chain.closure_errors(q)

    def advance(self, t: float, h: float) -> None:
        """Integrate from time t over h seconds."""
        step = self._integrator.step(self._rate, t, self.q, self.v, h)
        self.q, self.v = step.q, step.v
        self.work = self.work + step.work
        if self._project:
            self.q = self.chain.mechanism.project_configuration(self.q)
            self.v = self.chain.mechanism.project_velocity(self.q, self.v)

    def _rate(self, _t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the acceleration, shape (nv,), and the power of each channel, shape (3,)."""
        forces = self._apply(q, v)
        return self._solve(q, v, _ALL.dot(forces)), forces.dot(v)

    def _apply(self, q: Array, v: Array) -> Array:
        """Return the generalised force of each channel, shape (3, nv)."""
        forces = self._forces
        forces[1] = self.transmission.friction(v)
        if self._pushed:
            forces[2] = self.chain.payload_jacobian(q).T.dot(self.external)
        return forces
