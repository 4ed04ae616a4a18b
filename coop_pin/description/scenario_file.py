"""TOML file of a scenario: its relative paths, and its text, whole or without what is at its default."""

from __future__ import annotations

import inspect
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import BaseModel

from coop_pin.base.arrays import require_type
from coop_pin.base.errors import NameNotFoundError, ScenarioWarning
from coop_pin.base.schema.changes import stated
from coop_pin.base.schema.meanings import kinds, meanings
from coop_pin.base.schema.parts import fields_of
from coop_pin.base.schema.pose import POSE_MEANINGS, Pose
from coop_pin.base.user_files import parse_toml, read_toml
from coop_pin.description.catalogue import scenario_file, scenario_names
from coop_pin.description.cell.differential_base import DifferentialBase
from coop_pin.description.cell.payload import Payload

# tomli_w writes one number per line. No string can match: it writes those on one line.
_NUMBERS_IN_LINES = re.compile(r"\[\n((?: *[-+.\w]+,\n)+) *\]")
_HEADER, _ENTRY = re.compile(r"\[+([^\]]+)\]+$"), re.compile(r"(\w+) = ")
_DRAFTED = "payload-space"
"""Kind of a law whose gains are missing."""
_OF_BOX = "The inertia follows from mass and edges."


def scenario_table(name_or_path: str | Path) -> dict[str, Any]:
    """Return the table of a scenario of the catalogue or of a TOML file, its paths absolute.

    Raises:
        NameNotFoundError: there is no such name or file.
        FileReadError: the file is not TOML.
    """
    in_catalogue = str(name_or_path) in scenario_names()
    path = scenario_file(str(name_or_path)) if in_catalogue else Path(name_or_path)
    if not path.is_file():
        raise _missing(path)
    data = read_toml(path, kind="a scenario")
    anchor_files(data, path.parent)
    return data


def text_table(text: str) -> dict[str, Any]:
    """Return the table of a scenario's text.

    Raises:
        FileReadError: the text is not TOML.
    """
    return parse_toml(text.encode("utf-8", "surrogatepass"), "the text", kind="a scenario")


def _missing(path: Path) -> NameNotFoundError:
    """Return the error for a name or path without a scenario; TOML files in its folder are suggested."""
    folder = path if path.is_dir() else path.parent
    files = sorted(map(str, folder.glob("*.toml"))) if path.is_dir() or path.suffix == ".toml" else []
    return NameNotFoundError(
        "scenario", str(path), [*files, *scenario_names()], "the catalogue or the file system"
    )


def drafted(fields: dict[str, Any]) -> dict[str, Any]:
    """Fields of a scenario, with gains of 1 where the controller has none; see Scenario.draft."""
    stated = fields.get("controller", {})
    if not isinstance(stated, Mapping) or "gains" in stated or stated.get("kind") == "user":
        return fields
    if stated.get("kind", _DRAFTED) != _DRAFTED:
        text = f"the gains of {stated['kind']!r} are missing: the draft has the law {_DRAFTED!r} in its place"
        warnings.warn(text, ScenarioWarning, stacklevel=4)
    kept = {name: stated[name] for name in ("force_path", "zero_at_grasp") if name in stated}
    gains = dict.fromkeys(("pose_gain", "sliding_gain", "sign_gain", "transient_rate"), 1.0)
    return fields | {"controller": {"kind": _DRAFTED, "gains": gains, **kept}}


def anchor_files(data: dict[str, Any], folder: Path) -> None:
    """Make the paths of URDF, mesh and CSV files and of package folders in the scenario's folder absolute."""
    _change_files(data, lambda path: _anchored(folder, path))


def _change_files(data: dict[str, Any], changed: Callable[[Any], Any]) -> None:
    """Change the paths of URDF, mesh and CSV files and of package folders in a scenario's table."""
    cell = _table(data.get("cell"))
    arms = [_table(arm) for arm in _table(cell.get("arms")).values()]
    payload, motion = _table(cell.get("payload")), _table(data.get("motion"))
    paths = [(arm, "urdf") for arm in arms] + [(payload, "path"), (payload, "mesh_file"), (motion, "path")]
    for table, field in paths:
        if table.get(field):
            table[field] = changed(table[field])
    for table in (*arms, payload):
        if isinstance(table.get("package_dirs"), list):
            table["package_dirs"] = [changed(entry) for entry in table["package_dirs"]]


def _table(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _anchored(folder: Path, path: Any) -> Any:
    """Return a path that exists in a folder as absolute, any other as it is.

    A URDF that exists nowhere becomes absolute as well, so that the error names the intended folder.
    """
    if not isinstance(path, str):
        return path
    if (folder / path).exists():
        return str((folder / path).resolve())
    is_missing_robot = path.endswith((".urdf", ".xacro")) and not Path(path).exists()
    return str((folder / path).absolute()) if is_missing_robot else path


def _portable(path: Any, folder: Path) -> Any:
    """Return a path that exists as the way from a folder, if both have a folder in common; names stay."""
    is_name = isinstance(path, str) and len(Path(path).parts) == 1 and not Path(path).is_file()
    if not isinstance(path, str) or is_name or not Path(path).exists():
        return path
    file, start = Path(path).resolve(), folder.resolve()
    try:
        common = Path(os.path.commonpath((file, start)))
    except ValueError:  # on different drives
        return path
    if len(common.parts) < 2:  # the root alone: the file is elsewhere on every machine
        return str(file)
    return Path(os.path.relpath(file, start)).as_posix()


def toml_text(scenario: BaseModel, commented: bool, folder: Path | None = None) -> str:
    """Return a scenario as TOML: every field with its value, or those not at their defaults with comments.

    Args:
        scenario: Scenario.
        commented: Whether the second.
        folder: Folder from which paths are; as they are stated if omitted.
    """
    require_type("commented", commented, bool)
    return _commented(scenario, folder) if commented else _dumps(_dumped(scenario, folder))


def _dumped(scenario: BaseModel, folder: Path | None) -> dict[str, Any]:
    table = scenario.model_dump(mode="json")
    if folder is not None:
        _change_files(table, lambda path: _portable(path, folder))
    return table


def _commented(scenario: BaseModel, folder: Path | None) -> str:
    """Return the fields that are not at their defaults, with the meanings of tables and fields as comments.

    The meanings are those of the docstrings; a table also names the kinds there are and its other fields.
    Paths are from a folder if there is one.
    """
    text = _dumps(_stated(scenario, _dumped(scenario, folder)))
    comments, table, lines, written = dict(_comments(scenario, "", "", None)), "", list[str](), set[str]()
    for line in text.splitlines():
        if header := _HEADER.match(line):
            table = header[1].replace('"', "")
            lines += [f"# {comments[table]}"] if table in comments else []
        entry = _ENTRY.match(line)
        comment = comments.get(f"{table}.{entry[1]}".lstrip("."), "") if entry else ""
        lines.append(f"{line}  # {comment}" if comment and comment not in written else line)
        written.add(comment)
    return "\n".join((*lines, ""))


def _dumps(fields: dict[str, Any]) -> str:
    text = tomli_w.dumps(_without_none(fields))
    return _NUMBERS_IN_LINES.sub(
        lambda match: "[" + ", ".join(match[1].replace(",", " ").split()) + "]", text
    )


def _without_none(value: Any) -> Any:
    """Return a value without omitted optional fields: TOML has no null."""
    if isinstance(value, dict):
        return {key: _without_none(entry) for key, entry in value.items() if entry is not None}
    return [_without_none(entry) for entry in value] if isinstance(value, list) else value


def _stated(value: Any, dumped: Any) -> Any:
    """Return what is dumped of a value without fields at their defaults; a kind stays."""
    if _is_box(value):
        return {"kind": "box", "mass": dumped["mass"], "size": dumped["size"]}
    if isinstance(value, Pose) and any(value.rpy[:2]) and Pose(**value.by_axis()) == value:
        return value.by_axis()
    if isinstance(value, BaseModel) and isinstance(dumped, dict):
        fields, left_out = fields_of(value), _at_defaults(value)
        kept = {name: entry for name, entry in (fields | dumped).items() if name not in left_out}
        return {name: _stated(fields.get(name), entry) for name, entry in kept.items()}
    if isinstance(value, dict):
        return {name: _stated(value[name], entry) for name, entry in dumped.items()}
    return dumped


def _is_box(value: Any) -> bool:
    """Whether a value is a homogeneous box, which its mass and edges state."""
    return isinstance(value, Payload) and value == Payload.box(value.mass, value.size)


def _at_defaults(value: BaseModel) -> list[str]:
    """Return the names of the fields that are at their defaults."""
    kind = "drive" if isinstance(value, DifferentialBase) else "kind"
    return [name for name in fields_of(value) if name not in {kind, *stated(value)}]


def _comments(value: Any, path: str, meaning: str, annotation: Any) -> Iterator[tuple[str, str]]:
    """Yield the path and the comment of each table and field, in one line."""
    if isinstance(value, dict):
        for name, entry in value.items():
            has_own = isinstance(entry, BaseModel) and not isinstance(entry, Pose)  # these differ by field
            first = (inspect.getdoc(type(entry)) or "").split("\n\n")[0] if has_own else meaning
            yield from _comments(entry, f"{path}.{name}", first, annotation)
    elif isinstance(value, BaseModel):
        if path:
            yield path, " ".join(_of_table(value, meaning, annotation))
        if isinstance(value, Pose):
            texts = meanings(type(value)) | POSE_MEANINGS
            yield from ((f"{path}.{name}", _brief(text)) for name, text in texts.items())
            return
        texts = meanings(type(value))
        for name, entry in fields_of(value).items():
            below, field = f"{path}.{name}".lstrip("."), type(value).model_fields[name]
            yield from _comments(entry, below, texts.get(name, ""), field.annotation)
    elif meaning:
        yield path, _brief(meaning)


def _of_table(value: BaseModel, meaning: str, annotation: Any) -> Iterator[str]:
    brief = _brief(meaning)
    yield f"{brief[:1].upper()}{brief[1:]}."
    if _is_box(value):
        yield _OF_BOX
    elif (others := _at_defaults(value)) and not isinstance(value, Pose):
        yield f"Also: {', '.join(others)}."
    if names := kinds(annotation):
        yield f"Kinds: {', '.join(names)}."


def _brief(meaning: str) -> str:
    """Return a meaning up to its first semicolon or sentence."""
    return re.split(r";|\.(?= [A-Z]|$)", meaning.replace("``", ""), maxsplit=1)[0]
