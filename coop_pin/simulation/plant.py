"""Plant of a run, as an interface: what sensors, drives, events, recorder and loop ask of a cell in motion.

``PinocchioPlant`` computes the motion with Pinocchio, ``CompiledPlant`` (coop_pin.compiled) as compiled code;
another engine is one more class with these members, which a ``PlantMaker`` makes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import DivergedError
from coop_pin.chain.closure_set import ClosureError
from coop_pin.description.events import Surroundings
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.grasps.observation import Observation

# A run beyond these has diverged: joint speed, rad/s; closure error, m or rad.
SPEED_LIMIT = 1e3
CLOSURE_ERROR_LIMIT = 1e-2


class PlantState(NamedTuple):
    """State of a plant; the arrays are not written to.

    Attributes:
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        work: work done so far, J.
        surroundings: payload, and what acts on it from outside.
        force: held generalised force of the actuators, N m, shape (nv,).
        time: time, s.
        memory: grasps, brakes and contacts, in a form of the plant's own.
    """

    q: Array
    v: Array
    work: Array
    surroundings: Surroundings
    force: Array
    time: float
    memory: Any


class Plant(Protocol):
    """Cell in motion between two ticks; q and v are in the order of the cell's tree (``ArmPlace``).

    Its attributes are read-only to others: ``restore`` puts it to another state.
    """

    @property
    def engine(self) -> str:
        """Name of what computes the motion."""

    @property
    def q(self) -> Array:
        """Configuration, shape (nq,)."""

    @property
    def v(self) -> Array:
        """Velocity, shape (nv,)."""

    @property
    def force(self) -> Array:
        """Held generalised force of the actuators, N m, shape (nv,)."""

    @property
    def works(self) -> tuple[str, ...]:
        """Names of the works, of ``work_names``."""

    @property
    def work(self) -> Array:
        """Work so far, in the order of ``works``, J."""

    def state(self) -> PlantState:
        """Return the state."""

    def restore(self, state: PlantState) -> None:
        """Return to a state, or to one with other q, v, work, force or surroundings."""

    def drive(self, torques: Sequence[Array]) -> None:
        """Hold drive torques of each arm from now on, N m, shape (k,) each."""

    def advance(self, t: float, h: float) -> None:
        """Integrate from time t over h seconds."""

    def surround(self, surroundings: Surroundings) -> None:
        """Replace the surroundings from now on; the energy that this adds counts as work."""

    def release(self, arm: int) -> None:
        """Open the grasp of an arm; the energy that its spring loses counts as work."""

    def grasp(self, arm: int, *, is_nominal: bool = False) -> None:
        """Close the grasp of an arm where its tip is, or at the nominal pose; the energy counts as work."""

    def gap(self, arm: int) -> ClosureError:
        """Return distance and angle of an arm's tip from its nominal grasp, m and rad."""

    def brake(self, arm: int) -> None:
        """Hold the joints of an arm from now on; the energy that the impulse takes counts as work."""

    def payload_pose(self) -> Array:
        """Return X_WP, shape (4, 4)."""

    def interaction_wrenches(self) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes, shape (m, 6)."""

    def closure_errors(self) -> Sequence[ClosureError]:
        """Return the closure error between tip and grasp of each arm."""

    def slips(self) -> Array:
        """Return the distance that each arm's patch has slid, m, shape (p,)."""

    def remarks(self) -> list[str]:
        """Return what the summary of the run says of the plant, a sentence each."""

    def observe(self, q: Array, v: Array, force: Array, time: Array) -> Observation:
        """Return what is recorded of n states in the present surroundings.

        Args:
            q: Configurations, shape (n, nq).
            v: Velocities, shape (n, nv).
            force: Generalised forces of the actuators, N m, shape (n, nv).
            time: Times, s, shape (n,).

        Raises:
            OutOfRangeError: a wrench is not finite.
        """


PlantMaker: TypeAlias = Callable[[CellChain, PlantOptions, Array], Plant]
"""Maker of a plant of a cell at rest at a configuration on the closures, shape (nq,), without torques."""


def require_closed(plant: Plant, time: float) -> None:
    """Refuse a state that diverged since a time, s; ``not <`` also catches NaN.

    Raises:
        DivergedError: a speed or a closure error is beyond its limit.
    """
    v = plant.v
    if not v.dot(v) < SPEED_LIMIT**2 and not (speed := float(np.abs(v).max())) < SPEED_LIMIT:
        raise DivergedError(time, "joint speed, rad/s,", speed, SPEED_LIMIT)
    closure_error = max(map(max, plant.closure_errors()))
    if not closure_error < CLOSURE_ERROR_LIMIT:
        raise DivergedError(time, "closure error, m or rad,", closure_error, CLOSURE_ERROR_LIMIT)
