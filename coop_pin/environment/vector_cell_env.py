"""Vector environment of Gymnasium: cells as lanes of a batch, in compiled code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, cast

import numpy as np

from coop_pin.base.arrays import Array, Mask, as_count, as_fitting_count, require_type
from coop_pin.base.disk_cache import DiskCache
from coop_pin.base.errors import ArgumentError, InvalidStateError, TracingError, needs_extra
from coop_pin.compiled.kind import law_reason
from coop_pin.compiled.laws.support import require_traceable
from coop_pin.compiled.preparation import Prepared
from coop_pin.compiled.schedule import RunProgram
from coop_pin.compiled.simulate import BatchSimulator
from coop_pin.description.scenario import Scenario
from coop_pin.environment.acted_law import ActedLaw
from coop_pin.environment.task import RENDER_MODES, EpisodeSeeds, Observed, Task, require_render_mode
from coop_pin.tracing.kernel import Kernel
from coop_pin.tracing.llvm_machine import LlvmMachine
from coop_pin.tracing.traced_array import traced
from coop_pin.tracing.tree import flattened

with needs_extra("gymnasium", "gym", "for environments of agents"):
    from gymnasium.spaces import Box
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

_LANE = 10_000
"""Least memory of a lane while lanes are prepared, bytes; measured."""


class VectorCellEnv(VectorEnv[Array, Array, Array]):
    """Lanes of one scenario, or scenarios that differ in numbers; observations and rewards as of CellEnv.

    All lanes are at the same tick: none is reset before the others (``AutoresetMode.DISABLED``). A lane that
    diverged stays terminated, with observation and reward 0, until ``reset``.

    Attributes:
        scenarios: scenario of each lane.
        task: the task.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "autoreset_mode": AutoresetMode.DISABLED,
        "render_modes": RENDER_MODES,
    }

    def __init__(
        self,
        scenarios: Scenario | Sequence[Scenario],
        task: Task | None = None,
        *,
        num_envs: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Compile the code and start at t = 0.

        Args:
            scenarios: Scenario of all lanes, or one for each, which differ in numbers only.
            task: Task; the default one when omitted.
            num_envs: Number of lanes; of one scenario 1 when omitted.
            render_mode: Mode of ``render``, "ansi" or None.

        Raises:
            WrongTypeError: an argument is of another class.
            NameNotFoundError: there is no such render mode.
            NotEnoughMemoryError: the lanes do not fit.
            ArgumentError: there is no scenario, or their number is another than ``num_envs``; or the task
                does not fit.
            TracingError: a scenario cannot run as compiled code, or they differ in more than numbers.
            CoopPinError: a run cannot start.
        """
        require_type("scenarios", scenarios, Scenario, Sequence)
        runs = [scenarios] if isinstance(scenarios, Scenario) else list(scenarios)
        for index, scenario in enumerate(runs):
            require_type(f"scenarios[{index}]", scenario, Scenario)
        lanes = len(runs) if num_envs is None else as_fitting_count("num_envs", num_envs, 1, _LANE)
        runs *= lanes if len(runs) == 1 else 1
        if not runs or lanes != len(runs):
            raise ArgumentError(
                f"there are {len(runs)} scenarios for num_envs = {num_envs}; give one, or one each"
            )
        self.scenarios, self.num_envs, self.render_mode = runs, len(runs), require_render_mode(render_mode)
        self.task = Task() if task is None else task
        require_type("task", self.task, Task)
        if reason := law_reason(runs[0].controller) or (
            "gains fold into compiled code" if self.task.gains else ""
        ):
            raise TracingError(f"{reason}; take CellEnv")
        self._simulator, self._tick = BatchSimulator(), 0
        is_one = all(scenario is runs[0] for scenario in runs)
        self._seeds = [EpisodeSeeds(scenario.seed + is_one * lane) for lane, scenario in enumerate(runs)]
        prepared = self._prepared([scenario.seed for scenario in runs])
        require_traceable(runs[0], prepared.constants, alone=True)
        self._compile(prepared)
        actions, size = self.task.sizes(self._law)
        self.single_action_space = Box(-1.0, 1.0, (actions,), np.dtype(self.task.dtype).type)
        self.single_observation_space = Box(-np.inf, np.inf, (size,), self.single_action_space.dtype)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._observations = np.zeros((self.num_envs, size), self.task.dtype)
        self._begin(prepared)

    # ------------------------------------------------------------ Gymnasium

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Return all lanes to the start, do the first tick, and return the observations; see VectorEnv.

        Args:
            seed: Seed of the first lane, the next ones have the next; or one for each. When None, the next
                of each lane as of CellEnv, at first those of the scenarios; lanes of one scenario have the
                next ones.
            options: Not used.

        Raises:
            CoopPinError: a seed is no whole number from 0 on, or there is not one for each lane.
        """
        seeds: Any = seed
        stated: list[Any] = [None] * self.num_envs
        if isinstance(seeds, Sequence) or (isinstance(seeds, np.ndarray) and seeds.ndim):
            stated = list(seeds)
        elif seed is not None:
            stated = [as_count("seed", seeds) + lane for lane in range(self.num_envs)]
        if len(stated) != self.num_envs:
            raise ArgumentError(f"there are {len(stated)} seeds for {self.num_envs} lanes; give one each")
        episodes = [each.following(one) for each, one in zip(self._seeds, stated, strict=True)]
        if self._is_random:
            self._begin(self._prepared(episodes))
        self._block[:] = self._first
        self._is_over = np.zeros(self.num_envs, dtype=bool)
        self._act(np.zeros(self.action_space.shape or ()))
        self._tick = 0
        self._advance(1)
        return self._outcome()[0], {}

    def step(self, actions: Array) -> tuple[Array, Array, Mask, Mask, dict[str, Any]]:
        """Act in all lanes for the ticks of an action; see VectorEnv.

        Args:
            actions: Finite numbers, cut to [-1, 1], shape (lanes, n).

        Raises:
            InvalidStateError: the episode is over, or has not begun.
            ArgumentError: the action of a lane is of another shape, or no finite real numbers; it names the
                lane, and nothing has moved.
        """
        values = self.task.actions(actions, *(self.action_space.shape or ()))
        if not 0 < self._tick <= self._plant.timeline.ticks:
            raise InvalidStateError("the episode is over or has not begun; call reset()")
        self._act(values)
        self._advance(min(self.task.ticks, self._plant.timeline.ticks + 1 - self._tick))
        _, rewards = self._outcome()
        is_valid = self._slots("is_valid") == 1.0
        rewards = np.where(is_valid, rewards, np.where(self._is_over, 0.0, -self.task.failure))
        self._observations[~is_valid] = 0.0
        self._is_over = ~is_valid
        is_last = np.full(self.num_envs, self._tick > self._plant.timeline.ticks)
        return self._observations, rewards, self._is_over.copy(), is_last & is_valid, {}

    def render(self) -> tuple[str, ...] | None:
        """Return the last observation of each lane as a line of text, or None without a render mode."""
        if self.render_mode is None:
            return None
        time = self._plant.timeline.time(max(self._tick - 1, 0))
        return tuple(self.task.text(one, self._law, time) for one in self._observations)

    # ------------------------------------------------------------ lanes

    def _prepared(self, seeds: Sequence[int]) -> Prepared:
        """Return the runs with the law acted on, with other seeds."""
        runs, made = list[Prepared](), dict[tuple[int, int], Prepared]()
        for scenario, seed in zip(self.scenarios, seeds, strict=True):
            key = id(scenario), seed
            if key not in made:
                made[key] = self._acted(scenario.replace(seed=seed))
            runs.append(made[key])
        return Prepared.joined(runs)

    def _acted(self, scenario: Scenario) -> Prepared:
        """Return a run with the law acted on."""
        run = self._simulator.prepare(scenario)
        plant = run.plants[0]
        law = self.task.acted(scenario, run.controller(), [len(slot.drive) for slot in plant.slots])
        numbers, structure = flattened(law)
        values = np.array([[*plant.values, *numbers]], dtype=np.float64)
        return run._replace(controller=lambda: law, values=values, kind=run.kind._replace(law=structure))

    def _compile(self, prepared: Prepared) -> None:
        """Trace and compile the code; what actions add, and what differs between lanes or seeds, is input."""
        plant = prepared.plants[0]
        self._plant, law = plant, cast(ActedLaw, prepared.controller())
        self._law = law
        first = len(plant.values)
        added = slice(first, first + len(flattened((law.squeeze, law.commands))[0]))
        differs = ~((prepared.values == prepared.values[0]) | np.isnan(prepared.values)).all(axis=0)
        differs[added] = True
        other = plant.signals(self.scenarios[0].replace(seed=self.scenarios[0].seed + 1))
        is_random = (other != plant.signals(self.scenarios[0])).any(axis=0)
        self._is_random, alone = bool(is_random.any()), prepared.part(slice(1))
        self._code = RunProgram(alone, differs, is_random | prepared.loaded(alone))
        program, order = self._code.program, self._code.order(alone, is_recorded=False)
        kernel = self._outcome_kernel(plant.determined)
        self._starts, self._uniforms = [*order.ticks, len(order.instructions)], order.uniforms
        outcomes = [(len(program.kernels), row) for row in range(len(order.ticks))]
        instructions = np.concatenate((order.instructions, outcomes))
        self._machine = LlvmMachine(
            program._replace(kernels=[*program.kernels, kernel], instructions=instructions),
            cache=DiskCache(),
        )
        inputs = self._code.program.lanes.slots("constants")
        self._additions = inputs[np.cumsum(differs)[added] - 1]

    def _outcome_kernel(self, determined: Mask) -> Kernel:
        """Return code of observations and rewards after a tick, as a function of what the tick has left.

        Args:
            determined: Mask of the rows of wrenches that rigid bodies determine, shape (6,).
        """
        lanes, m = self._code.program.lanes, len(self.scenarios[0].cell.arms)
        lanes.add(shares=(m,), observation=(self.task.sizes(self._law)[1],), reward=())
        kernel, _ = self._code.block.kernel("outcome")
        desired, pose = self._code.block.signals_at(kernel).desired, np.eye(4).astype(object)
        pose[:3] = kernel.read("payload_pose")
        samples = {
            "payload_pose": traced(pose),
            "desired_pose": desired.target.X_WP_d,
            "desired_squeeze": desired.squeeze,
            "tip_position": kernel.read("tip_position"),
            "interaction_wrench": np.where(determined, kernel.read("interaction_wrench"), np.nan),
        }
        twist_error = kernel.read("payload_twist") - desired.target.V_WP_d
        joints = sum(
            len(slot.drive) for slot in self._plant.slots
        )  # a payload on compliant grasps has its own coordinates after them
        observed = Observed(kernel.read("q")[:joints], kernel.read("v")[:joints], samples, twist_error)
        with np.errstate(invalid="ignore"):  # NaN in rows that are not determined
            observation, reward = self.task.outcome(observed, kernel.read("shares"))
        kernel.write("observation", observation)
        kernel.write("reward", reward)
        return kernel

    def _begin(self, prepared: Prepared) -> None:
        """Lay out the lanes at the start: groups of registers, shape (groups, slots, width)."""
        block, loads = self._code.begin(prepared)
        shares = np.array([one.cell.shares for one in prepared.scenarios])
        block[self._code.program.lanes.slots("shares")] = shares.T
        self._first = self._machine.packed(block)
        self._block = self._first.copy()
        self._call: Callable[[int, int], None] = self._machine.bound(
            self._block, self._uniforms, None, self._machine.packed(loads)
        )

    def _act(self, actions: Array) -> None:
        """Write what actions add into the lanes."""
        squeeze, commands = self.task.additions(actions, self._law)
        values = np.concatenate((squeeze.reshape(self.num_envs, -1), *commands), axis=1)
        self._block[:, self._additions] = self._machine.packed(values.T)

    def _advance(self, ticks: int) -> None:
        first, last = self._starts[self._tick], self._starts[self._tick + ticks]
        self._call(first, last - first)
        self._tick += ticks

    def _slots(self, name: str) -> Array:
        """Return a field of the lanes, shape (lanes, ...)."""
        slots = self._code.program.lanes.slots(name)
        values = self._machine.unpacked(self._block[:, slots.ravel()], self.num_envs)
        return values.T.reshape(self.num_envs, *slots.shape)

    def _outcome(self) -> tuple[Array, Array]:
        """Return observations and rewards."""
        self._call(self._starts[-1] + self._tick - 1, 1)
        self._observations = self._slots("observation").astype(self.task.dtype)
        return self._observations, self._slots("reward")
