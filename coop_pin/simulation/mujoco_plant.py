"""Plant by MuJoCo: tree, drives, friction and pushes are those of Pinocchio's, grasps are soft welds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.description.cell.cell import Cell
from coop_pin.description.events import PayloadEvent, Surroundings
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.grasps.observation import Observation
from coop_pin.model.cell_model import CellModel
from coop_pin.model.mujoco_model import MujocoModel, mjcf, mujoco_module, unlike_mujoco
from coop_pin.results.energies import WORK
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import PlantState

_EVENTS = "payload-change", "wrench-pulse", "gravity-turn", "partner"
_STEP = 1e-3
"""Step before the first one, s."""


def unlike_plant(cell: Cell, options: PlantOptions, events: Sequence[PayloadEvent] = ()) -> str:
    """Return the first thing in a cell, its plant and events that MuJoCo's plant lacks; empty if it has all.

    Raises:
        CoopPinError: an arm cannot be loaded.
    """
    without = [f"grasp of {name!r} is not rigid, but gives" for name in cell.unclosed]
    without += [
        f"grasp of {name!r} is a cylinder, and no equality of MuJoCo holds its four rows"
        for name, rows in cell.closing.items()
        if rows == "cylinder"
    ]
    without += [f"table {name!r}" for name in cell.tables]
    without += [
        f"rolling base of arm {name!r} (mobile_base), and no equality of MuJoCo holds a velocity"
        for name in cell.wheels
    ]
    without += [
        f"event is {event.kind!r}, and its welds neither open nor close"
        for event in events
        if event.kind not in _EVENTS
    ]
    return without[0] if without else unlike_mujoco(CellModel(cell, options.payload).model)


def require_mujoco(cell: Cell, options: PlantOptions, events: Sequence[PayloadEvent] = ()) -> None:
    """Refuse the engine for what it lacks.

    Raises:
        FieldError: ``unlike_plant`` is something.
        MissingExtraError: mujoco is not installed.
        CoopPinError: an arm cannot be loaded.
    """
    mujoco_module()
    if text := unlike_plant(cell, options, events):
        raise FieldError(f"is 'mujoco', which does not have this: {text}; choose 'pinocchio'", "engine")


def cell_mjcf(chain: CellChain, options: PlantOptions, step: float, q: Array | None = None) -> str:
    """Return the model of a cell as MJCF, its payload in the hand of the first arm.

    Args:
        chain: Closed chain of the cell.
        options: Integrator, and stiffness of the welds.
        step: Time step, s.
        q: Configuration of key frame "start", shape (nq,).
    """
    closures = chain.rigid.mechanism.closures.closures
    return mjcf(
        chain.model.model, closures, options.mujoco, step=step, integrator=options.integrator, start=q
    )


class MujocoPlant(PinocchioPlant):
    """Cell in motion by MuJoCo, a ``Plant``: accelerations and forces of welds are MuJoCo's.

    The tree has the payload in the first arm's hand. Torques, friction and the push act as generalised
    forces, and the integrator is that of the options. A weld is a stiff, critically damped constraint; so are
    the connects of hinges and balls. What they store and lose is booked as work of grasps.
    """

    engine = "mujoco"
    _GIVES = True

    def __init__(self, chain: CellChain, options: PlantOptions, q: Array) -> None:
        """Start at rest, without torques.

        Args:
            chain: Closed chain of the cell.
            options: Integrator, and stiffness of the welds.
            q: Configuration on the closures, shape (nq,).

        Raises:
            MissingExtraError: mujoco is not installed.
            FieldError: MuJoCo does not have the cell or an option.
        """
        require_mujoco(chain.cell, options)
        closures, self._longest = chain.rigid.mechanism.closures.closures, 0.0
        self._tree = MujocoModel(chain.model.model, closures, options.mujoco, step=_STEP)
        self._determinate, self._apart = chain.rigid.determinate_rows(q), np.zeros(6)
        super().__init__(chain, options, q)

    def surround(self, surroundings: Surroundings) -> None:
        """Replace the surroundings from now on; the energy that this adds counts as work."""
        super().surround(surroundings)
        self._tree.reweigh(self.chain.model.payload_joint)

    def release(self, arm: int) -> NoReturn:
        """Refuse to open a grasp.

        Raises:
            FieldError: always.
        """
        raise FieldError(f"is 'mujoco', whose welds neither open nor close: arm {arm}", "engine")

    def grasp(self, arm: int, *, is_nominal: bool = False) -> NoReturn:
        """Refuse to close a grasp, as ``release``."""
        self.release(arm)

    def brake(self, arm: int) -> NoReturn:
        """Refuse to hold the joints of an arm, as ``release``."""
        self.release(arm)

    def advance(self, t: float, h: float) -> None:
        """Integrate from time t over h seconds.

        The welds are as stiff as the longest step so far allows: a gap that bears a load under one time
        constant would bear another one under that of a step which ends at an event.
        """
        if h > self._longest:
            self._longest = h
            self._tree.soften(h)
        super().advance(t, h)

    def state(self) -> PlantState:
        """Return the state."""
        state = super().state()
        return state._replace(memory=(state.memory, self._longest))

    def restore(self, state: PlantState) -> None:
        """Return to a state, or to one with other q, v, work, force or surroundings."""
        memory, self._longest = state.memory
        self._tree.soften(self._longest or _STEP)
        super().restore(state._replace(memory=memory))

    def _acceleration(self, q: Array, v: Array, tau: Array) -> tuple[Array, float]:
        """Return the acceleration until the next call, shape (nv,), and the power of the welds, W."""
        return self._tree.acceleration(q, v, tau), self._tree.power()

    def interaction_wrenches(self) -> Array:
        """Return the wrench on each arm by the payload, about P in world axes, shape (m, 6)."""
        push = self.payload_wrench(self.q, self.v, self.time)
        return self._wrenches(self.q, self.v, self.generalised_force(), push)

    def observe(self, q: Array, v: Array, force: Array, time: Array) -> Observation:
        """Return what is recorded of n states in the present surroundings, as of Plant.

        The floor bears what it would under rigid grasps at the same states.
        """
        observation = super().observe(q, v, force, time)
        push, tau = observation.external_wrench, force + self.resistance(q, v)
        pairs = zip(map(self.chain.payload_jacobian, q), push, strict=True)
        tau = tau + np.array([J.T @ F for J, F in pairs])
        wrenches = np.array([self._wrenches(*state) for state in zip(q, v, tau, push, strict=True)])
        apart = np.abs(wrenches - observation.interaction_wrench).max(axis=(0, 1), initial=0.0)
        self._apart = np.fmax(self._apart, np.where(self._determinate, apart, 0.0))
        return observation._replace(interaction_wrench=wrenches)

    def remarks(self) -> list[str]:
        """Return how far wrenches were from those of rigid grasps at the same states, in words."""
        force, moment = self._apart.reshape(2, 3).max(axis=1)
        return [
            f"grasps were soft welds of MuJoCo: wrenches within {force:.2g} N and {moment:.2g} N m of those"
            f" of rigid grasps at the same states; they did {self.work[len(WORK)]:.2g} J (work_grasps)"
        ]

    def _wrenches(self, q: Array, v: Array, tau: Array, push: Array) -> Array:
        """Return the interaction wrenches under a generalised force."""
        a, on_tips = self._tree.forces(q, v, tau)
        return self.chain.moved_wrenches(q, v, a, on_tips, push)
