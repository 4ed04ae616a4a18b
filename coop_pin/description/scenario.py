"""Scenario: everything that determines a run, as one value and one TOML file; the catalogue of scenarios."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import ValidationInfo, field_validator, model_validator

from coop_pin.base.arrays import require_path, require_type
from coop_pin.base.errors import FieldError, NameNotFoundError, one_or_all
from coop_pin.base.schema.base import (
    check_arm_names,
    unknown_arms,
)
from coop_pin.base.schema.changes import differences
from coop_pin.base.schema.parts import fields_of
from coop_pin.base.user_files import parse_toml, read_toml
from coop_pin.control import CellTiming
from coop_pin.control.laws.feed_forward import FeedForward
from coop_pin.description.catalogue import scenario_file, scenario_names, scenario_tables
from coop_pin.description.controller import Controller
from coop_pin.description.grasp_events import sequence_problems
from coop_pin.description.scenario_file import anchor_files, commented_toml, resolved_toml
from coop_pin.description.scenario_parts import ScenarioParts
from coop_pin.description.sensors import Sensors, WristSensor
from coop_pin.reference.squeeze import Squeeze

_MOST_CHANGES = 6
"""Most changes that a caption tells."""


class Scenario(ScenarioParts):
    """Everything that determines a run.

    The fields are those of ScenarioParts; here are their checks, and files.
    """

    # Each validator needs only the fields that it reads, so that a mistake in one hides none in another.

    @field_validator("start_angles")
    @classmethod
    def _angles_for_every_arm(
        cls, angles: dict[str, tuple[float, ...]], earlier: ValidationInfo
    ) -> dict[str, tuple[float, ...]]:
        if angles and "cell" in earlier.data:
            check_arm_names(angles, earlier.data["cell"].arms)
        return angles

    @field_validator("controller")
    @classmethod
    def _suits_the_cell(cls, controller: Controller, earlier: ValidationInfo) -> Controller:
        if "cell" in earlier.data and not earlier.data.get("beyond_bound"):
            cell = earlier.data["cell"]
            if problems := controller.problems(CellTiming(list(cell.arms), cell.task_rows.size)):
                raise one_or_all(problems, "the controller")
        return controller

    @field_validator("squeeze")
    @classmethod
    def _names_the_arms(cls, squeeze: Squeeze, earlier: ValidationInfo) -> Squeeze:
        if "cell" in earlier.data:
            squeeze.check_arms(earlier.data["cell"].grasps)
        return squeeze

    @field_validator("feed_forward")
    @classmethod
    def _in_the_order_of_arms(cls, added: FeedForward | None, earlier: ValidationInfo) -> FeedForward | None:
        return added if added is None or "cell" not in earlier.data else added.of(earlier.data["cell"].arms)

    @field_validator("events", "actuators", "arm_actuators", "sensors", "arm_sensors", "network")
    @classmethod
    def _fits_the_run(cls, value: Any, earlier: ValidationInfo) -> Any:
        name, problems, parts = str(earlier.field_name), list[FieldError](), _parts(value)
        run = {field: earlier.data[field] for field in _OF_THE_RUN if field in earlier.data}
        if isinstance(value, dict) and "cell" in run:
            problems += unknown_arms(value, run["cell"].arms)
        for path, part in parts.items():
            problems += [problem.below(path) for problem in part.timing_problems(run)]
        if name == "events" and "cell" in run and not problems:
            problems += sequence_problems(run["cell"], value)
        if problems:
            raise one_or_all(problems, f"the {name}")
        return value

    @model_validator(mode="after")
    def _law_commands_what_arms_take(self) -> Self:
        for arm in self.cell.arms if self.controller.command_kind else ():
            if problem := self.actuators_of(arm).command_problem(self.controller.command_kind):
                raise problem.below(self.actuators_path(arm))
        return self

    @model_validator(mode="after")
    def _each_arm_fails_once(self) -> Self:
        for index, event in enumerate(self.events):
            if problem := event.problem(self.model_copy(update={"events": self.events[:index]})):
                raise problem.below(f"events.{index}")
        return self

    @model_validator(mode="after")
    def _plant_fits_the_grasps(self) -> Self:
        if self.cell.has_force_elements and self.plant.integrator != "rk4":
            detail = f"is {self.plant.integrator!r}; compliant grasps, patches and tables need 'rk4', whose"
            detail += " stable step is known"
            raise FieldError(detail, "plant.integrator")
        rigid = [event.arm for event in self.grasp_events if event.arm not in self.cell.unclosed]
        if rigid and self.plant.payload != "free":
            detail = f"is {self.plant.payload!r}; the rigid grasp of {rigid[0]!r} opens or closes, and the"
            raise FieldError(f"{detail} payload must be 'free' for it: a weld does not open", "plant.payload")
        return self

    @model_validator(mode="after")
    def _force_path_fits_the_run(self) -> Self:
        path = self.controller.force_path
        for late in self.clock.late(path.delay, self.duration, "controller.force_path.delay"):
            raise late
        if path.measures and not path.by_sensors and (missing := self._missing_messages()):
            raise FieldError(f"is {path.kind!r}, but {missing}", "controller.force_path.kind")
        is_checked = (self.wrists or self.actuator_lag) and not self.beyond_bound
        if is_checked and (problems := self.controller.problems(self.timing)):
            raise one_or_all([problem.below("controller") for problem in problems], "the controller")
        return self

    def _missing_messages(self) -> str:
        """Return what is missing for internal wrenches by messages, or ""."""
        arms = list(self.cell.arms)
        if self.network is None:
            return "the scenario has no network; give it one"
        if without := [arm for arm in arms if self.sensors_of(arm).wrist is None]:
            return f"the arms {without} have no wrist sensor; give every arm one: sensors.wrist"
        edges = self.network.edges_at(0.0, arms)
        if self.controller.force_path.hears_all and len(edges) < len(arms) * (len(arms) - 1):
            return "some arms do not hear all others; network.graph must be 'all'"
        return ""

    @property
    def with_ideal_sensors(self) -> Self:
        """The scenario with sensors without errors, for analyses; gains may be beyond bounds."""
        path = self.controller.force_path
        by_messages = path.measures and not path.by_sensors
        sensors = Sensors(wrist=WristSensor() if by_messages else None)
        return self.replace(sensors=sensors, arm_sensors={}, beyond_bound=True)

    @property
    def caption(self) -> str:
        """The summary; of a scenario of the catalogue that was changed, what was changed, in its place."""
        base = _original(self.summary)
        if base is None or not (changed := list(differences(self, base))):
            return self.summary
        texts = (
            *changed[:_MOST_CHANGES],
            *[f"{len(changed) - _MOST_CHANGES} more"][: len(changed) > _MOST_CHANGES],
        )
        addition = self.summary.removeprefix(base.summary).removeprefix("; ")
        return "; ".join((*[addition][: bool(addition)], f"changed: {'; '.join(texts)}"))

    def differences(self, base: Self, path: tuple[str, ...]) -> Iterator[str]:
        """Yield what makes the run another one than that of a base."""
        if not self.events and base.events:
            yield "no events"
        elif self.events != base.events:
            texts = [f"{event.text(self.surroundings_at(0.0))} at {event.time:g} s" for event in self.events]
            yield f"events: {', '.join(texts)}"
        fields, others = fields_of(self), fields_of(base)
        for name in [name for name in fields if name not in ("name", "summary", "events")]:
            yield from differences(fields[name], others[name], (*path, name))

    @classmethod
    def load(
        cls, name_or_path: str | Path, overrides: Mapping[str, Any] | None = None, *, draft: bool = False
    ) -> Self:
        """Return a scenario of the catalogue or of a TOML file.

        Args:
            name_or_path: name in the catalogue ("adept-paper") or path of a file. Paths of URDF, mesh and CSV
                files in it are relative to its folder.
            overrides: fields to change, by dotted path.
            draft: whether gains may be missing, see ``draft``.

        Raises:
            NameNotFoundError: there is no such name or file.
            FileReadError: the file is not TOML.
            ScenarioError: the scenario has mistakes; all are reported at once.
        """
        require_path("name_or_path", name_or_path)
        in_catalogue = str(name_or_path) in scenario_names()
        path = scenario_file(str(name_or_path)) if in_catalogue else Path(name_or_path)
        if not path.is_file():
            raise _missing(path)
        data = read_toml(path, kind="a scenario")
        anchor_files(data, path.parent)
        scenario = cls.draft(**data) if draft else cls(**data)
        return scenario if overrides is None else scenario.override(overrides)

    @classmethod
    def draft(cls, **fields: Any) -> Self:
        """Return a scenario whose gains may be missing: ``cp.suggest`` proposes some.

        A controller without gains, or none, becomes the payload-space law with all gains 1 and the stated
        force path.

        Args:
            fields: fields of the scenario; tables, as in a TOML file, or values.

        Raises:
            ScenarioError: another field has mistakes.
        """
        stated = fields.get("controller", {})
        if isinstance(stated, Mapping) and "gains" not in stated and stated.get("kind") != "user":
            kept = {name: stated[name] for name in ("force_path", "zero_at_grasp") if name in stated}
            gains = dict.fromkeys(("pose_gain", "sliding_gain", "sign_gain", "transient_rate"), 1.0)
            fields["controller"] = {"kind": "payload-space", "gains": gains, **kept}
        return cls(**fields)

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """Return the scenario of a text as to_toml writes it.

        Raises:
            FileReadError: the text is not TOML.
            ScenarioError: the scenario has mistakes.
        """
        require_type("text", text, str)
        return cls(**parse_toml(text.encode("utf-8", "surrogatepass"), "the text", kind="a scenario"))

    def to_toml(self, *, commented: bool = False) -> str:
        """Return the scenario as TOML: every field with its value.

        Args:
            commented: leave out fields at their defaults, and write the meaning of each table and field
                beside it.
        """
        require_type("commented", commented, bool)
        return commented_toml(self) if commented else resolved_toml(self)

    def save(self, path: str | Path, *, commented: bool = False) -> None:
        """Write the scenario to a TOML file, as ``to_toml`` returns it."""
        require_path("path", path)
        Path(path).write_text(self.to_toml(commented=commented), encoding="utf-8")


_OF_THE_RUN = ("duration", "cell", "clock")
"""Fields against which others are checked."""


def _parts(value: Any) -> dict[str, Any]:
    """Return the values of a field by their path within it."""
    if value is None:
        return {}
    if isinstance(value, tuple):
        return {str(index): part for index, part in enumerate(value)}
    return value if isinstance(value, dict) else {"": value}


def _missing(path: Path) -> NameNotFoundError:
    """Return the error for a name or path without a scenario; TOML files in its folder are suggested."""
    folder = path if path.is_dir() else path.parent
    files = sorted(map(str, folder.glob("*.toml"))) if path.is_dir() or path.suffix == ".toml" else []
    return NameNotFoundError(
        "scenario", str(path), [*files, *scenario_names()], "the catalogue or the file system"
    )


@functools.lru_cache(maxsize=64)
def _original(summary: str) -> Scenario | None:
    """Return the scenario of the catalogue with whose summary a summary begins."""
    tables = zip(scenario_names(), scenario_tables(), strict=True)
    names = (name for name, table in tables if summary.startswith(table["summary"]))
    return next(map(Scenario.load, names), None)
