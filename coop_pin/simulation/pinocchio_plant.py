"""Plant by Pinocchio between two ticks: held torques, friction, grasps, and what acts on the payload.

For speed, plant and chain hold state that changes in place: ``advance`` replaces q and v and adds to work,
``drive`` replaces the actuators' force and ``surround`` the surroundings, and each call of the dynamics
overwrites the buffers of Pinocchio's ``Data`` and of the solvers. Everything else that a simulation hands out
(measurements, references, controller states, snapshots, results) is a value.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.chain.closure_set import ClosureError
from coop_pin.chain.integrators import INTEGRATORS
from coop_pin.description.events import Surroundings
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.grasps.observation import Observation
from coop_pin.grasps.payload_joints import PayloadJoints
from coop_pin.grasps.spring_damper import PartnerState, partner_state
from coop_pin.model.joint_stops import CellStops
from coop_pin.results.energies import WORK, work_names
from coop_pin.simulation.plant import PlantState


class PinocchioPlant:
    """Closed chain in motion, a ``Plant``: its state and the forces on it.

    Attributes:
        engine: name of what computes the motion.
        chain: the cell's closed chain, which holds the grasps and the memory of contacts.
        transmission: transmission between its drives and joints, with friction.
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        surroundings: payload, and what acts on it from outside.
        time: time, s.
        works: names of the works.
        work: done so far, in the order of ``works``, J.
    """

    engine = "pinocchio"
    _GIVES = False
    """Whether rigid grasps give, and do work."""

    def __init__(self, chain: CellChain, options: PlantOptions, q: Array) -> None:
        """Start at rest, without torques.

        Args:
            chain: Closed chain of the cell.
            options: Integrator and projection.
            q: Configuration on the closures, shape (nq,).
        """
        model = chain.mechanism.model
        self.chain, self.transmission = chain, chain.transmission
        self._is_elastic = self._GIVES or bool(chain.elements.elements)
        self._passive: list[CellStops | PayloadJoints] = [
            part for part in (chain.stops, chain.joints) if part
        ]
        self.works = work_names(self._is_elastic, bool(chain.stops), chain.joints is not None)
        works = len(self.works)
        self.q, self.v, self.work, self.time = q, np.zeros(model.nv), np.zeros(works), 0.0
        chain.damp(q)
        # Rows in the order of the works that a rate does, their sum, and what sums them.
        self._forces = np.zeros((works if works > len(WORK) else works - 1, model.nv))
        self._lost = np.zeros(len(self._passive))  # power of stops and payload joints at the last forces
        self._friction, self._sum, self._all = self._forces[1], np.zeros(model.nv), np.ones(len(self._forces))
        self._integrator = INTEGRATORS[options.integrator](model)
        self._project = options.project == "step"
        self._errors: tuple[Array | None, list[ClosureError]] = None, []
        self.surround(chain.cell.surroundings)

    @property
    def force(self) -> Array:
        """Held generalised force of the actuators, N m, shape (nv,)."""
        return self._forces[0]

    def drive(self, torques: Sequence[Array]) -> None:
        """Hold drive torques of each arm from now on, N m, shape (k,) each."""
        self._forces[0] = self.transmission.torque(torques)

    def surround(self, surroundings: Surroundings) -> None:
        """Replace the surroundings from now on; the energy that this adds counts as work."""
        with self._booked():
            self.surroundings = surroundings
            self._pushed = surroundings.acts
            self.chain.surround(surroundings)
            self._forces[2] = 0.0

    def release(self, arm: int) -> None:
        """Open the grasp of an arm; the energy that its spring loses counts as work."""
        with self._booked():
            self.chain.release(arm)

    def gap(self, arm: int) -> ClosureError:
        """Return distance and angle of an arm's tip from its nominal grasp, m and rad."""
        return self.chain.gap(arm, self.q)

    def grasp(self, arm: int, *, is_nominal: bool = False) -> None:
        """Close the grasp of an arm where its tip is, or at the nominal pose; the energy counts as work.

        At a rigid grasp the velocities meet by an impulse.
        """
        with self._booked():
            self.chain.grasp(arm, self.q, is_nominal)
            if arm in self.chain.rigid.closed:
                self.v = self.chain.mechanism.project_velocity(self.q, self.v)

    def brake(self, arm: int) -> None:
        """Hold the joints of an arm from now on; the energy that the impulse takes counts as work."""
        with self._booked():
            self.chain.brake(arm, self.q)
            self.v = self.chain.mechanism.project_velocity(self.q, self.v)

    @contextmanager
    def _booked(self) -> Iterator[None]:
        """Count the energy that a change adds as work."""
        before = self.chain.energy(self.q, self.v)
        yield
        added = np.zeros(len(self.work))
        added[len(WORK) - 1] = self.chain.energy(self.q, self.v) - before
        self.work = self.work + added

    def state(self) -> PlantState:
        """Return the state."""
        work, force = self.work.copy(), self.force.copy()
        return PlantState(self.q, self.v, work, self.surroundings, force, self.time, self.chain.held())

    def restore(self, state: PlantState) -> None:
        """Return to a state, or to one with other q, v, work, force or surroundings."""
        self.q, self.v, self.time = state.q, state.v, state.time
        self.chain.hold(state.memory)
        self.surround(state.surroundings)
        self._forces[0], self.work = state.force, state.work.copy()

    def payload_wrench(self, q: Array, v: Array, time: float) -> Array:
        """Return the whole wrench on the payload, without gravity, about P in world axes, shape (6,).

        It is read only if ``Surroundings.acts``. A force that depends on the state belongs into both and into
        ``compiled.plant.cell_dynamics.cell_motion``.

        Args:
            q: Configuration, shape (nq,).
            v: Velocity, shape (nv,).
            time: Time, s.
        """
        if not self.surroundings.partners:
            return self.surroundings.push
        return np.add.reduce([self.surroundings.push, *(each.wrench for each in self.partners(q, v, time))])

    def partners(self, q: Array, v: Array, time: float) -> list[PartnerState]:
        """Return the partners that hold the payload; arguments as of payload_wrench."""
        X_WP, V_WP = self.chain.payload_pose(q), self.chain.payload_twist(q, v)
        return [partner_state(partner, time, X_WP, V_WP) for partner in self.surroundings.partners]

    def generalised_force(self) -> Array:
        """Return the generalised force of torques, friction and push at the present state, shape (nv,)."""
        return self._force(self.time, self.q, self.v).copy()

    def resistance(self, q: Array, v: Array) -> Array:
        """Return the force of friction, end stops and payload joints at n states, N m, shape (n, nv)."""
        resistance = np.array([self.transmission.friction(rates) for rates in v])
        for part in self._passive:
            resistance = resistance + [part.state(*state).force for state in zip(q, v, strict=True)]
        return resistance

    def observe(self, q: Array, v: Array, force: Array, time: Array) -> Observation:
        """Return what is recorded of n states in the present surroundings, as of Plant."""
        tau = force + self.resistance(q, v)
        states, wrenches = list(zip(q, v, time.tolist(), strict=True)), np.zeros((len(q), 6))
        if self._pushed:
            wrenches = np.array([self.payload_wrench(*state) for state in states])
            jacobians = map(self.chain.payload_jacobian, q)
            tau += np.array([J.T.dot(F) for J, F in zip(jacobians, wrenches, strict=True)])
        observation = self.chain.observe(q, v, tau, wrenches)
        if shared := self.chain.model.shared:
            columns = [slot.v_slice.start for slot in shared]
            observation = observation._replace(shared_force=force[:, columns])
        if not self.surroundings.partners:
            return observation
        wrench, deflection, energy, *_ = zip(*(self.partners(*state)[-1] for state in states), strict=True)
        return observation._replace(
            partner_wrench=np.array(wrench),
            partner_deflection=np.array(deflection),
            partner_energy=np.array(energy),
        )

    def payload_pose(self) -> Array:
        """Return X_WP, shape (4, 4)."""
        return self.chain.payload_pose(self.q)

    def slips(self) -> Array:
        """Return the distance that each arm's patch has slid, m, shape (p,)."""
        return self.chain.patches.slips

    def remarks(self) -> list[str]:
        """Return nothing: what the plant is stands in the scenario."""
        return []

    def interaction_wrenches(self) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes, shape (m, 6)."""
        push = self.payload_wrench(self.q, self.v, self.time)
        return self.chain.unchecked_wrenches(self.q, self.v, self.generalised_force(), push)

    def closure_errors(self) -> list[ClosureError]:
        """Return the closure error between tip and grasp of each arm at the present state."""
        q = self.q
        if self._errors[0] is not q:  # twice a tick
            self._errors = q, self.chain.closure_errors(q)
        return self._errors[1]

    def advance(self, t: float, h: float) -> None:
        """Integrate from time t over h seconds."""
        step = self._integrator.step(self._rate, t, self.q, self.v, h)
        self.q, self.v, self.time = step.q, step.v, t + h
        work = self.work[: len(step.work)]
        work += step.work
        if self._project:
            self.q = self.chain.mechanism.project_configuration(self.q)
        if (
            self._project or self.chain.model.wheels
        ):  # wheels slide by the error of a step otherwise, 1e-11 m/s
            self.v = self.chain.mechanism.project_velocity(self.q, self.v)
        if self._is_elastic and len(self.chain.patches):
            self.work[len(WORK)] -= self.chain.patches.settle(self.q)

    def _rate(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the acceleration, shape (nv,), and powers in the order of ``work``, the first of them."""
        tau, power = self._force(t, q, v), self._forces.dot(v)
        if self._passive:
            power[-len(self._passive) :] = self._lost
        if not self._is_elastic:
            return self.chain.rigid.mechanism.solver.acceleration(q, v, tau), power
        a, power[len(WORK)] = self._acceleration(q, v, tau)
        return a, power

    def _acceleration(self, q: Array, v: Array, tau: Array) -> tuple[Array, float]:
        """Return the acceleration, shape (nv,), and the power of grasps that give, W."""
        return self.chain.acceleration(q, v, tau)

    def _force(self, t: float, q: Array, v: Array) -> Array:
        """Return the generalised force of drives, friction and payload wrench until the next call, (nv,)."""
        self.transmission.friction(v, self._friction)
        if self._passive:
            for row, part in enumerate(self._passive, start=-len(self._passive)):
                self._forces[row], _, self._lost[row] = part.state(q, v)
        if self._pushed:
            self._forces[2] = self.chain.payload_jacobian(q).T.dot(self.payload_wrench(q, v, t))
        return self._all.dot(self._forces, self._sum)
