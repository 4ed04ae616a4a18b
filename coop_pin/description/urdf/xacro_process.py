"""Process that expands a xacro file, which may take any time and memory: macros may call themselves.

Started by ``xacro``, never imported.

    python -P xacro_process.py

stdin is a table in JSON: ``sys_path`` of the parent, ``path`` of the file, ``packages`` (folders by name),
``roots`` (folders that may be read), ``arguments``, ``largest`` (bytes of a file), ``cpu_s`` and ``memory``
(bytes). stdout is the URDF in UTF-8; with exit code 2, what is wrong.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.sax.saxutils import escape


def main(order: dict[str, Any]) -> bytes:
    """Return the URDF of a xacro file."""
    import xacrodoc

    path = Path(order["path"])
    xacrodoc.packages.reset()
    xacrodoc.packages.update_package_cache({name: Path(place) for name, place in order["packages"].items()})
    xacrodoc.packages.walk_up_from(path)
    _confine(xacrodoc.xacrodoc, [Path(root).resolve() for root in order["roots"]], order["largest"])
    _limit(order["cpu_s"], order["memory"])
    # As an include, because a file read as text would not find its own relative includes.
    document: Any = xacrodoc.XacroDoc.from_includes(
        [escape(str(path))], name=path.stem, subargs=order["arguments"], resolve_packages=False
    )
    return bytes(document.dom.toxml(encoding="utf-8"))


def _confine(xacrodoc: Any, allowed: list[Path], largest: int) -> None:
    """Let xacro open only files below some folders and found packages, and see an empty environment."""
    from coop_pin.errors import FileReadError
    from coop_pin.user_files import read_user_file

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


def _limit(cpu_s: int, memory: int) -> None:
    with contextlib.suppress(ImportError):  # on Windows the parent's patience is the only limit
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if sys.platform != "darwin":  # which refuses it
            resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


if __name__ == "__main__":
    _ORDER = json.load(sys.stdin)
    sys.path[:] = _ORDER["sys_path"]
    try:
        _URDF = main(_ORDER)
        if len(_URDF) > _ORDER["largest"]:
            raise ValueError(f"it expands to {len(_URDF)} bytes; a URDF has at most {_ORDER['largest']}")
    # xacro's errors have no common base class, and it evaluates the file's own Python expressions.
    except Exception as error:
        sys.stdout.write(str(error) or type(error).__name__)
        sys.exit(2)
    sys.stdout.buffer.write(_URDF)
