"""Commands without a run: ``list``, ``check-urdf``, ``fields``, ``show``, ``suggest``, ``new``."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
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
from coop_pin.cli.terminal import Working, print_wrapped
from coop_pin.description.catalogue import scenario_file, scenario_names, scenario_tables

_Folders = Annotated[tuple[str, ...], tyro.conf.arg(metavar="FOLDER...")]
_Assignments = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE...")]


def list_all(robots: bool = False) -> None:
    """List the scenarios that come with coop_pin, or the robots that an arm can name.

    Args:
        robots: list the robots of coop_pin and of example-robot-data, with joints and tips of their arms.
    """
    if robots:
        print_wrapped(_robot_list())
        return
    for scenario in scenario_tables():
        size = f"{len(scenario['cell']['arms'])} arms  {scenario['duration']:g} s"
        print_wrapped(f"{scenario['name']:<20} {size}  {scenario['summary']}")


def _robot_list() -> str:
    """Return one line for each robot with one arm or two, and the names of the others; kept on disk."""
    from coop_pin.description.urdf import robot_files  # slow to load

    files = robot_files()
    stamp = "\n".join(f"{name} {path} {path.stat().st_mtime_ns}" for name, path in sorted(files.items()))
    key = hashlib.sha256(f"robots {package_digest()}\n{stamp}".encode()).digest()
    if (text := kept(key)) is None:
        with Working("reading the robots, once") as working:
            text = "\n".join(_robot_lines(sorted(files), working)).encode()
        keep(key, text)
    return text.decode()


def _robot_lines(names: Sequence[str], working: Working) -> Iterator[str]:
    from coop_pin.base.errors import UrdfError
    from coop_pin.description.urdf import find_urdf, load_checked
    from coop_pin.description.urdf.robot import Robot

    others = []
    for name in names:
        working.tell(f"reading the robots, once: {name}")
        try:
            robot = Robot(load_checked(find_urdf(name), parts=False))
        except UrdfError:
            others.append(name)
            continue
        tips = robot.tools()
        joints = [len(robot.movers(tip)) for tip in tips]
        if any("foot" in tip.lower() for tip in tips) or len(tips) > 2 or min(joints) < 2 + len(tips):
            others.append(name)
        elif len(tips) == 1:
            yield f"{name:<28} {joints[0]} joints, tip {tips[0]}"
        else:
            yield f"{name:<28} two arms of {' and '.join(map(str, joints))} joints, tips {', '.join(tips)}"
    if others:
        yield f"without an arm, or with many tips ('coop-pin show NAME' lists them): {', '.join(others)}"


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
        with Working("closing the cell"):
            text = cell_summary(scenario.cell, scenario.start.matrix).summary()
        print_wrapped(text)
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
    limits or torque. A motion that asks for more than the task allows is slowed. Every field of the scenario
    can be changed as in 'coop-pin run'.

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
    with Working("looking for rate, gains, postures and squeeze") as working:
        suggested = suggestion.suggest(draft, poses=poses, table_error=table_error)
        working.tell("checking the proposal")
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
    grasp: Literal["sides", "ahead", "above"] | None = None,
    layout: Literal["facing", "side-by-side"] = "facing",
    tips: Annotated[tuple[str, ...], tyro.conf.arg(metavar="LINK...")] = (),
    distance: float | None = None,
    motion: Literal["line", "circle", "hold"] = "line",
    squeeze: float = 10.0,
    clearance: float = 0.01,
    package_dirs: _Folders = (),
    xacro_args: _Assignments = (),
    srdf: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    locked: Annotated[tuple[str, ...], tyro.conf.arg(metavar="JOINT=ANGLE...")] = (),
    impossible_inertia: Literal["refuse", "repair"] = "refuse",
) -> None:
    """Write the scenario of a new cell, ready to run: arms placed around a payload, grasps, motion, gains.

    The file says what each table and field is; what it leaves out has its default. Nothing is simulated;
    'coop-pin check' then tells the least distance between bodies.

    Args:
        scenario: name of the scenario, or the file to write, which must not exist: NAME.toml.
        arms: two or more robots, or one with two arms: names listed by 'coop-pin list --robots', URDF or
            xacro files.
        payload: kind of the payload.
        mass: mass of the payload, kg.
        size: edges of the payload along x, y and z, m; those of its kind when omitted.
        grasp: side from which the tools approach the payload; when omitted the first with a workspace.
        layout: bases all around the payload, or on one side of it.
        tips: tip of each arm; the link that is named like a tool when omitted.
        distance: distance of the bases from the payload's centre, m; by the arms' reach when omitted.
        motion: motion of the payload: along a line, on a level circle, or none.
        squeeze: force of each arm towards the others, N.
        clearance: distance that bodies which may not touch keep where they can, m; the cell states it.
        package_dirs: folders that are searched first for the packages of the robots.
        xacro_args: arguments of xacro files, and environment variables that they ask for.
        srdf: SRDF file of one robot, whose groups name tips and whose states name postures.
        locked: joints that do not move, besides those that move no tip, and their angles, rad or m.
        impossible_inertia: inertias that no body has: refused, or repaired with a warning.

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
    with Working("reading the robots") as working:
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
            motion=motion,
            squeeze=squeeze,
            clearance=clearance,
            package_dirs=package_dirs,
            xacro_args=_assignments(xacro_args),
            srdf=srdf,
            locked=_angles(locked),
            impossible_inertia=impossible_inertia,
            progress=working.tell,
        )
    suggested.scenario.save(path, commented=True)
    print_wrapped(suggested.summary())
    print_wrapped(f"{path}: edit it; then coop-pin check {path}, coop-pin run {path} --report")


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
    """Return the URDF with a name or path; raises UrdfError where there is none."""
    from coop_pin.description.urdf import find_urdf

    return find_urdf(urdf, package_dirs=package_dirs, xacro_args=_assignments(xacro_args))


def _assignments(words: Sequence[str], option: str = "--xacro-args") -> dict[str, str]:
    """Return values by name, written NAME=VALUE or NAME:=VALUE; raises FieldError for another form."""
    values = {}
    for word in words:
        name, equals, value = word.replace(":=", "=", 1).partition("=")
        if not (name and equals):
            raise FieldError(f"is {word!r}; it must be NAME=VALUE", option)
        values[name] = value
    return values


def _angles(words: Sequence[str]) -> dict[str, float]:
    """Return angles of joints, rad or m, written JOINT=ANGLE; raises FieldError for another form."""
    values = _assignments(words, "--locked")
    try:
        return {joint: float(angle) for joint, angle in values.items()}
    except ValueError as error:
        raise FieldError(f"has an angle that is no number: {error}", "--locked") from None
