"""Script that expands a xacro file, which may take any time and memory: macros may call themselves.

Started by ``xacro`` through ``limited_process``, never imported.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.sax.saxutils import escape

from coop_pin.errors import FileReadError
from coop_pin.limited_process import answer
from coop_pin.user_files import read_user_file


def expand(
    path: str, packages: dict[str, str], roots: list[str], arguments: dict[str, str], largest: int
) -> bytes:
    """Return the URDF of a xacro file.

    Args:
        path: the file.
        packages: their folders by name.
        roots: folders that may be read.
        arguments: of the file.
        largest: most bytes of a file that is read, and of the URDF.
    """
    import xacrodoc

    xacrodoc.packages.reset()
    xacrodoc.packages.update_package_cache({name: Path(place) for name, place in packages.items()})
    xacrodoc.packages.walk_up_from(Path(path))
    _confine(xacrodoc.xacrodoc, [Path(root).resolve() for root in roots], largest)
    # As an include, because a file read as text would not find its own relative includes.
    document: Any = xacrodoc.XacroDoc.from_includes(
        [escape(path)], name=Path(path).stem, subargs=arguments, resolve_packages=False
    )
    urdf = bytes(document.dom.toxml(encoding="utf-8"))
    if len(urdf) > largest:
        raise ValueError(f"it expands to {len(urdf)} bytes; a URDF has at most {largest}")
    return urdf


def _confine(xacrodoc: Any, allowed: list[Path], largest: int) -> None:
    """Let xacro open only files below some folders and found packages, and see an empty environment."""
    xacro, substitutions = xacrodoc.xacro, xacrodoc.substitution_args
    find = substitutions._eval_find

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
            content = read_user_file(path, limit=largest, kind="a file of a xacro")
        except FileReadError as error:  # an optional include may be missing: xacro looks for an OSError
            raise error.__cause__ or error from None
        return io.StringIO(content.decode("utf-8"))

    substitutions._eval_dict["find"] = substitutions._eval_find = find_and_allow
    substitutions.os = SimpleNamespace(environ={}, path=os.path)
    xacro.open = open_allowed


if __name__ == "__main__":
    answer(expand)
