"""Check of URDF text before Pinocchio reads it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from coop_pin.base.arrays import typed
from coop_pin.base.errors import FileReadError, UrdfError, UrdfWarning
from coop_pin.base.user_files import read_user_file
from coop_pin.description.urdf.find import UrdfFile
from coop_pin.description.urdf.inertia import REPAIRED, physical_findings, repair, repairable
from coop_pin.description.urdf.lint import element_findings, passive_findings
from coop_pin.description.urdf.loops import loop_findings
from coop_pin.description.urdf.meshes import mesh_findings
from coop_pin.description.urdf.report import UrdfFinding, UrdfReport
from coop_pin.description.urdf.tree import read_tree
from coop_pin.description.urdf.xacro import expanded
from coop_pin.description.urdf.xml import MAX_BYTES, DocumentError, read_document, text_of


@typed
def check_urdf(text: str | bytes) -> UrdfReport:
    """Return every defect of the text of a URDF, with its link or joint and its line."""
    # A lone surrogate has no UTF-8 encoding; it is passed on so that the check reports it.
    data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    return UrdfReport("the text", _findings(data))


@typed
def check_file(urdf: UrdfFile) -> UrdfReport:
    """Return every defect of a file, missing meshes included; a xacro file is expanded first.

    Args:
        urdf: the file.

    Raises:
        UrdfError: the file does not exist any more; it is a xacro file that cannot be expanded, or it cannot
            be read from the disk.
        MissingExtraError: it is a xacro file and xacrodoc is not installed.
    """
    return UrdfReport(str(urdf.path), _findings_of_file(urdf, _text(urdf), meshes=True))


@typed
def load_checked(urdf: UrdfFile, *, strict: bool = False, loops: bool = False, parts: bool = True) -> str:
    """Return the text of a URDF file that Pinocchio reads as it is written, its repairs made.

    Inertias and loops are judged with the locked joints of the file; a warning says how parts that they lock
    are repaired. Physical and doubtful findings in a user's file are warned of (UrdfWarning), those of
    bundled files and of example-robot-data are not. Meshes of a user's file that cannot be read are errors;
    missing ones are not, because only drawings need them, and warn of it.

    Args:
        urdf: the file.
        strict: whether physical findings are errors, in any file.
        loops: whether the caller reads the loops that can be read as closures, by ``read_loops``.
        parts: whether inertias and loops are judged; not where the locked joints are not known yet.

    Raises:
        UrdfError: the file does not exist any more; the file has errors, all of which the message lists, or
            cannot be read from the disk.
        MissingExtraError: it is a xacro file and xacrodoc is not installed.
    """
    data, is_users = _text(urdf), urdf.origin == "user"
    findings = _findings_of_file(urdf, data, loops=loops, meshes=is_users)
    ignored = (*(() if parts else _OF_PARTS), *(("loop",) if loops else ()))
    _require_usable(UrdfReport(str(urdf.path), findings), ignored, strict=strict, warn=is_users)
    text = data.decode("utf-8")
    if parts and is_users and any(finding.code in REPAIRED for finding in findings):
        tree = read_tree(robot := read_document(data))
        repair(tree, repairable(tree, tree.locked(dict(urdf.locked)), urdf.repairs))
        text = text_of(robot)
    return text if urdf.carrier is None else urdf.carrier.under(text)


_OF_PARTS = (
    *("loop", "loop_unread", "passive_joint"),
    *("mass_zero", "mass_negative", "massless_body", "inertia_not_psd", "inertia_triangle"),
)
"""Codes of findings that depend on the locked joints."""


@typed
def text_checked(text: str, *, loops: bool = False) -> str:
    """Return the text of a URDF unchanged if Pinocchio reads it as it is written.

    Physical and doubtful findings are warned of (UrdfWarning).

    Args:
        text: the URDF.
        loops: whether loops are read, as for load_checked.

    Raises:
        UrdfError: it has errors, all of which the message lists.
    """
    _require_usable(check_urdf(text), ("loop",) if loops else ())
    return text


def _require_usable(
    report: UrdfReport, ignored: Sequence[str], *, strict: bool = False, warn: bool = True
) -> None:
    report = report.without(ignored)
    if report.errors(strict=strict):
        raise UrdfError(f"the URDF cannot be used:\n{report.summary(strict=strict)}")
    report = report.without(("mesh_missing",))  # drawings omit it
    if warn and report.warnings(strict=strict):
        warnings.warn(f"suspicious values in the URDF:\n{report.summary()}", UrdfWarning, stacklevel=3)


def _findings(data: bytes, urdf: UrdfFile | None = None, *, meshes: bool = False) -> tuple[UrdfFinding, ...]:
    """Return all findings by line; meshes are looked for on demand.

    Args:
        data: the text.
        urdf: the file, with locked joints and repairs; None for a text.
        meshes: whether meshes are looked for.
    """
    try:
        robot = read_document(data)
    except DocumentError as error:
        code, line, message = error.args
        return (UrdfFinding("structural", code, "document", line, message),)
    tree = read_tree(robot)
    locked = tree.locked(dict(urdf.locked if urdf else ()))
    findings = [*loop_findings(robot, tree, locked), *element_findings(robot), *tree.findings]
    repairs = urdf.repairs if urdf and urdf.origin == "user" else None
    findings += physical_findings(robot, tree, locked, repairs)
    findings += passive_findings(tree, locked)
    if urdf and meshes:
        findings += mesh_findings(robot, urdf)
    return tuple(sorted(findings, key=lambda finding: finding.line))


def _findings_of_file(
    urdf: UrdfFile, data: bytes, *, loops: bool = False, meshes: bool = False
) -> tuple[UrdfFinding, ...]:
    """Return the findings of a file; in bundled files and example-robot-data some errors are warnings.

    There, loops are warnings for an arm, which leaves them open, but unread ones are errors for a mechanism.
    """
    findings = _findings(data, urdf, meshes=meshes)
    if urdf.path.suffix == ".xacro":  # whose expansion is one line, and not what the user wrote
        findings = tuple(finding._replace(line=0) for finding in findings)
    if urdf.origin == "user":
        return findings
    open_loops = () if loops else ("loop", "loop_unread")
    return tuple(
        finding._replace(kind="physical")
        if finding.kind == "impossible"
        else finding._replace(kind="doubtful")
        if finding.code in open_loops
        else finding
        for finding in findings
    )


def _text(urdf: UrdfFile) -> bytes:
    if urdf.path.suffix == ".xacro":
        return expanded(urdf.path, urdf.package_dirs, dict(urdf.xacro_args), MAX_BYTES)
    try:
        return read_user_file(urdf.path, limit=MAX_BYTES, kind="a URDF")
    except FileReadError as error:
        raise UrdfError(str(error)) from error
