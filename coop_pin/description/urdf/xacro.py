"""Expansion of xacro files, which read no file outside their packages and no environment variable."""

from __future__ import annotations

import importlib
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.sax.saxutils import escape

from coop_pin.description.urdf.find import UrdfFile
from coop_pin.description.urdf.xml import MAX_BYTES
from coop_pin.errors import FileReadError, MissingExtraError, UrdfError
from coop_pin.user_files import read_user_file


def expanded(urdf: UrdfFile) -> bytes:
    """Return the URDF of a xacro file, UTF-8.

    xacro evaluates Python expressions. The files that it reads (includes, YAML) must lie in the file's folder
    or in a package that ``$(find ...)`` finds; environment variables count as not set. Packages are searched
    in the file's package folders and above the file.

    Raises:
        MissingExtraError: xacrodoc is not installed.
        UrdfError: the file cannot be expanded.
    """
    try:
        xacrodoc = importlib.import_module("xacrodoc")
    except ImportError:
        raise MissingExtraError("xacrodoc", "xacro", f"to read {urdf.path.name}") from None
    manifests = [path for folder in urdf.package_dirs for path in sorted(folder.glob("*/package.xml"))]
    above = [folder for folder in urdf.path.parents if (folder / "package.xml").is_file()]
    xacrodoc.packages.reset()
    xacrodoc.packages.update_package_cache({path.parent.name: path.parent for path in manifests})
    xacrodoc.packages.walk_up_from(urdf.path)
    roots = [urdf.path.parent, *above, *(path.parent for path in manifests)]
    try:
        with _confined(xacrodoc.xacrodoc, roots):
            # As an include, because a file read as text would not find its own relative includes.
            document: Any = xacrodoc.XacroDoc.from_includes(
                [escape(str(urdf.path))],
                name=urdf.path.stem,
                subargs=dict(urdf.xacro_args),
                resolve_packages=False,
            )
    # xacro's errors have no common base class, and it evaluates the file's own Python expressions.
    except Exception as error:
        advice = "check its arguments (xacro_args) and packages (package_dirs)"
        raise UrdfError(f"{urdf.path} cannot be expanded: {error}; {advice}") from error
    return bytes(document.dom.toxml(encoding="utf-8"))


@contextmanager
def _confined(xacrodoc: Any, roots: list[Path]) -> Iterator[None]:
    """Let xacro open only files below some folders and found packages, and see an empty environment."""
    xacro, substitutions = xacrodoc.xacro, xacrodoc.substitution_args
    find = substitutions._eval_find
    allowed = [root.resolve() for root in roots]

    def find_and_allow(package: str) -> str:
        folder = str(find(package))
        allowed.append(Path(folder).resolve())
        return folder

    def open_allowed(name: str) -> io.StringIO:
        path = Path(name).resolve()
        if not any(path.is_relative_to(root) for root in allowed):
            raise FileReadError(
                "lies outside the folder and packages of the xacro; add its package's parent to package_dirs",
                str(path),
            )
        try:
            content = read_user_file(path, limit=MAX_BYTES, kind="a file of a xacro")
        except FileReadError as error:  # an optional include may be missing: xacro looks for an OSError
            raise error.__cause__ or error from None
        return io.StringIO(content.decode("utf-8"))

    known = dict(substitutions._eval_dict)
    substitutions._eval_dict["find"] = substitutions._eval_find = find_and_allow
    substitutions.os = SimpleNamespace(environ={}, path=os.path)
    xacro.open = open_allowed
    try:
        yield
    finally:
        substitutions._eval_dict.update(known)
        substitutions._eval_find, substitutions.os = find, os
        del xacro.open
