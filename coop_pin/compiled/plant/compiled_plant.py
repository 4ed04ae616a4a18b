"""Plant of a single run as compiled code, under an interpreted law, in place of Pinocchio's solvers."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from coop_pin.base.arrays import Array, require_finite
from coop_pin.base.disk_cache import DiskCache
from coop_pin.base.errors import ArgumentError, TracingError
from coop_pin.chain.closure_set import ClosureError
from coop_pin.compiled.kind import plant_reason
from coop_pin.compiled.plant.cell_numbers import CellNumbers, GraspNumbers
from coop_pin.compiled.plant.plant_code import STEPS_AT_ONCE, PlantCode, observation_field, varying
from coop_pin.description.events import Surroundings
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.grasps.observation import Observation
from coop_pin.results.energies import WORK
from coop_pin.simulation.plant import PlantState
from coop_pin.tracing.llvm_machine import LlvmMachine
from coop_pin.tracing.tree import leaves, structure

_KEPT_CODES = 8
"""Cells whose code a process keeps."""


class CompiledPlant:
    """Cell in motion, a ``Plant``, whose steps and observations are compiled code.

    Steps wait until the state is read or a force changes, so that a tick without events is one call. Events
    act on the cell's chain, whose numbers the code then reads again.

    Attributes:
        engine: name of what computes the motion.
        chain: the cell's closed chain, which holds the grasps.
        surroundings: payload, and what acts on it from outside.
        force: held generalised force of the actuators, N m, shape (nv,).
        time: time, s.
        works: names of the works.
    """

    engine = "compiled"

    def __init__(self, chain: CellChain, options: PlantOptions, q: Array) -> None:
        """Start at rest, without torques; arguments as of PinocchioPlant.

        Raises:
            ArgumentError: the engine does not have the options, or an arm is no serial chain.
            MissingExtraError: llvmlite is not installed.
        """
        chain.damp(q)
        numbers = _numbers(chain, options)
        self.works = numbers.works
        code, self._machine = _compiled(numbers)
        self._slots = code.lanes.slots
        self._waiting: list[float] = []
        self._is_observed = False
        self._block, self._lengths = np.zeros(code.lanes.size), np.zeros((STEPS_AT_ONCE, 1))
        self._call = self._machine.bound(self._block, self._lengths)
        self._at = code.lanes.views(self._block)
        self._fields, self._joints = code.fields, len(self._at["force"])
        self._arms, self._is_vector = chain.model.arms, all(a.angles.is_vector for a in chain.model.arms)
        self.chain, self.time = chain, 0.0
        self._put(q, *np.zeros((2, chain.mechanism.model.nv)))
        self.surround(chain.cell.surroundings)

    @property
    def q(self) -> Array:
        """Configuration, shape (nq,)."""
        self._settle()
        return self._q

    @property
    def v(self) -> Array:
        """Velocity, shape (nv,)."""
        self._settle()
        return self._v

    @property
    def work(self) -> Array:
        """Work done so far, as of Plant."""
        self._settle()
        return self._at["work"].copy()

    def state(self) -> PlantState:
        """Return the state."""
        held = self.chain.held()
        return PlantState(self.q, self.v, self.work, self.surroundings, self.force, self.time, held)

    def restore(self, state: PlantState) -> None:
        """Return to a state, or to one with other q, v, work, force or surroundings."""
        self._waiting.clear()
        self.time = state.time
        self.chain.hold(state.memory)
        self._put(state.q, state.v, state.force)
        self.surround(state.surroundings)
        self._at["work"][:] = state.work

    def _put(self, q: Array, v: Array, force: Array) -> None:
        """Write a state into the slots."""
        self._q, self._v, self.force = q, v, force
        self._at["q"][:], self._at["v"][:], self._at["force"][:] = self._angles(q), v, force[: self._joints]
        self._is_observed = False

    def drive(self, torques: Sequence[Array]) -> None:
        """Hold drive torques of each arm from now on, N m, shape (k,) each."""
        self._settle()
        self.force = self.chain.transmission.torque(torques)
        self._at["force"][:] = self.force[: self._joints]
        self._is_observed = False

    def surround(self, surroundings: Surroundings) -> None:
        """Replace the surroundings from now on; the energy that this adds counts as work.

        Raises:
            TracingError: a partner holds the payload.
        """
        if surroundings.partners:
            raise TracingError("the compiled plant has no partners; choose the engine 'pinocchio'")
        with self._changing():
            self.surroundings = surroundings
            self.chain.surround(surroundings)

    def release(self, arm: int) -> None:
        """Open the compliant grasp of an arm; the energy that its spring loses counts as work.

        Raises:
            TracingError: the grasp is rigid.
        """
        self._require_compliant(arm)
        with self._changing():
            self.chain.release(arm)

    def gap(self, arm: int) -> ClosureError:
        """Return distance and angle of an arm's tip from its nominal grasp, m and rad."""
        return self.chain.gap(arm, self.q)

    def grasp(self, arm: int, *, is_nominal: bool = False) -> None:
        """Close the compliant grasp of an arm where its tip is, or at the nominal pose, as of Plant.

        Raises:
            TracingError: the grasp is rigid.
        """
        self._require_compliant(arm)
        with self._changing():
            self.chain.grasp(arm, self._q, is_nominal)

    def _require_compliant(self, arm: int) -> None:
        if arm not in self.chain.springs.arms:
            raise TracingError("the compiled plant keeps rigid grasps closed; choose the engine 'pinocchio'")

    def brake(self, arm: int) -> None:
        """Refuse to brake an arm.

        Raises:
            TracingError: always.
        """
        raise TracingError("the compiled plant has no brakes; choose the engine 'pinocchio'")

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Write what a change makes of the chain's numbers, and count the energy that it adds as work."""
        q, v = self.q, self.v
        before = self.chain.energy(q, v)
        yield
        self._at["surroundings"][:] = leaves(self.surroundings)
        self._at["grasps"][:] = leaves(GraspNumbers.of_chain(self.chain))
        self._at["work"][len(WORK) - 1] += self.chain.energy(q, v) - before
        self._is_observed = False

    def advance(self, t: float, h: float) -> None:
        """Integrate from time t over h seconds."""
        self._waiting.append(h)
        self.time = t + h
        if len(self._waiting) == STEPS_AT_ONCE:
            self._settle()

    def observe(self, q: Array, v: Array, force: Array, time: Array) -> Observation:
        """Return what is recorded of n states in the present surroundings, as of Plant."""
        blocks = np.tile(self._block, (len(q), 1))
        for name, values in (("q", self._angles(q)), ("v", v), ("force", force[:, : self._joints])):
            blocks[:, self._slots(name).ravel()] = values
        self._machine.bound(blocks, self._lengths)(0, 1)
        of_arms = self.chain.springs.of_arms
        observation = Observation(
            **{name: observation_field(name, blocks[:, self._slots(name)], of_arms) for name in self._fields}
        )
        require_finite("the interaction wrenches", observation.interaction_wrench)
        return observation

    def interaction_wrenches(self) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes, shape (m, 6)."""
        return self._observed()["interaction_wrench"].copy()

    def payload_pose(self) -> Array:
        """Return X_WP, shape (4, 4)."""
        return self.chain.payload_pose(self.q)

    def slips(self) -> Array:
        """Return no slip: no arm has a patch, shape (0,)."""
        return np.zeros(0)

    def remarks(self) -> list[str]:
        """Return nothing: what the plant is stands in the scenario."""
        return []

    def closure_errors(self) -> list[ClosureError]:
        """Return the closure error between tip and grasp of each arm."""
        return [ClosureError(*error) for error in self._observed()["closure_errors"].tolist()]

    def _observed(self) -> dict[str, Array]:
        """Return the slots after an observation, which is made once for a state and its forces."""
        self._settle()
        if not self._is_observed:
            self._call(0, 1)
            self._is_observed = True
        return self._at

    def _settle(self) -> None:
        """Make the steps that wait."""
        if not self._waiting:
            return
        self._is_observed = False
        count, self._lengths[: len(self._waiting), 0] = len(self._waiting), self._waiting
        self._waiting.clear()
        self._call(1, 2 * count)
        self._v, q = self._at["v"].copy(), self._at["q"].copy()
        self._q = q if self._is_vector else self._configuration(q)

    def _angles(self, q: Array) -> Array:
        if self._is_vector:
            return q
        free = q[..., self._arms[-1].q_slice.stop :]
        return np.concatenate([*(arm.angles.of(q[..., arm.q_slice]) for arm in self._arms), free], axis=-1)

    def _configuration(self, angles: Array) -> Array:
        parts = [arm.angles.configuration(angles[arm.v_slice]) for arm in self._arms]
        return np.concatenate((*parts, angles[self._joints :]))


def _numbers(chain: CellChain, options: PlantOptions) -> CellNumbers:
    """Return the constants of a cell; raises ArgumentError as CompiledPlant."""
    if reason := plant_reason(options, chain.cell):
        raise ArgumentError(f"engine 'compiled' does not fit: {reason}; choose engine 'pinocchio'")
    try:
        return CellNumbers.from_chain(chain)
    except TracingError as error:
        raise ArgumentError(f"engine 'compiled' does not fit: {error}; choose engine 'pinocchio'") from None


_CODES: dict[Hashable, tuple[PlantCode, LlvmMachine]] = {}


def _compiled(cell: CellNumbers) -> tuple[PlantCode, LlvmMachine]:
    """Return the code of a plant, which is traced once in a process for all surroundings."""
    read = varying(cell)
    folded = cell._asdict() | dict.fromkeys(read)
    key = structure(folded), tuple(leaves(folded)), structure(read)
    if key not in _CODES:
        if len(_CODES) == _KEPT_CODES:
            del _CODES[next(iter(_CODES))]
        code = PlantCode(cell)
        _CODES[key] = code, LlvmMachine(code.program, 1, DiskCache())
    return _CODES[key]
