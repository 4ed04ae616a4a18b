"""Plant between two ticks: held torques, friction, compliant grasps, and what acts on the payload.

For speed, plant and chain hold state that changes in place: ``Plant.advance`` replaces q and v and adds to
work, ``hold`` replaces the actuators' force and ``surround`` the surroundings, and each call of the dynamics
overwrites the buffers of Pinocchio's ``Data`` and of the solvers. Everything else that a simulation hands out
(measurements, references, controller states, snapshots, results) is a value.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.chain.closure_set import ClosureError
from coop_pin.chain.integrators import INTEGRATORS
from coop_pin.description.events import MISSED, Surroundings
from coop_pin.description.grasp_events import Regrasp
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps.cell_chain import CellChain, Observation
from coop_pin.grasps.contact_patches import PatchesState
from coop_pin.grasps.grasp_springs import GraspsHeld
from coop_pin.grasps.partner import PartnerState, partner_state
from coop_pin.grasps.rigid_grasps import ClosuresHeld
from coop_pin.results.quantities import WORK, WORK_OF_GRASPS


class MissedGrasp(NamedTuple):
    """Grasp that did not happen, because its tip was too far away.

    Attributes:
        event: the event.
        gap: distance and angle of the tip from the grasp, m and rad.
    """

    event: Regrasp
    gap: ClosureError

    def __str__(self) -> str:
        """Return it as one sentence."""
        event, (distance, angle) = self.event, self.gap
        return (
            f"{event.named} {MISSED}: its tip was {1e3 * distance:.3g} mm and {angle:.3g} rad from the grasp,"
            f" allowed are {1e3 * event.tolerance:g} mm and {event.angle_tolerance:g} rad"
        )


class PlantState(NamedTuple):
    """State of a plant; the arrays are not written to.

    Attributes:
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        work: work done so far, J.
        surroundings: payload, and what acts on it from outside.
        force: held generalised force of the actuators, N m, shape (nv,).
        grasps: compliant grasps and closures that hold.
        patches: memory of patches and tables.
        missed: grasps that did not happen.
        time: time, s.
    """

    q: Array
    v: Array
    work: Array
    surroundings: Surroundings
    force: Array
    grasps: tuple[GraspsHeld, ClosuresHeld]
    patches: PatchesState
    missed: tuple[MissedGrasp, ...]
    time: float


class Plant:
    """Closed chain in motion: its state and the forces on it.

    Attributes:
        engine: name of what computes the motion.
        chain: the cell's closed chain.
        transmission: transmission between its drives and joints, with friction.
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        surroundings: payload, and what acts on it from outside.
        missed: grasps that did not happen.
        time: time, s.
        work: done so far, in the order of WORK and, in cells with force elements, WORK_OF_GRASPS, J.
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
        self.chain, self.transmission = chain, chain.transmission
        self._is_elastic = bool(chain.elements.elements)
        works = len(WORK) + self._is_elastic * len(WORK_OF_GRASPS)
        self.q, self.v, self.work, self.time = q, np.zeros(model.nv), np.zeros(works), 0.0
        self.missed: tuple[MissedGrasp, ...] = ()
        chain.damp(q)
        # Rows in the order of the works that a rate does, their sum, and what sums them.
        self._forces = np.zeros((works if self._is_elastic else works - 1, model.nv))
        self._friction, self._sum, self._all = self._forces[1], np.zeros(model.nv), np.ones(len(self._forces))
        self._integrator = INTEGRATORS[options.integrator](model)
        self._project = options.project == "step"
        self._errors: tuple[Array | None, list[ClosureError]] = None, []
        self.surround(chain.cell.surroundings)

    def hold(self, force: Array) -> None:
        """Hold the generalised force of the actuators from now on, N m, shape (nv,)."""
        self._forces[0] = force

    def drive(self, torques: Sequence[Array]) -> None:
        """Hold drive torques of each arm from now on, N m, shape (k,) each."""
        self.hold(self.transmission.torque(torques))

    def surround(self, surroundings: Surroundings) -> None:
        """Replace the surroundings from now on; the energy that this adds counts as work."""
        before = self.energy()
        self.surroundings = surroundings
        self._pushed = surroundings.acts
        self.chain.surround(surroundings)
        self._forces[2] = 0.0
        self._book(before)

    def release(self, arm: int) -> None:
        """Open the grasp of an arm; the energy that its spring loses counts as work."""
        before = self.energy()
        self.chain.release(arm)
        self._book(before)

    def grasp(self, arm: int, event: Regrasp) -> None:
        """Close the grasp of an arm whose tip is there; the energy that it adds or takes counts as work.

        At a rigid grasp the velocities meet by an impulse.
        """
        before, gap = self.energy(), self.chain.gap(arm, self.q)
        if gap.distance > event.tolerance or gap.angle > event.angle_tolerance:
            self.missed += (MissedGrasp(event, gap),)
            return
        self.chain.grasp(arm, self.q, event.rest == "nominal")
        if arm in self.chain.rigid.closed:
            self.v = self.chain.mechanism.project_velocity(self.q, self.v)
        self._book(before)

    def brake(self, arm: int) -> None:
        """Hold the joints of an arm from now on; the energy that the impulse takes counts as work."""
        before = self.energy()
        self.chain.brake(arm, self.q)
        self.v = self.chain.mechanism.project_velocity(self.q, self.v)
        self._book(before)

    def energy(self) -> float:
        """Return the energy of chain and force elements, J."""
        total, springs = self.chain.mechanism.energy(self.q, self.v).total, self.chain.springs
        if len(patches := self.chain.patches):
            total += patches.at(self.q, self.v).energy
        return total + springs.energy(springs.at(self.q, self.v)) if springs.arms else total

    def _book(self, before: float) -> None:
        """Count the energy since before an event as work."""
        added = np.zeros(len(self.work))
        added[len(WORK) - 1] = self.energy() - before
        self.work = self.work + added

    def state(self) -> PlantState:
        """Return the state."""
        held, patches = self.chain.held(), self.chain.patches.state
        work, force, missed = self.work.copy(), self.force.copy(), self.missed
        return PlantState(self.q, self.v, work, self.surroundings, force, held, patches, missed, self.time)

    def restore(self, state: PlantState) -> None:
        """Return to a state."""
        self.q, self.v, self.missed, self.time = state.q, state.v, state.missed, state.time
        self.chain.hold(*state.grasps)
        self.chain.patches.state = state.patches
        self.surround(state.surroundings)
        self.hold(state.force)
        self.work = state.work.copy()

    def payload_wrench(self, q: Array, v: Array, time: float) -> Array:
        """Return the whole wrench on the payload besides gravity about P in world axes, shape (6,).

        It is read only if ``Surroundings.acts``. A force that depends on the state belongs into both and into
        ``batch.cell_dynamics.cell_motion``.

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

    @property
    def force(self) -> Array:
        """Held generalised force of the actuators, N m, shape (nv,)."""
        return self._forces[0]

    def generalised_force(self) -> Array:
        """Return the generalised force of torques, friction and push at the present state, shape (nv,)."""
        return self._force(self.time, self.q, self.v).copy()

    def observe(self, q: Array, v: Array, force: Array, time: Array) -> Observation:
        """Return poses, wrenches and energy at n states in the present surroundings.

        Args:
            q: Configurations, shape (n, nq).
            v: Velocities, shape (n, nv).
            force: Generalised forces of the actuators, N m, shape (n, nv).
            time: Times, s, shape (n,).

        Raises:
            OutOfRangeError: a wrench is not finite.
        """
        tau = force + np.array([self.transmission.friction(rates) for rates in v])
        wrenches = np.zeros((len(q), 6))
        if self._pushed:
            states = zip(q, v, time.tolist(), strict=True)
            wrenches = np.array([self.payload_wrench(*state) for state in states])
            jacobians = map(self.chain.payload_jacobian, q)
            tau += np.array([J.T.dot(F) for J, F in zip(jacobians, wrenches, strict=True)])
        return self.chain.observe(q, v, tau, wrenches)

    def interaction_wrenches(self) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes, shape (m, 6)."""
        q, v = self.q, self.v
        push = self.payload_wrench(q, v, self.time)
        return self.chain.unchecked_wrenches(q, v, self.generalised_force(), push)

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
        self.q, self.v, self.time = step.q, step.v, t + h
        work = self.work[: len(step.work)]
        work += step.work
        if self._project:
            self.q = self.chain.mechanism.project_configuration(self.q)
            self.v = self.chain.mechanism.project_velocity(self.q, self.v)
        if self._is_elastic and len(self.chain.patches):
            self.work[-1] -= self.chain.patches.settle(self.q)

    def _rate(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the acceleration, shape (nv,), and powers in the order of ``work``, the first of them."""
        tau, power = self._force(t, q, v), self._forces.dot(v)
        if not self._is_elastic:
            return self.chain.rigid.mechanism.solver.acceleration(q, v, tau), power
        a, power[-1] = self.chain.acceleration(q, v, tau)
        return a, power

    def _force(self, t: float, q: Array, v: Array) -> Array:
        """Return the generalised force of drives, friction and payload wrench until the next call, (nv,)."""
        self.transmission.friction(v, self._friction)
        if self._pushed:
            self._forces[2] = self.chain.payload_jacobian(q).T.dot(self.payload_wrench(q, v, t))
        return self._all.dot(self._forces, self._sum)
