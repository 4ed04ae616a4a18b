"""Scenario: everything that determines a run, as one value and one TOML file; the catalogue of scenarios."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from coop_pin.base.arrays import Array, require_path, require_type
from coop_pin.base.errors import one_or_all
from coop_pin.base.schema.base import Description, Name, Positive, Text, Vector
from coop_pin.base.schema.changes import changed_caption, differences
from coop_pin.base.schema.delay import in_ticks
from coop_pin.base.schema.parts import fields_of
from coop_pin.base.schema.pose import Pose
from coop_pin.control import CellTiming
from coop_pin.control.bounds import SampledWrist
from coop_pin.control.laws.feed_forward import FeedForward
from coop_pin.description import scenario_checks, scenario_file
from coop_pin.description.actuators import Actuators
from coop_pin.description.catalogue import name_by_summary
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.grasp_plan import GraspPlan, grasp_plan
from coop_pin.description.controller import Controller
from coop_pin.description.events import Partner, Surroundings, event_differences, of_kind, surroundings_at
from coop_pin.description.grasp_events import Event, GraspEvent, PutDown
from coop_pin.description.log_table import LogTable
from coop_pin.description.network import ArmClock, Network
from coop_pin.description.plant import Clock, PlantOptions
from coop_pin.description.sensors import Sensors, WristSensor
from coop_pin.description.thresholds import TaskLimits, TrustThresholds
from coop_pin.reference.motions import Motion
from coop_pin.reference.pose_reference import PoseReference
from coop_pin.reference.squeeze import ConstantSqueeze, Squeeze


class Scenario(Description):
    """Everything that determines a run.

    Attributes:
        name: 1 to 100 characters without slashes, colons and control characters, and no dot in front;
            ``coop-pin run`` writes into out/ and this name.
        summary: description in one line.
        duration: simulated time, s.
        beyond_bound: accept gains outside the bounds of the theory or of the sampling.
        cell: arms, payload, grasps.
        controller: control law and gains, or a user's own controller.
        motion: desired motion of the payload.
        squeeze: desired internal wrench f_d of each arm about P, *payload* axes, N and N m; zero if omitted.
        start: payload pose at t = 0, at rest.
        start_angles: joint angles of every arm at t = 0, instead of the inverse kinematics of ``start``; they
            must close the chain at ``start``.
        project_start: project open ``start_angles`` onto the closed chain; the payload starts there.
        events: changes of the payload, wrenches on it, failures of arms, and openings and closings of grasps.
        clock: control rate and integration steps.
        plant: formulation and integration of the plant.
        actuators: actuators of every arm: what its drives make of their commands.
        arm_actuators: actuators of single arms, in place of ``actuators``.
        trust: thresholds beyond which the simulation is not sound.
        task: limits within which the run keeps its task.
        sensors: sensors of every arm.
        arm_sensors: sensors of single arms, in place of ``sensors``.
        seed: seed of the random sources; every source draws from a generator of its own.
        network: messages between the arms; without one, none cross.
        feed_forward: torques that are added to those of the law.
        log: topics of a log of the real cell, for ``coop-pin blame``; a run does not read it.
    """

    name: Name
    summary: Text = ""
    duration: Positive = Field(default=20.0, le=1e8)
    beyond_bound: bool = False
    cell: Cell
    controller: Controller
    motion: Motion
    squeeze: Squeeze = ConstantSqueeze()
    start: Pose
    start_angles: dict[str, Vector] = Field(default_factory=dict)
    project_start: bool = False
    events: tuple[Event, ...] = ()
    clock: Clock = Clock()
    plant: PlantOptions = PlantOptions()
    actuators: Actuators = Actuators()
    arm_actuators: dict[str, Actuators] = Field(default_factory=dict)
    trust: TrustThresholds = TrustThresholds()
    task: TaskLimits = TaskLimits()
    sensors: Sensors = Sensors()
    arm_sensors: dict[str, Sensors] = Field(default_factory=dict)
    seed: int = Field(default=0, ge=0, lt=2**63)
    network: Network | None = None
    feed_forward: FeedForward | None = None
    log: LogTable | None = None

    # Each validator needs only the fields that it reads, so that a mistake in one hides none in another.

    @field_validator("controller")
    @classmethod
    def _suits_the_cell(cls, controller: Controller, earlier: ValidationInfo) -> Controller:
        if problems := scenario_checks.controller_problems(controller, earlier.data):
            raise one_or_all(problems, "the controller")
        return controller

    @field_validator("start_angles", "squeeze", "log")
    @classmethod
    def _names_the_arms(cls, value: Any, earlier: ValidationInfo) -> Any:
        if value and "cell" in earlier.data:
            scenario_checks.check_arms(value, earlier.data["cell"])
        return value

    @field_validator("feed_forward")
    @classmethod
    def _in_the_order_of_arms(cls, added: FeedForward | None, earlier: ValidationInfo) -> FeedForward | None:
        return added if added is None or "cell" not in earlier.data else added.of(earlier.data["cell"].arms)

    @field_validator("events", "actuators", "arm_actuators", "sensors", "arm_sensors", "network")
    @classmethod
    def _fits_the_run(cls, value: Any, earlier: ValidationInfo) -> Any:
        value = in_ticks(value, earlier.data["clock"].rate_hz) if "clock" in earlier.data else value
        if problems := scenario_checks.part_problems(str(earlier.field_name), value, earlier.data):
            raise one_or_all(problems, f"the {earlier.field_name}")
        return value

    def actuators_of(self, arm: str) -> Actuators:
        """Return the actuators of one arm, with its failure."""
        actuators = self.arm_actuators.get(arm, self.actuators)
        for event in self.events:
            actuators = event.actuated(arm, actuators)
        return actuators

    def actuators_path(self, arm: str) -> str:
        """Return the path of the actuators of one arm."""
        return f"arm_actuators.{arm}" if arm in self.arm_actuators else "actuators"

    @property
    def has_servos(self) -> bool:
        """Whether an arm takes velocities or positions."""
        return any(self.actuators_of(arm).servo is not None for arm in self.cell.arms)

    @model_validator(mode="after")
    def _parts_fit_each_other(self) -> Self:
        vars(self)["controller"] = in_ticks(self.controller, self.clock.rate_hz)
        for arm in self.cell.arms if self.controller.command_kind else ():
            if problem := self.actuators_of(arm).command_problem(self.controller.command_kind):
                raise problem.below(self.actuators_path(arm))
        for index, event in enumerate(self.events):
            if problem := event.problem(self.model_copy(update={"events": self.events[:index]})):
                raise problem.below(f"events.{index}")
        scenario_checks.check_plant(self.cell, self.plant, self.grasp_events)
        path, wrists = self.controller.force_path, self._wrist_sensors
        scenario_checks.check_force_path(path, self.clock, self.duration, wrists, self.network)
        is_checked = (self.wrists or self.actuator_lag) and not self.beyond_bound
        if is_checked and (problems := self.controller.problems(self.timing)):
            raise one_or_all([problem.below("controller") for problem in problems], "the controller")
        return self

    @property
    def _wrist_sensors(self) -> dict[str, WristSensor | None]:
        return {arm: self.sensors_of(arm).wrist for arm in self.cell.arms}

    @property
    def wrists(self) -> list[SampledWrist]:
        """Delay and sampling of the wrist sensors that the arms have, in ticks, with that of messages."""
        network = self.network if self.controller.force_path.hears_all else None
        return scenario_checks.sampled_wrists(self._wrist_sensors, self.clock, network)

    @property
    def oldest_wrench(self) -> int:
        """Age of the oldest wrench that a law is given, ticks."""
        sampled = (wrist.delay + wrist.every - 1 for wrist in self.wrists)
        return self.controller.force_path.delay + max(sampled, default=0)

    @property
    def timing(self) -> CellTiming:
        """Arms, wrists and drives, against which the controller is checked."""
        rows, period = self.cell.task_rows.size, self.clock.period
        return CellTiming(list(self.cell.arms), rows, period, self.wrists, self.actuator_lag)

    @property
    def actuator_lag(self) -> float:
        """Largest lag of the arms' drives, ticks."""
        return max(self.actuators_of(arm).lag for arm in self.cell.arms) / self.clock.period

    def sensors_of(self, arm: str) -> Sensors:
        """Return the sensors of one arm."""
        return self.arm_sensors.get(arm, self.sensors)

    @property
    def with_ideal_sensors(self) -> Self:
        """The scenario with sensors without errors, for analyses; gains may be beyond bounds."""
        wrist = WristSensor() if scenario_checks.needs_messages(self.controller.force_path) else None
        return self.replace(sensors=Sensors(wrist=wrist), arm_sensors={}, beyond_bound=True)

    @property
    def clocks(self) -> dict[int, ArmClock]:
        """Clocks that are not exact, by the arm's number."""
        return {} if self.network is None else self.network.clocks_by_number(self.cell.arms)

    def surroundings_at(self, time: float) -> Surroundings:
        """Return the payload, and what acts on it from outside, from a time on, s."""
        return surroundings_at(self.cell.surroundings, self.events, time)

    @property
    def grasp_events(self) -> tuple[GraspEvent, ...]:
        """Events at grasps."""
        return of_kind(self.events, GraspEvent)

    @property
    def put_downs(self) -> tuple[PutDown, ...]:
        """Events that hand the load to a table."""
        return of_kind(self.events, PutDown)

    @property
    def partners(self) -> tuple[Partner, ...]:
        """Persons or machines at handles."""
        return of_kind(self.events, Partner)

    def grasp_plan_at(self, time: float, missed: Sequence[GraspEvent] = ()) -> GraspPlan:
        """Return the plan of the grasps from a time on, s, without the events that did not happen."""
        return grasp_plan(self.cell, self.events, time, missed, self.controller.force_path.split)

    @property
    def has_grasp_plan(self) -> bool:
        """Whether grasps open or close, or a table takes the load."""
        return bool(self.grasp_events or self.put_downs)

    @property
    def payload_motion(self) -> PoseReference:
        """The motion, of the cell's payload; tables are read again."""
        return self.motion.on(self.cell)

    @property
    def squeeze_wrenches(self) -> Array:
        """f_d at t = 0 in payload axes in the order of the arms, shape (m, 6)."""
        return self.squeeze.at(0.0, self.cell.grasps)

    @property
    def caption(self) -> str:
        """The summary; of a scenario of the catalogue that was changed, what was changed, in its place."""
        base = _original(self.summary)
        if base is None or not (changed := list(differences(self, base))):
            return self.summary
        return changed_caption(self.summary, base.summary, changed)

    def differences(self, base: Self, path: tuple[str, ...]) -> Iterator[str]:
        """Yield what makes the run another one than that of a base."""
        yield from event_differences(self.events, base.events, self.surroundings_at(0.0))
        fields, others = fields_of(self), fields_of(base)
        for name in [name for name in fields if name not in ("name", "summary", "events")]:
            yield from differences(fields[name], others[name], (*path, name))

    @classmethod
    def load(
        cls, name_or_path: str | Path, overrides: Mapping[str, Any] | None = None, *, draft: bool = False
    ) -> Self:
        """Return a scenario of the catalogue or of a TOML file.

        Args:
            name_or_path: name in the catalogue ("adept-paper") or path of a file, with paths from its folder.
            overrides: fields to change, by dotted path.
            draft: whether gains may be missing, see ``draft``.

        Raises:
            NameNotFoundError: there is no such name or file.
            FileReadError: the file is not TOML; ScenarioError: the scenario has mistakes, all of them.
        """
        require_path("name_or_path", name_or_path)
        data = scenario_file.scenario_table(name_or_path)
        scenario = cls.draft(**data) if draft else cls(**data)
        return scenario if overrides is None else scenario.override(overrides)

    @classmethod
    def draft(cls, **fields: Any) -> Self:
        """Return a scenario whose gains may be missing: ``cp.suggest`` proposes some.

        Without gains, the controller becomes the payload-space law with gains of 1 and the stated force path.

        Args:
            fields: fields of the scenario; tables, as in a TOML file, or values.

        Raises:
            ScenarioError: another field has mistakes.
        """
        return cls(**scenario_file.drafted(fields))

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """Return the scenario of a text as to_toml writes it.

        Raises:
            FileReadError: the text is not TOML; ScenarioError: the scenario has mistakes.
        """
        require_type("text", text, str)
        return cls(**scenario_file.text_table(text))

    def to_toml(self, *, commented: bool = False) -> str:
        """Return the scenario as TOML: every field with its value.

        Args:
            commented: leave out fields at their defaults, and comment each table and field with its meaning.
        """
        return scenario_file.toml_text(self, commented)

    def save(self, path: str | Path, *, commented: bool = False) -> None:
        """Write the scenario to a TOML file, as ``to_toml`` returns it, with paths from the file's folder."""
        require_path("path", path)
        Path(path).write_text(scenario_file.toml_text(self, commented, Path(path).parent), encoding="utf-8")


@functools.lru_cache(maxsize=64)
def _original(summary: str) -> Scenario | None:
    """Return the scenario of the catalogue with whose summary a summary begins."""
    return Scenario.load(name) if (name := name_by_summary(summary)) else None
