"""The source files behind a module's name: those that a user edits between two sweeps."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import json
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any, NamedTuple

from coop_pin import __version__
from coop_pin.description.scenario import Scenario
from coop_pin.description.urdf import find_urdf
from coop_pin.errors import CodeChangedError, CoopPinError


def file_digest(path: Path) -> str:
    """Return the digest of a file, 64 hexadecimal digits.

    Raises:
        OSError: it cannot be read.
    """
    about = path.stat()
    return _digest_of(path, about.st_mtime_ns, about.st_size)


@functools.lru_cache(maxsize=1024)
def _digest_of(path: Path, changed: int, size: int) -> str:  # noqa: ARG001 they are in the cache's key
    return hashlib.sha256(path.read_bytes()).hexdigest()


def source_files(name: str) -> tuple[Path, ...]:
    """Return the file of a module, and of the modules that it imports from beside it or from its own package, at any depth.

    What is installed is left out, but for the module's own package: the files are those that a user edits
    between two sweeps. Nothing is imported, so that code which is imported by a computed name is not seen.

    Args:
        name: "module:function" or "module".

    Returns:
        The files in order of their paths, those of its packages included; none where there is no such module,
        or where no file holds it.
    """
    module = _full_name(name.partition(":")[0])
    first = _file_of(module)
    if first is None:
        return ()
    root = first.parents[module.count(".") + (first.name == "__init__.py")]
    own = module.partition(".")[0] if _is_installed(root) else ""
    packages = [(entry, file) for entry in _with_packages(module)[:-1] if (file := _beside(root, entry))]
    found, waiting = set[Path](), [*packages, (module, first)]
    while waiting:
        module, path = waiting.pop()
        if path not in found:
            found.add(path)
            wanted = [entry for entry in _imported(path, module) if _may_change(entry.partition(".")[0], own)]
            waiting += [(entry, file) for entry in wanted if (file := _beside(root, entry))]
    return tuple(sorted(found))


def _full_name(module: str) -> str:
    """Return a module's name in its package, which only ``python -m`` hides: it calls the module __main__."""
    spec = getattr(sys.modules.get(module), "__spec__", None) if module == "__main__" else None
    return spec.name if spec else module


def _file_of(module: str) -> Path | None:
    """Return the file of a module. Its packages are not imported: what stands in them may raise anything."""
    top, *rest = module.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except ValueError:  # __main__ has no spec; a script has a file, a notebook has none
        file = getattr(sys.modules.get(top), "__file__", None)
    else:
        for depth in range(len(rest)):
            name = ".".join([top, *rest[: depth + 1]])
            spec = PathFinder.find_spec(name, spec.submodule_search_locations or []) if spec else None
        file = spec.origin if spec else None
    return Path(file) if file and Path(file).is_file() else None


def _is_installed(root: Path) -> bool:
    return bool({"site-packages", "dist-packages"} & set(root.parts)) or root == Path(
        sysconfig.get_path("stdlib")
    )


def _may_change(top: str, own: str) -> bool:
    """Say whether a user edits a package between two sweeps: not coop_pin, whose version is in the key, nor what is installed beside."""
    return top != "coop_pin" and own in ("", top)


def _beside(root: Path, module: str) -> Path | None:
    place = root.joinpath(*module.split("."))
    return next(
        (file for file in (place / "__init__.py", place.with_name(place.name + ".py")) if file.is_file()),
        None,
    )


def _imported(path: Path, module: str) -> tuple[str, ...]:
    if path.suffix != ".py":
        return ()
    about = path.stat()
    return _imported_by(path, module, about.st_mtime_ns, about.st_size)


@functools.lru_cache(maxsize=1024)
def _imported_by(path: Path, module: str, changed: int, size: int) -> tuple[str, ...]:  # noqa: ARG001 they are in the cache's key
    """Return the names that may be modules, with the packages that they stand in."""
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):  # the run says so better
        return ()
    whole = [name for node in ast.walk(tree) for name in _names(node, package)]
    return tuple(dict.fromkeys(prefix for name in whole for prefix in _with_packages(name)))


def _names(node: ast.AST, package: str) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        parts = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
        base = ".".join([*parts, *([node.module] if node.module else [])])
        yield from (f"{base}.{alias.name}".lstrip(".") for alias in node.names)


def _with_packages(name: str) -> list[str]:
    parts = name.split(".")
    return [".".join(parts[: i + 1]) for i in range(len(parts))]


_FIELDS = ("target", "twist", "acceleration")


class UserCode(NamedTuple):
    """Code of the user's own as it stands in files.

    Attributes:
        name: "module:function".
        digests: of its source files, in order of their paths; empty where there are none.
    """

    name: str
    digests: tuple[str, ...]


def user_code(scenario: Scenario, metrics: tuple[str, ...]) -> tuple[UserCode, ...]:
    """Return the code of the user's own that a run names, each name once."""
    parts = (scenario.controller, scenario.motion, scenario.squeeze)
    named = [
        getattr(part, field, None) for part in parts if part.kind in ("user", "function") for field in _FIELDS
    ]
    return tuple(map(_as_it_stands, dict.fromkeys([*filter(None, named), *metrics])))


def require_loaded(codes: tuple[UserCode, ...]) -> None:
    """Require that this process runs code as it stood when a run's key was made.

    Python loads a module once: a process that goes on after an edit, or a worker that was there before, would
    compute with the old code what is kept as the new code's. What was loaded is taken to be what stood in the
    files when they were first asked for.

    Raises:
        CodeChangedError: it runs other code.
    """
    for code in codes:
        if (
            tuple(_loaded.setdefault(path, file_digest(path)) for path in source_files(code.name))
            != code.digests
        ):
            raise CodeChangedError(code.name)


def _as_it_stands(name: str) -> UserCode:
    return UserCode(name, tuple(file_digest(path) for path in source_files(name)))


_loaded: dict[Path, str] = {}
"""The digests of the files that this process has loaded."""


def run_key(
    scenario: Scenario, metrics: tuple[str, ...] = (), code: tuple[UserCode, ...] | None = None
) -> str:
    """Return the key of a run, 64 hexadecimal digits.

    It stands for the resolved scenario with its seed, the contents of the files it names (robot descriptions,
    tables of poses), the source of the user's own code and of what that imports from beside it, the user's
    own metrics, and the version of coop_pin. It does not stand for the source of coop_pin, for files that a
    xacro or a mesh refers to, or for the versions of other packages.

    Args:
        scenario: the resolved scenario.
        metrics: the user's own metrics, "module:function".
        code: the user's own code as ``user_code`` read it; read now when omitted.
    """
    code = user_code(scenario, metrics) if code is None else code
    content = {"coop_pin": __version__, "scenario": scenario.model_dump_json(), "metrics": list(metrics)}
    files = {name: file_digest(path) for name, path in _files(scenario)}
    return _hash(content | {"files": files, "code": dict(code)})


def unresolved_key(base: Scenario, changes: Mapping[str, Any]) -> str:
    """Return the key of a run whose changes make no scenario: of the scenario as it was, and the changes."""
    return _hash({"coop_pin": __version__, "base": base.model_dump_json(), "changes": dict(changes)})


def _hash(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode()).hexdigest()


def _files(scenario: Scenario) -> Iterator[tuple[str, Path]]:
    """Yield the files that determine a run beside its scenario; one that is missing is left for the run to complain of."""
    for arm in scenario.cell.arms.values():
        if path := _urdf_path(arm.urdf):
            yield arm.urdf, path
    table = getattr(scenario.motion, "path", None)
    if table and Path(table).is_file():
        yield table, Path(table)


@functools.lru_cache(maxsize=256)
def _urdf_path(urdf: str) -> Path | None:
    try:
        return find_urdf(urdf).path
    except CoopPinError:
        return None
