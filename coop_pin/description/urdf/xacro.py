"""xacro files, expanded by the xacrodoc extra."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from coop_pin.errors import MissingExtraError, UrdfError


def expanded(path: Path, arguments: Mapping[str, str], package_dirs: Sequence[Path]) -> bytes:
    """Return the URDF that a xacro file describes, UTF-8. xacro evaluates Python expressions: open only files that you trust.

    Args:
        path: the file, absolute.
        arguments: values of its ``<xacro:arg>`` elements.
        package_dirs: folders that hold the packages of ``$(find ...)``; packages above the file are found without.

    Raises:
        MissingExtraError: xacrodoc is not installed.
        UrdfError: the file cannot be expanded.
    """
    try:
        xacrodoc = importlib.import_module("xacrodoc")
    except ImportError:
        raise MissingExtraError("xacrodoc", "xacro", f"to read {path.name}") from None
    xacrodoc.packages.reset()
    xacrodoc.packages.update_package_cache({package.name: package for folder in package_dirs for package in _packages(folder)})
    xacrodoc.packages.walk_up_from(path)
    try:
        # As an include, because a file read as text would not find its own relative includes.
        document: Any = xacrodoc.XacroDoc.from_includes(
            [escape(str(path))], name=path.stem, subargs=dict(arguments), resolve_packages=False
        )
    except Exception as error:  # xacro has no common base of its errors and evaluates the file's own Python expressions
        raise UrdfError(f"{path} cannot be expanded: {error}; check its arguments (xacro_args) and packages (package_dirs)") from error
    return bytes(document.dom.toxml(encoding="utf-8"))


def _packages(folder: Path) -> list[Path]:
    return [package.parent for package in sorted(folder.glob("*/package.xml"))] if folder.is_dir() else []
