"""Environment of Gymnasium: one cell, stepped by Pinocchio."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import DivergedError, InvalidStateError, SingularJacobianError, needs_extra
from coop_pin.description.scenario import Scenario
from coop_pin.environment.acted_law import ActedLaw
from coop_pin.environment.task import RENDER_MODES, EpisodeSeeds, Observed, Task, require_render_mode
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

with needs_extra("gymnasium", "gym", "for environments of agents"):
    from gymnasium import Env
    from gymnasium.spaces import Box


class CellEnv(Env[Array, Array]):
    """A scenario for an agent; ``Task`` says what it does, observes and is paid.

    ``reset`` does the first tick with the action 0, so that there are wrenches to observe. The episode is
    truncated at the scenario's duration and terminated if the run diverges. The seed is that of the
    scenario's sensors and drives. ``render`` returns a line of text (mode "ansi") on the last observation.

    Attributes:
        simulation: the run.
        task: the task.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": RENDER_MODES}

    def __init__(
        self, scenario: Scenario, task: Task | None = None, *, render_mode: str | None = None
    ) -> None:
        """Start at t = 0.

        Args:
            scenario: Scenario; its law acts unless the task says otherwise.
            task: Task; the default one when omitted.
            render_mode: Mode of ``render``, "ansi" or None.

        Raises:
            WrongTypeError: an argument is of another class.
            ArgumentError: the task does not fit the scenario.
            NameNotFoundError: the law has no such gain, or there is no such render mode.
            CoopPinError: the run cannot start.
        """
        require_type("scenario", scenario, Scenario)
        self.task, self.render_mode = Task() if task is None else task, require_render_mode(render_mode)
        require_type("task", self.task, Task)
        if self.task.gains:
            scenario = scenario.replace(beyond_bound=True)
            self.task.retuned(scenario, np.zeros(len(self.task.gains)))
        law = build_controller(scenario)
        drives = [len(slot.drive) for slot in Simulation(scenario, law).slots]
        self._law: ActedLaw = self.task.acted(scenario, law, drives)
        self.simulation, self._seeds = Simulation(scenario, self._law), EpisodeSeeds(scenario.seed)
        actions, size = self.task.sizes(self._law)
        self.action_space = Box(-1.0, 1.0, (actions,), np.dtype(self.task.dtype).type)
        self.observation_space = Box(-np.inf, np.inf, (size,), self.action_space.dtype)
        self._observation = np.zeros(size, self.task.dtype)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Return to the start, do its first tick, and return the observation; see Env.

        Args:
            seed: Seed of this episode, and of the generator that draws those of the next ones; when None the
                next one, at first that of the scenario.
            options: Not used.

        Raises:
            CoopPinError: the seed is no whole number from 0 on.
        """
        episode = self._seeds.following(seed)
        super().reset(seed=None if seed is None else episode)
        self.simulation.reset(episode)
        self.simulation.tick()
        return self._outcome()[0], {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Act for the ticks of an action; see Env.

        Args:
            action: Finite numbers, cut to [-1, 1], shape (n,).

        Raises:
            InvalidStateError: the episode is over or has not begun.
            ArgumentError: the action is of another shape, or no finite real numbers; nothing has moved.
        """
        run, action = self.simulation, self.task.actions(action, *(self.action_space.shape or ()))
        if run.ticks_done == 0:
            raise InvalidStateError("the episode has not begun; call reset()")
        additions, law = self.task.additions(action, self._law), self._law.law
        if self.task.gains:
            law = build_controller(self.task.retuned(run.scenario, action))
        run.controller = ActedLaw(*additions, law, self._law.kind)
        try:
            for _ in range(max(1, min(self.task.ticks, run.timeline.ticks + 1 - run.ticks_done))):
                run.tick()
            observation, reward = self._outcome()
        except (DivergedError, SingularJacobianError) as error:
            self._observation = np.zeros_like(self._observation)
            return self._observation, -self.task.failure, True, False, {"error": str(error)}
        return observation, reward, False, run.is_finished, {}

    def render(self) -> str | None:
        """Return the last observation as a line of text, or None without a render mode."""
        run = self.simulation
        time = run.timeline.time(max(run.ticks_done - 1, 0))
        return self.task.text(self._observation, self._law, time) if self.render_mode else None

    def _outcome(self) -> tuple[Array, float]:
        """Return observation and reward."""
        run = self.simulation
        last, plant = run.recorder.sample(), run.plant
        q = np.concatenate([arm.angles.of(plant.q[None, arm.q_slice])[0] for arm in run.slots])
        v = np.concatenate([plant.v[arm.v_slice] for arm in run.slots])
        error = last["payload_twist"] - last["desired_twist"]
        observed = Observed(q[None], v[None], last, error)
        observation, reward = self.task.outcome(observed, run.scenario.cell.shares)
        self._observation = observation[0].astype(self.task.dtype)
        return self._observation, float(reward[0])
