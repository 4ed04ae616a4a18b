"""Key of a stored run: a digest of its scenario, the files that it reads and the user's code that it runs."""

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
    """Return the SHA-256 digest of a file, 64 hexadecimal digits.

    Raises:
        OSError: the file cannot be read.
    """
    about = path.stat()
    return _digest_of(path, about.st_mtime_ns, about.st_size)


@functools.lru_cache(maxsize=1024)
def _digest_of(path: Path, changed: int, size: int) -> str:  # noqa: ARG001 part of the cache key
    return hashlib.sha256(path.read_bytes()).hexdigest()


def source_files(name: str) -> tuple[Path, ...]:
    """Return the source files of a module and of the local modules that it imports, at any depth.

    Local modules lie in the same folder or belong to the same package; installed packages other than the
    module's own are left out. Nothing is imported, so imports by a computed name are not followed.

    Args:
        name: "module:function" or "module".

    Returns:
        The files sorted by path, with the ``__init__.py`` of their packages; empty if there is no such module
        or it has no file.
    """
    module = _full_name(name.partition(":")[0])
    first = _file_of(module)
    if first is None:
        return ()
    root = first.parents[module.count(".") + (first.name == "__init__.py")]
    is_installed = {"site-packages", "dist-packages"} & set(root.parts) or root == Path(
        sysconfig.get_path("stdlib")
    )
    own = module.partition(".")[0] if is_installed else ""  # then only its own package is user code
    packages = [(entry, file) for entry in _with_packages(module)[:-1] if (file := _beside(root, entry))]
    found, waiting = set[Path](), [*packages, (module, first)]
    while waiting:
        module, path = waiting.pop()
        if path not in found:
            found.add(path)
            for entry in _imported(path, module):
                top = entry.partition(".")[0]
                if top != "coop_pin" and own in ("", top) and (file := _beside(root, entry)):
                    waiting.append((entry, file))
    return tuple(sorted(found))


def _full_name(module: str) -> str:
    """Return a module's full name; ``python -m`` calls the module __main__."""
    spec = getattr(sys.modules.get(module), "__spec__", None) if module == "__main__" else None
    return spec.name if spec else module


def _file_of(module: str) -> Path | None:
    """Return the file of a module without importing its packages, whose code may raise anything."""
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
def _imported_by(path: Path, module: str, changed: int, size: int) -> tuple[str, ...]:  # noqa: ARG001 part of the cache key
    """Return the imported names that may be modules, with their packages."""
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):  # the run itself reports this better
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


_FUNCTION_FIELDS = ("target", "twist", "acceleration")


class CodeDigest(NamedTuple):
    """Digests of a user's function or class, as its source files are on disk.

    Attributes:
        name: "module:function".
        digests: of its source files, sorted by path; empty if there are none.
    """

    name: str
    digests: tuple[str, ...]


def code_digests(scenario: Scenario, metrics: tuple[str, ...]) -> tuple[CodeDigest, ...]:
    """Return the digests of the user's code that a run names, each name once."""
    parts = (scenario.controller, scenario.motion, scenario.squeeze)
    named = [
        getattr(part, field, None)
        for part in parts
        if part.kind in ("user", "function")
        for field in _FUNCTION_FIELDS
    ]
    names = dict.fromkeys([*filter(None, named), *metrics])
    return tuple(CodeDigest(name, tuple(map(file_digest, source_files(name)))) for name in names)


def require_unchanged(codes: tuple[CodeDigest, ...]) -> None:
    """Require that this process has loaded code as it was when a run's key was made.

    Python loads a module once: after an edit, a process or worker that is still running would store results
    of the old code under the key of the new code. The code loaded is taken to be the files' content at the
    first call for them.

    Raises:
        CodeChangedError: this process has loaded other code.
    """
    for code in codes:
        loaded = tuple(_loaded.setdefault(path, file_digest(path)) for path in source_files(code.name))
        if loaded != code.digests:
            raise CodeChangedError(code.name)


_loaded: dict[Path, str] = {}
"""Digests of the files that this process has loaded."""


def run_key(
    scenario: Scenario, metrics: tuple[str, ...] = (), code: tuple[CodeDigest, ...] | None = None
) -> str:
    """Return the key of a run, 64 hexadecimal digits.

    The key covers the resolved scenario, the contents of the files that it names (robot descriptions, tables
    of poses), the source of the user's code with the local modules that it imports, the names of the user's
    metrics, and the version of coop_pin. It does not cover the source of coop_pin, files that a xacro or a
    mesh refers to, or the versions of other packages.

    Args:
        scenario: the resolved scenario.
        metrics: the user's metrics, "module:function".
        code: what ``code_digests`` returned; computed when omitted.
    """
    code = code_digests(scenario, metrics) if code is None else code
    content = {"coop_pin": __version__, "scenario": scenario.model_dump_json(), "metrics": list(metrics)}
    files = {name: file_digest(path) for name, path in _files(scenario)}
    return _hash(content | {"files": files, "code": dict(code)})


def unresolved_key(base: Scenario, changes: Mapping[str, Any]) -> str:
    """Return the key of a run whose changed scenario has mistakes: of the base scenario and the changes."""
    return _hash({"coop_pin": __version__, "base": base.model_dump_json(), "changes": dict(changes)})


def _hash(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode()).hexdigest()


def _files(scenario: Scenario) -> Iterator[tuple[str, Path]]:
    """Yield the files that a scenario names; a missing one is skipped, since the run reports it."""
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
