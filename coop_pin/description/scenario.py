"""A scenario: everything that determines a run, in one value and one TOML file."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
import tomli_w
from pydantic import Field, ValidationInfo, field_validator

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.description.controller import Controller, controller_problems
from coop_pin.description.events import Event, WrenchPulse
from coop_pin.description.plant import Clock, PlantOptions
from coop_pin.errors import EntryNotFoundError, EventTimeError, FieldError, ScenarioFileError, one_or_all
from coop_pin.reference.motions import Motion
from coop_pin.reference.squeeze import ConstantSqueeze, Squeeze
from coop_pin.schema.base import Description, Positive, Vector, check_arm_names
from coop_pin.schema.pose import Pose

_FOLDER = Path(__file__).parent / "scenarios"


def scenario_names() -> list[str]:
    """Return the names of the shipped scenarios."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def scenario_path(name: str) -> Path:
    """Return the file of a shipped scenario.

    Raises:
        EntryNotFoundError: there is none of that name.
    """
    path = _FOLDER / f"{name}.toml"
    if name not in scenario_names():
        raise EntryNotFoundError("scenario", name, scenario_names(), "the catalogue")
    return path


# tomli_w writes one number to a line. No string can match: it writes those on one line.
_NUMBERS_IN_LINES = re.compile(r"\[\n((?: *[-+.\w]+,\n)+) *\]")


class Scenario(Description):
    """Everything that determines a run.

    Attributes:
        name: short name.
        summary: one line for people.
        duration: s.
        seed: of everything random.
        beyond_bound: insist on gains outside what the theory or the sampling allows.
        cell: arms, payload, grasps.
        controller: the law and its gains.
        motion: desired motion of the payload.
        squeeze: desired internal wrench f_d of each arm about P in *payload* axes, N and N m: a table by arm,
            a ramp, or a function; zero when omitted.
        start: payload pose at t = 0, at rest.
        start_angles: joint angles of every arm at t = 0, in place of those that are found for ``start``; they
            must hold the payload there.
        project_start: move open starting angles onto the grasps instead of refusing them; the payload then
            stands where they meet.
        events: what happens to the payload.
        clock: control rate and plant steps.
        plant: how the plant is solved.
    """

    name: str
    summary: str = ""
    duration: Positive = 20.0
    seed: int = Field(default=0, ge=0)
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

    # Each check asks only for the fields that it needs, so that a mistake elsewhere hides none here.

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
            problems = controller_problems(controller, list(earlier.data["cell"].arms))
            if problems:
                raise one_or_all(problems, "the controller")
        return controller

    @field_validator("squeeze")
    @classmethod
    def _names_the_arms(cls, squeeze: Squeeze, earlier: ValidationInfo) -> Squeeze:
        if "cell" in earlier.data:
            squeeze.check_arms(earlier.data["cell"].arms)
        return squeeze

    @field_validator("events")
    @classmethod
    def _within_the_run(cls, events: tuple[Event, ...], earlier: ValidationInfo) -> tuple[Event, ...]:
        duration = earlier.data.get("duration", np.inf)
        late: list[FieldError] = []
        for index, event in enumerate(events):
            end = event.end if isinstance(event, WrenchPulse) else event.time
            if end > duration:
                late.append(
                    EventTimeError(
                        f"ends at t = {end:g} s; the run ends at {duration:g} s: lengthen it or move the event",
                        f"{index}.time",
                    )
                )
        if late:
            raise one_or_all(late, "the events")
        return events

    @property
    def squeeze_wrenches(self) -> Array:
        """f_d at t = 0 in payload axes in the order of the arms, shape (m, 6)."""
        return self.squeeze.at(0.0, self.cell.arms)

    @classmethod
    def load(cls, name_or_path: str | Path, overrides: Mapping[str, Any] | None = None) -> Self:
        """Read a scenario from the catalogue or from a TOML file.

        Args:
            name_or_path: name in the catalogue ("adept-paper") or path of a file. URDF paths in a file are
                relative to it.
            overrides: fields to change, by dotted path.

        Raises:
            EntryNotFoundError: no such name or file.
            ScenarioFileError: the file is not TOML.
            ScenarioError: the scenario has mistakes; all are reported at once.
        """
        path = Path(name_or_path)
        if str(name_or_path) in scenario_names():
            path = scenario_path(str(name_or_path))
        elif not path.is_file():
            raise _missing(path)
        try:
            data = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ScenarioFileError(f"{path} is not a TOML file, as a scenario is: {error}") from None
        _anchor_files(data, path.parent)
        return cls.from_dict(data, overrides)

    @classmethod
    def from_dict(cls, data: dict[str, Any], overrides: Mapping[str, Any] | None = None) -> Self:
        """Build a scenario from nested dictionaries, with some fields overridden by dotted path."""
        scenario = cls(**data)
        return scenario.override(overrides) if overrides else scenario

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """Read a scenario as written by to_toml.

        Raises:
            ScenarioFileError: the text is not TOML.
            ScenarioError: the scenario has mistakes.
        """
        try:
            data = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ScenarioFileError(f"the text is not TOML: {error}") from None
        return cls(**data)

    def to_toml(self) -> str:
        """Return the scenario as resolved: every field with its value."""
        text = tomli_w.dumps(_without_none(self.model_dump(mode="json")))
        return _NUMBERS_IN_LINES.sub(
            lambda found: "[" + ", ".join(found[1].replace(",", " ").split()) + "]", text
        )

    def save(self, path: str | Path) -> None:
        """Write the scenario as resolved."""
        Path(path).write_text(self.to_toml(), encoding="utf-8")


def _missing(path: Path) -> EntryNotFoundError:
    """Return the error of a name or path that leads to no scenario; TOML files where it leads are suggested."""
    beside = path if path.is_dir() else path.parent
    files = sorted(map(str, beside.glob("*.toml"))) if path.is_dir() or path.suffix == ".toml" else []
    return EntryNotFoundError(
        "scenario", str(path), [*files, *scenario_names()], "the catalogue or the file system"
    )


def _anchor_files(data: dict[str, Any], folder: Path) -> None:
    """Make paths of URDF, mesh and CSV files and of package folders that exist beside the scenario's file absolute.

    A URDF that exists nowhere is taken for one beside the file as well: the error then names the folder that
    was meant.
    """
    cell = data["cell"] if isinstance(data.get("cell"), dict) else {}
    arms = cell.get("arms", {})
    for arm in arms.values() if isinstance(arms, dict) else ():
        _anchor(arm, "urdf", folder)
        if (
            isinstance(arm, dict)
            and isinstance(arm.get("urdf"), str)
            and _is_missing_robot(Path(arm["urdf"]))
        ):
            arm["urdf"] = str((folder / arm["urdf"]).absolute())
        if isinstance(arm, dict) and isinstance(arm.get("package_dirs"), list):
            arm["package_dirs"] = [_beside(folder, entry) for entry in arm["package_dirs"]]
    for field in ("path", "mesh_file"):
        _anchor(cell.get("payload"), field, folder)
    _anchor(data.get("motion"), "path", folder)


def _is_missing_robot(path: Path) -> bool:
    return path.suffix in (".urdf", ".xacro") and not path.exists()


def _anchor(table: Any, field: str, folder: Path) -> None:
    if isinstance(table, dict) and isinstance(table.get(field), str) and table[field]:
        table[field] = _beside(folder, table[field])


def _beside(folder: Path, path: Any) -> Any:
    return str((folder / path).resolve()) if isinstance(path, str) and (folder / path).exists() else path


def _without_none(value: Any) -> Any:
    """Drop absent optional fields: TOML has no null."""
    if isinstance(value, dict):
        return {key: _without_none(entry) for key, entry in value.items() if entry is not None}
    return [_without_none(entry) for entry in value] if isinstance(value, list) else value
