"""Commands without a run: ``list``, ``check-urdf``, ``fields``, ``show``, ``suggest``, ``new``."""

from __future__ import annotations

import hashlib
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from coop_pin.base.disk_cache import keep, kept, package_digest
from coop_pin.base.errors import FieldError, NameNotFoundError
from coop_pin.cli.exit_codes import FAILED, OK
from coop_pin.cli.overrides import (
    ANY_CODE,
    NO_FIELDS,
    Code,
    ScenarioName,
    TypedFields,
    load_scenario,
    refuse_fields,
)
from coop_pin.description.catalogue import scenario_file, scenario_names, scenario_tables

_COLUMNS = 99
"""Longest line of a text."""

_Folders = Annotated[tuple[str, ...], tyro.conf.arg(metavar="FOLDER...")]
_Assignments = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE...")]


def print_wrapped(*texts: object, sep: str = " ") -> None:
    """Print texts with long lines wrapped at spaces, further indented; commands to copy stay whole words."""
    for line in sep.join(map(str, texts)).splitlines():
        indent = " " * (len(line) - len(line.lstrip()) + 4)
        parts = textwrap.wrap(
            line, _COLUMNS, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        )
        print(*(parts or [""]), sep="\n")


def list_all(robots: bool = False) -> None:
    """List the scenarios that come with coop_pin, or the robots that an arm can name.

    Args:
        robots: list the robots of coop_pin and of example-robot-data, with their files.
    """
    if robots:
        from coop_pin.description.urdf import robot_files  # slow to load

        for name, file in sorted(robot_files().items()):
            print(f"{name:<28} {file}")
        return
    for scenario in scenario_tables():
        size = f"{len(scenario['cell']['arms'])} arms  {scenario['duration']:g} s"
        print_wrapped(f"{scenario['name']:<20} {size}  {scenario['summary']}")


def fields_of(scenario: ScenarioName) -> None:
    """List the fields of a scenario with values and meanings; 'coop-pin run' takes each of them as an option.

    Args:
        scenario: a name listed by 'coop-pin list', or a TOML file.
    """
    is_known = scenario in scenario_names()
    content = scenario_file(scenario).read_bytes() if is_known else b""
    key = hashlib.sha256(f"fields {package_digest()}\n".encode() + content).digest()
    if (text := kept(key) if is_known else None) is None:
        from coop_pin.cli.field_list import field_list
        from coop_pin.description.scenario import Scenario  # slow to load

        text = "\n".join(field_list(Scenario.load(scenario))).encode()
        if is_known:
            keep(key, text)
    print(text.decode())


def show(
    what: ScenarioName,
    package_dirs: _Folders = (),
    xacro_args: _Assignments = (),
    fields: TypedFields = NO_FIELDS,
) -> None:
    """Show the cell of a scenario as a tree, or the links, joints, limits and possible tips of a robot.

    Every field of a scenario can be changed as in 'coop-pin run'.

    Args:
        what: a scenario (a name listed by 'coop-pin list', or a TOML file), or a robot (a name listed by
            'coop-pin list --robots', or a URDF or xacro file).
        package_dirs: folders that are searched first for the packages of a robot.
        xacro_args: arguments of a xacro file.
        fields: fields of the scenario, as typed.

    Raises:
        NameNotFoundError: there is no such scenario or robot.
        FieldError: a field is given for a robot, or an option of robots for a scenario.
    """
    from coop_pin.description.urdf import load_checked, robot_files
    from coop_pin.description.urdf.robot import Robot
    from coop_pin.feasibility.cell_summary import cell_summary

    path, robots, scenarios = Path(what), robot_files(), scenario_names()
    if what in scenarios or path.suffix == ".toml":
        for option, words in {"package_dirs": package_dirs, "xacro_args": xacro_args}.items():
            if words:
                message = f"is an option for robots only; give it to each arm: cell.arms.NAME.{option}"
                raise FieldError(message, f"--{option.replace('_', '-')}")
        scenario = load_scenario(what, fields)
        print_wrapped(cell_summary(scenario.cell, scenario.start.matrix).summary())
        return
    if not path.is_file() and path.suffix not in (".urdf", ".xacro") and what not in robots:
        names = [*scenarios, *robots]
        raise NameNotFoundError("scenario or robot", what, names, "the catalogue or the file system")
    refuse_fields(fields, what)
    file = _urdf_file(what, package_dirs, xacro_args)
    print_wrapped(f"{file.path}\n{Robot(load_checked(file, parts=False)).summary()}")


def suggest(
    scenario: ScenarioName,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    poses: int = 101,
    table_error: float = 2e-3,
    code: Code = ANY_CODE,
    fields: TypedFields = NO_FIELDS,
) -> None:
    """Propose control rate, gains of the payload-space law, postures and squeeze, and say what limits each.

    Nothing is simulated. Where the cell cannot do the motion, the cause is named: rank, reach, singularity,
    limits or torque. Every field of the scenario can be changed as in 'coop-pin run'.

    Args:
        scenario: a name listed by 'coop-pin list', or a TOML file; the gains of its controller are not used,
            and may be missing.
        out: file to write the proposed scenario to, ready for 'coop-pin run'; none when omitted.
        poses: number of poses looked at along the motion.
        table_error: height by which a table on which the payload is put down may be higher than planned, m.
        code: code that the scenario may name.
        fields: fields of the scenario, as typed.

    Raises:
        InfeasibleMotionError: the cell cannot do the motion.
    """
    from coop_pin.design import suggestion

    draft = load_scenario(scenario, fields, code, draft=True)
    suggested = suggestion.suggest(draft, poses=poses, table_error=table_error)
    findings = suggested.findings(table_error=table_error).of("error", "warning")
    print_wrapped(suggested.summary(), findings.summary(), sep="\n")
    if out is not None:
        suggested.scenario.save(out)


def new(
    scenario: ScenarioName,
    arms: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ROBOT...")],
    payload: Literal["box", "bar", "plate"] = "box",
    mass: float = 2.0,
    size: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")] = None,
    grasp: Literal["sides", "above"] = "sides",
    layout: Literal["facing", "side-by-side"] = "facing",
    tips: Annotated[tuple[str, ...], tyro.conf.arg(metavar="LINK...")] = (),
    distance: float | None = None,
) -> None:
    """Write the scenario of a new cell, ready to run: arms placed around a payload, grasps, motion, gains.

    The file says what each table and field is; what it leaves out has its default. Nothing is simulated, and
    collisions are not considered.

    Args:
        scenario: name of the scenario, or the file to write, which must not exist: NAME.toml.
        arms: two or more robots, or one with two arms: names listed by 'coop-pin list --robots', URDF or
            xacro files.
        payload: kind of the payload.
        mass: mass of the payload, kg.
        size: edges of the payload along x, y and z, m; those of its kind when omitted.
        grasp: side from which the tools approach the payload.
        layout: bases all around the payload, or on one side of it.
        tips: tip of each arm; the link that is named like a tool when omitted.
        distance: distance of the bases from the payload's centre, m; by the arms' reach when omitted.

    Raises:
        FieldError: the file exists, or an option is not among the allowed ones.
        UrdfError: there is no such robot or tip.
        InfeasibleMotionError: the arms cannot carry the payload.
    """
    from coop_pin.design.new_cell import new_cell

    path = Path(scenario)
    if not path.name:
        raise FieldError(f"is {str(path)!r}, which names no file", "NAME_OR_FILE")
    path = path if path.suffix == ".toml" else path.with_name(f"{path.name}.toml")
    if path.exists():
        raise FieldError(f"{path} exists; name another file, or remove it", "NAME_OR_FILE")
    suggested = new_cell(
        arms,
        name=path.stem,
        payload=payload,
        mass=mass,
        size=size,
        grasp=grasp,
        layout=layout,
        tips=tips,
        distance=distance,
        progress=_print_stage if sys.stderr.isatty() else None,
    )
    suggested.scenario.save(path, commented=True)
    print_wrapped(suggested.summary())
    print_wrapped(f"{path}: edit it; then coop-pin check {path}, coop-pin run {path} --report")


def _print_stage(stage: str) -> None:
    """Print the stage of a command on the standard error."""
    print(f"coop-pin: {stage} ...", file=sys.stderr)


def check_urdf(
    urdf: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")],
    strict: bool = False,
    package_dirs: _Folders = (),
    xacro_args: _Assignments = (),
) -> int:
    """Check structure, inertias, units and mesh paths of a URDF before loading it.

    Args:
        urdf: a URDF or xacro file, or the name of a bundled ("adept_3dof") or example-robot-data arm
            ("panda").
        strict: physically impossible masses and inertias are errors, not warnings.
        package_dirs: folders that are searched first for its packages.
        xacro_args: arguments of a xacro file.
    """
    from coop_pin.description.urdf import check_file

    report = check_file(_urdf_file(urdf, package_dirs, xacro_args))
    print_wrapped(report.summary(strict=strict))
    return FAILED if report.errors(strict=strict) else OK


def _urdf_file(urdf: str, package_dirs: Sequence[str], xacro_args: Sequence[str]) -> Any:
    """Return the URDF with a name or path; arguments of a xacro are written NAME=VALUE or NAME:=VALUE.

    Raises:
        UrdfError: there is none.
        FieldError: an argument is not of this form.
    """
    from coop_pin.description.urdf import find_urdf

    values = {}
    for word in xacro_args:
        name, equals, value = word.replace(":=", "=", 1).partition("=")
        if not (name and equals):
            raise FieldError(f"is {word!r}; it must be NAME=VALUE", "--xacro-args")
        values[name] = value
    return find_urdf(urdf, package_dirs=package_dirs, xacro_args=values)
