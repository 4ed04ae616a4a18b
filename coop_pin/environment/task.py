"""Task of an agent in a cell: what its actions add to a law, what it observes, and its reward."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.base.arrays import (
    Array,
    as_array,
    as_count,
    as_number,
    as_positive,
    require_known,
    require_type,
)
from coop_pin.base.errors import ArgumentError, NameNotFoundError, OutOfRangeError
from coop_pin.base.spatial import rotate_vector6
from coop_pin.description.scenario import Scenario
from coop_pin.environment.acted_law import ActedLaw
from coop_pin.results.quantities import QUANTITIES
from coop_pin.results.quantity import computed

RENDER_MODES = ["ansi"]
"""Render modes of the environments: a line of text. Pictures are too slow: they are made of a whole run."""


def require_render_mode(mode: str | None) -> str | None:
    """Return a render mode.

    Raises:
        NameNotFoundError: there is no such mode.
    """
    if mode is not None:
        require_known("render mode", mode, RENDER_MODES, "environments of cells")
    return mode


class EpisodeSeeds:
    """Seeds of the episodes of a cell: a stated one, then those that its generator draws."""

    def __init__(self, first: int) -> None:
        """Begin with the seed of the first episode, unless another one is stated."""
        self._first: int | None = first
        self._generator = np.random.default_rng(first)

    def following(self, stated: object = None) -> int:
        """Return the seed of the next episode.

        Args:
            stated: Seed from which the generator starts anew; None for the next one.

        Raises:
            CoopPinError: it is no whole number from 0 on.
        """
        first, self._first = self._first, None
        if stated is not None:
            first = as_count("seed", stated)
            if (bits := first.bit_length()) > 63:
                raise ArgumentError(f"seed has {bits} bits; it must have at most 63")
            self._generator = np.random.default_rng(first)
        return int(self._generator.integers(2**62)) if first is None else first


_OBSERVED = ("pose_error", "internal_wrench", "desired_internal_wrench", "axial_direction")


def _largest(errors: Array) -> Array:
    return functools.reduce(np.maximum, [np.abs(errors[..., arm]) for arm in range(errors.shape[-1])])


REWARDS: Mapping[str, tuple[str, Callable[[Array], Array]]] = {
    "position_error_m": ("pose_error", lambda error: np.linalg.norm(error[..., :3], axis=-1)),
    "orientation_error_rad": ("pose_error", lambda error: np.linalg.norm(error[..., 3:], axis=-1)),
    "internal_axial_error_N": ("internal_axial_error", _largest),
    "internal_shear_error_N": ("internal_shear_error", _largest),
    "internal_moment_error_Nm": ("internal_moment_error", _largest),
}
"""Metrics of a tick by name, each a function of a quantity; of arms the largest."""


class Observed(NamedTuple):
    """What observation and reward are made of, of one or more runs.

    Attributes:
        q: drive or joint angles now, rad or m, shape (..., N).
        v: their rates now, shape (..., N).
        samples: samples of the last tick, as of Quantity.
        twist_error: V_WP - V_WP_d at the last tick, shape (..., 6).
    """

    q: Array
    v: Array
    samples: Mapping[str, Any]
    twist_error: Array


@dataclass(frozen=True)
class Task:
    """What an agent does in a cell.

    An action a in [-1, 1]^n acts for some ticks. With "torque" or "velocity" it adds ``scale`` a to the
    commands of the law, or without the law to the torques that hold the start or to rest: n is the number of
    drives. With "squeeze" it adds ``scale`` a to the desired internal wrenches of all arms but the last,
    which gets what makes their sum 0, in payload axes: n = (m - 1) k_0. With "gains" it multiplies each named
    gain of the law by 1 + ``scale`` a, beyond stated bounds too; the law's state goes on: n is their number.

    The observation is, in this order: joint angles and rates of all arms now; of the last tick the payload's
    pose error (m, rad) and twist error (m/s, rad/s), 6 each, in world axes; and each arm's error of the
    internal wrench (N, N m), 6 for each arm, in payload axes. Rows that rigid bodies do not determine are 0.

    The reward of an action is minus the weighted metrics at its last tick. A run that diverges ends, with
    ``-failure`` as its last reward.

    Attributes:
        action: name of what an action changes.
        scale: largest change, N m or rad/s of each drive, N and N m of each row, or a part of gains below 1.
        rewards: weight of each metric, by its name in REWARDS.
        ticks: ticks of an action.
        law: whether the law of the scenario acts.
        failure: cost of a run that diverges.
        gains: names of fields of the law's gains, for actions on them.
        dtype: type of the entries of actions and observations; runs and rewards are of float64.
    """

    action: Literal["torque", "velocity", "squeeze", "gains"] = "squeeze"
    scale: float = 1.0
    rewards: Mapping[str, float] = field(
        default_factory=lambda: {"internal_axial_error_N": 1.0, "position_error_m": 1e3}
    )
    ticks: int = 4
    law: bool = True
    failure: float = 1e3
    gains: tuple[str, ...] = ()
    dtype: Literal["float32", "float64"] = "float32"

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            NameNotFoundError: there is no such metric, action or type.
            WrongTypeError: a value is of another type than stated.
            ArgumentError: a value is out of range, a squeeze is asked of no law, a gain is named twice, or
                gains are named for other actions or not for theirs.
        """
        as_positive("scale", self.scale)
        as_count("ticks", self.ticks, 1)
        as_number("failure", self.failure)
        require_type("law", self.law, bool)
        require_type("rewards", self.rewards, Mapping)
        require_type("gains", self.gains, tuple, list)
        for name, value, known in (
            ("action", self.action, ("torque", "velocity", "squeeze", "gains")),
            ("dtype", self.dtype, ("float32", "float64")),
        ):
            require_known(name, value, known, "Task")
        for name, weight in self.rewards.items():
            require_known("metric", name, [*REWARDS], "REWARDS")
            as_number(f"rewards[{name!r}]", weight)
        if self.action in ("squeeze", "gains") and not self.law:
            raise ArgumentError(f"action {self.action!r} is a change of what a law does; set law=True")
        if (self.action == "gains") != bool(self.gains):
            raise ArgumentError(
                f"action is {self.action!r}, gains are {self.gains}; name gains for 'gains' only"
            )
        if len({*map(str, self.gains)}) < len(self.gains):
            raise ArgumentError(f"gains {self.gains} name one twice; name each once")
        if self.gains and not self.scale < 1.0:
            raise OutOfRangeError("scale", self.scale, "below 1, so that gains keep their sign")

    def acted(self, scenario: Scenario, law: Any, drives: list[int]) -> ActedLaw:
        """Return the law of a scenario without additions yet.

        Args:
            scenario: Scenario.
            law: Controller that it names.
            drives: Number of each arm's drives.

        Raises:
            ArgumentError: the arms take other commands than the actions are.
        """
        kind, *others = sorted({law.commands_of(arm) for arm in scenario.cell.arms})
        if others:
            raise ArgumentError(f"the law commands {kind} and {others[0]}; take arms of one kind")
        if self.action in ("torque", "velocity") and kind != self.action:
            raise ArgumentError(
                f"action {self.action!r} does not fit: the scenario's law commands a {kind}; take action"
                f" {kind!r}, or a law and servos that take a {self.action}"
            )
        squeeze = np.zeros((len(drives), scenario.cell.task_rows.size))
        return ActedLaw(squeeze, [np.zeros(k) for k in drives], law if self.law else None, kind)

    def sizes(self, law: ActedLaw) -> tuple[int, int]:
        """Return the number n of actions and of what is observed."""
        drives, arms = sum(map(len, law.commands)), len(law.commands)
        actions = {"squeeze": law.squeeze[:-1].size, "gains": len(self.gains)}.get(self.action, drives)
        return actions, 2 * drives + 12 + 6 * arms

    def retuned(self, scenario: Scenario, action: Array) -> Scenario:
        """Return a scenario whose law has the gains of an action.

        Args:
            scenario: Scenario with the law's own gains.
            action: Action, cut to [-1, 1], shape (n,).

        Raises:
            NameNotFoundError: the law has no such gain.
        """
        law: Any = scenario.controller
        gains = {name: value for name, value in law.gains if value is not None}
        for name in self.gains:
            if name not in gains:
                raise NameNotFoundError("gain", name, [*gains], "controller.gains")
        factors = 1.0 + self.scale * np.clip(action, -1.0, 1.0)
        changes = {
            f"controller.gains.{name}": (factor * np.array(gains[name])).tolist()
            for name, factor in zip(self.gains, factors, strict=True)
        }
        return scenario.override(changes)

    def additions(self, action: Array, law: ActedLaw) -> tuple[Array, list[Array]]:
        """Return what actions add, of one or more runs: squeeze (..., m, k_0) and commands, (..., k) each.

        Args:
            action: Actions, cut to [-1, 1], shape (..., n).
            law: Law without additions.
        """
        change, lead = self.scale * np.clip(action, -1.0, 1.0), action.shape[:-1]
        squeeze = np.zeros((*lead, *law.squeeze.shape))
        commands = [np.zeros((*lead, len(base))) for base in law.commands]
        if self.action == "gains":
            return squeeze, commands
        if self.action == "squeeze":
            squeeze[..., :-1, :] = change.reshape(*lead, -1, squeeze.shape[-1])
            squeeze[..., -1, :] = -squeeze[..., :-1, :].sum(axis=-2)
        else:
            ends = np.cumsum([len(base) for base in law.commands])[:-1]
            commands = np.split(change, ends, axis=-1)
        return squeeze, commands

    def actions(self, actions: object, *shape: int) -> Array:
        """Return the actions of a cell, shape (n,), or of lanes, shape (lanes, n).

        Args:
            actions: Actions as an agent gives them.
            shape: Shape that they must have.

        Raises:
            ArgumentError: they have another shape, or an entry is no finite real number; it names the lane.
        """
        try:
            return as_array("action", cast(ArrayLike, actions), *shape)
        except ArgumentError:
            if len(shape) > 1 and isinstance(actions, Sequence | np.ndarray) and len(actions) == shape[0]:
                for lane, action in enumerate(actions):
                    as_array(f"lane {lane}: action", action, shape[1])
            raise

    def text(self, observation: Array, law: ActedLaw, time: float) -> str:
        """Return an observation as a line of text, for people who look on.

        Args:
            observation: Observation of a cell, shape (size,).
            law: Law of the cell.
            time: Time, s.
        """
        pose, _, *wrenches = observation[2 * sum(map(len, law.commands)) :].reshape(-1, 6)
        force = max(np.linalg.norm(wrench[:3]) for wrench in wrenches)
        return (
            f"t = {time:.4f} s: position error {1e3 * np.linalg.norm(pose[:3]):.3f} mm, orientation error"
            f" {1e3 * np.linalg.norm(pose[3:]):.3f} mrad, largest error of an internal force {force:.3f} N"
        )

    def outcome(self, observed: Observed, shares: Array) -> tuple[Array, Array]:
        """Return observations, shape (..., size), and rewards, shape (...)."""
        metrics = [(weight, *REWARDS[name]) for name, weight in self.rewards.items()]
        names = {*_OBSERVED, *(quantity for _, quantity, _ in metrics)}
        samples = computed(QUANTITIES, dict(observed.samples), shares, names)
        R_PW = np.swapaxes(observed.samples["payload_pose"][..., None, :3, :3], -1, -2)
        error = np.nan_to_num(samples["internal_wrench"] - samples["desired_internal_wrench"])
        lead = error.shape[:-2]
        turned = rotate_vector6(R_PW, error).reshape(*lead, -1)
        parts = (observed.q, observed.v, samples["pose_error"], observed.twist_error, turned)
        observation = np.concatenate(parts, axis=-1)
        reward = -sum((w * metric(samples[quantity]) for w, quantity, metric in metrics), np.zeros(lead))
        return observation, reward
