"""Expansion of xacro files, which read no file outside their packages and no environment variable.

Macros may call themselves and take any time and memory: this file is also the script of a process with
limits, which ``limited_process`` starts, and imports no more than that needs.
"""

from __future__ import annotations

import importlib.util
import io
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from coop_pin.base import limited_process
from coop_pin.base.errors import FileReadError, MissingExtraError, UrdfError
from coop_pin.base.user_files import read_user_file
from coop_pin.description.urdf.packages import packages

_CPU_S, _MEMORY = 3, 2**30
"""Limits of an expansion: processor time, s, and memory, bytes; a robot takes a tenth of a second."""
_PATIENCE_S = 60.0


def expanded(path: Path, package_dirs: Sequence[Path], arguments: Mapping[str, str], largest: int) -> bytes:
    """Return the URDF of a xacro file, UTF-8, of at most a number of bytes.

    xacro evaluates Python expressions, in a process of its own with limits of time and memory. The files that
    it reads (includes, YAML) must lie in the file's folder or in a package that ``$(find ...)`` finds; its
    environment variables (``optenv``) are the arguments and no others. Packages are searched in the file's
    package folders and above the file.

    Raises:
        MissingExtraError: xacrodoc is not installed.
        UrdfError: the file cannot be expanded, or not within the limits.
    """
    if importlib.util.find_spec("xacrodoc") is None:
        raise MissingExtraError("xacrodoc", "xacro", f"to read {path.name}")
    known = list(packages(package_dirs))[::-1]  # of two with one name the first is taken
    above = [folder for folder in path.parents if (folder / "package.xml").is_file()]
    order = {
        "path": str(path),
        "packages": {name: str(folder) for name, folder in known},
        "roots": list(map(str, (path.parent, *above, *(folder for _, folder in known)))),
        "arguments": dict(arguments),
        "largest": largest,
    }
    code, output = limited_process.ask(
        Path(__file__), order, cpu_s=_CPU_S, memory=_MEMORY, patience_s=_PATIENCE_S
    )
    if code == 0:
        return output
    reason = f"it takes more than {_CPU_S} s or {_MEMORY / 1e9:.2g} GB; look for a macro that calls itself"
    if code == limited_process.REFUSED:
        advice = "check its arguments (xacro_args) and packages (package_dirs)"
        reason = f"{output.decode(errors='replace')}; {advice}"
    raise UrdfError(f"{path} cannot be expanded: {reason}")


def _expand(
    path: str, packages: dict[str, str], roots: list[str], arguments: dict[str, str], largest: int
) -> bytes:
    """Return the URDF of a xacro file.

    Args:
        path: the file.
        packages: their folders by name.
        roots: folders that may be read.
        arguments: arguments of the file.
        largest: most bytes of a file that is read, and of the URDF.
    """
    from xml.sax.saxutils import escape  # slow to load

    import xacrodoc

    xacrodoc.packages.reset()
    xacrodoc.packages.update_package_cache({name: Path(folder) for name, folder in packages.items()})
    xacrodoc.packages.walk_up_from(Path(path))
    skipped = _confine(xacrodoc.xacrodoc, [Path(root).resolve() for root in roots], largest, arguments)
    try:  # As an include, because a file read as text would not find its own relative includes.
        document: Any = xacrodoc.XacroDoc.from_includes(
            [escape(path)], name=Path(path).stem, subargs=arguments, resolve_packages=False
        )
    except Exception as error:
        if package := _missing_package(error):
            raise ValueError(
                f"there is no package {package!r}: its parent belongs into package_dirs"
            ) from None
        name = next((name for name in skipped if f"name '{name}' is not defined" in str(error)), None)
        if name is None:
            raise
        advice = f"xacro skips <property> without its prefix: write <xacro:property> in {skipped[name]}"
        raise ValueError(f"{error}; {advice}") from None
    urdf = bytes(document.dom.toxml(encoding="utf-8"))
    if len(urdf) > largest:
        raise ValueError(f"it expands to {len(urdf)} bytes; a URDF has at most {largest}")
    return urdf


def _missing_package(error: BaseException) -> str:
    """Return the package that a xacro asks for and that is missing, or ""; xacro wraps what it catches."""
    while inner := getattr(error, "exc", None):
        error = inner
    return str(error.args[0]) if type(error).__name__ == "PackageNotFoundError" else ""


def _confine(xacrodoc: Any, allowed: list[Path], largest: int, arguments: dict[str, str]) -> dict[str, Path]:
    """Let xacro open only files below some folders and of its packages, with arguments as environment.

    Returned are, as files are read, the properties that lack the prefix of xacro's namespace, by name.
    """
    xacro, substitutions = xacrodoc.xacro, xacrodoc.substitution_args
    find, skipped = substitutions._eval_find, dict[str, Path]()

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
        text = content.decode("utf-8")
        skipped.update(dict.fromkeys(re.findall(r"""<property\s+name=["'](\w+)""", text), path))
        return io.StringIO(text)

    substitutions._eval_dict["find"] = substitutions._eval_find = find_and_allow
    substitutions.os = SimpleNamespace(environ=arguments, path=os.path)
    xacro.open = open_allowed
    return skipped


if __name__ == "__main__":
    limited_process.answer(_expand)
