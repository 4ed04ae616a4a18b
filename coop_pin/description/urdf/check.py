"""The check that stands between a URDF and Pinocchio."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from coop_pin.description.urdf.find import UrdfFile
from coop_pin.description.urdf.inertia import inertial_findings, massless_findings
from coop_pin.description.urdf.lint import element_findings, mesh_findings
from coop_pin.description.urdf.report import UrdfFinding, UrdfReport
from coop_pin.description.urdf.tree import read_tree
from coop_pin.description.urdf.xml import MAX_BYTES, read_document
from coop_pin.errors import MissingExtraError, UrdfError, UrdfWarning


def expanded(path: Path, arguments: Mapping[str, str], package_dirs: Sequence[Path]) -> bytes:
    """Return the URDF that a xacro file describes, UTF-8. xacro evaluates Python expressions: open only files that you trust.

    Args:
        path: the file, absolute.
        arguments: values of its ``<xacro:arg>`` elements.
        package_dirs: folders that hold the packages of ``$(find ...)``; packages above the file are found
            without.

    Raises:
        MissingExtraError: xacrodoc is not installed.
        UrdfError: the file cannot be expanded.
    """
    try:
        xacrodoc = importlib.import_module("xacrodoc")
    except ImportError:
        raise MissingExtraError("xacrodoc", "xacro", f"to read {path.name}") from None
    xacrodoc.packages.reset()
    xacrodoc.packages.update_package_cache(
        {package.name: package for folder in package_dirs for package in _packages(folder)}
    )
    xacrodoc.packages.walk_up_from(path)
    try:
        # As an include, because a file read as text would not find its own relative includes.
        document: Any = xacrodoc.XacroDoc.from_includes(
            [escape(str(path))], name=path.stem, subargs=dict(arguments), resolve_packages=False
        )
    except (
        Exception
    ) as error:  # xacro has no common base of its errors and evaluates the file's own Python expressions
        raise UrdfError(
            f"{path} cannot be expanded: {error}; check its arguments (xacro_args) and packages (package_dirs)"
        ) from error
    return bytes(document.dom.toxml(encoding="utf-8"))


def _packages(folder: Path) -> list[Path]:
    return [package.parent for package in sorted(folder.glob("*/package.xml"))] if folder.is_dir() else []


def check_urdf(text_or_path: str | bytes | Path) -> UrdfReport:
    """Return every defect of a URDF, with its link or joint and its line.

    Args:
        text_or_path: the text of a URDF (str or bytes), or the path of its file (Path).

    Raises:
        UrdfError: there is no file at the path; the file cannot be read from the disk.
    """
    if isinstance(text_or_path, Path):
        return UrdfReport(str(text_or_path), _findings(_read(text_or_path)))
    # A lone surrogate has no UTF-8; it is passed on so that the check reports it.
    data = text_or_path if isinstance(text_or_path, bytes) else text_or_path.encode("utf-8", "surrogatepass")
    return UrdfReport("the text", _findings(data))


def check_file(urdf: UrdfFile) -> UrdfReport:
    """Return every defect of a file, and the meshes that it names and that are not there; a xacro file is expanded first.

    Raises:
        UrdfError: the file is gone; it is a xacro file that cannot be expanded, or it cannot be read from the
            disk.
        MissingExtraError: it is a xacro file and xacrodoc is not installed.
    """
    data = _text(urdf)
    robot = read_document(data).robot
    meshes = () if robot is None else tuple(mesh_findings(robot, urdf.package_dirs))
    return UrdfReport(
        str(urdf.path), tuple(sorted((*_findings(data), *meshes), key=lambda finding: finding.line))
    )


def load_checked(urdf: UrdfFile, strict: bool = False) -> str:
    """Return the text of a URDF that Pinocchio reads as it is written.

    Physical and doubtful findings in a user's file are warned of (UrdfWarning); bundled files and
    example-robot-data are known.

    Args:
        urdf: the file.
        strict: whether physical findings are errors as well, in any file.

    Raises:
        UrdfError: the file is gone; the file has errors, all of which the message names, or cannot be read
            from the disk.
        MissingExtraError: it is a xacro file and xacrodoc is not installed.
    """
    data = _text(urdf)
    _require_usable(UrdfReport(str(urdf.path), _findings(data)), strict, warn=urdf.origin == "user")
    return data.decode("utf-8")


def text_checked(text: str) -> str:
    """Return URDF text itself, once it is sure that Pinocchio reads it as it is written.

    Physical and doubtful findings are warned of (UrdfWarning).

    Raises:
        UrdfError: it has errors, all of which the message names.
    """
    _require_usable(check_urdf(text), strict=False, warn=True)
    return text


def _require_usable(report: UrdfReport, strict: bool, warn: bool) -> None:
    if report.errors(strict):
        raise UrdfError("\n".join(("the URDF cannot be used:", *report.lines(strict))))
    if report.warnings(strict) and warn:
        warnings.warn(
            "\n".join(("the URDF says what can hardly be meant:", *report.lines())), UrdfWarning, stacklevel=3
        )


def _text(urdf: UrdfFile) -> bytes:
    return (
        expanded(urdf.path, dict(urdf.xacro_args), urdf.package_dirs) if urdf.is_xacro else _read(urdf.path)
    )


def _read(path: Path) -> bytes:
    if not path.is_file():
        raise UrdfError(f"no file at {path}")
    try:
        with path.open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except OSError as error:
        raise UrdfError(f"{path} cannot be read: {error.strerror}; check its permissions") from error


def _findings(data: bytes) -> tuple[UrdfFinding, ...]:
    document = read_document(data)
    if document.robot is None:
        return document.findings
    tree = read_tree(document.robot)
    found = [*element_findings(document.robot), *tree.findings, *massless_findings(tree)]
    for node in document.robot.children:
        if node.tag == "link":
            found += inertial_findings(node)
    return tuple(sorted(found, key=lambda finding: finding.line))
