"""Code as it was loaded: which content of the user's files this process runs.

Python loads a module once. What runs after an edit is what was loaded, until ``importlib.reload``; a run must
be known by that, not by what stands on disk. Importing this module lets Python note the digest of each module
of the user that it loads, and of the data that the module names.
"""

from __future__ import annotations

import ast
import contextlib
import importlib.util
import itertools
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NamedTuple

from coop_pin.base.errors import is_users_file
from coop_pin.base.source_code import data_files, file_digest, source_files

_CLOCK_S = 2.0
"""Resolution of the times by which Python knows bytecode, s, and that of file systems."""


class _Load(NamedTuple):
    """Content of a file as a process has loaded it last.

    Attributes:
        digest: SHA-256 digest of the content.
        order: number of the load among all.
        changed: order of the load that replaced other content, or other content that it uses; 0 for none.
    """

    digest: str
    order: int
    changed: int


_loads: dict[Path, _Load] = {}
_orders = itertools.count(1)


def _note(path: Path, digest: str, *, uses_other: bool = False) -> None:
    order, before = next(_orders), _loads.get(path)
    is_other = before is not None and (before.digest != digest or uses_other)
    _loads[path] = _Load(digest, order, order if is_other else before.changed if before else 0)


class _UsersSource(SourceFileLoader):
    """Loader of a module of the user, which notes the digests of its source and of the data that it names."""

    def path_stats(self, path: Any) -> Any:
        """Return size and time; bytecode that was made in the second of an edit may be older than that."""
        stats, bytecode = super().path_stats(path), Path(importlib.util.cache_from_source(path))
        if bytecode.is_file() and bytecode.stat().st_mtime < stats["mtime"] + _CLOCK_S:
            raise OSError  # without times, Python compiles the source
        return stats

    def get_code(self, fullname: str) -> CodeType | None:
        """Return the code of the module."""
        path = Path(self.path)
        digest, code = file_digest(path), super().get_code(fullname)
        for file in data_files(code, path.parent):
            _note(file, file_digest(file))
        _note(path, digest, uses_other=path in _loads and _is_old(path, source_files(fullname)))
        return code


class _UsersModules:
    """Finder of modules on the path, as Python's own, that hands the user's to the loader above."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and type(spec.loader) is SourceFileLoader and is_users_file(str(spec.origin)):
            spec.loader = _UsersSource(spec.loader.name, spec.loader.path)
        return spec


sys.meta_path.insert(sys.meta_path.index(PathFinder) if PathFinder in sys.meta_path else 0, _UsersModules)


def _modules() -> dict[str, str]:
    """Return the names of the loaded modules by their files."""
    files = ((getattr(each, "__dict__", {}).get("__file__"), name) for name, each in [*sys.modules.items()])
    return {file: name for file, name in files if isinstance(file, str)}


for _file in filter(is_users_file, _modules()):  # loaded before this module, such as a script
    with contextlib.suppress(OSError):
        _note(Path(_file), file_digest(Path(_file)))


def loads() -> int:
    """Return a number that grows with every file that is loaded."""
    return max((load.order for load in _loads.values()), default=0)


# ---------------------------------------------------------------- what has changed


def loaded_digests(name: str) -> tuple[str, ...]:
    """Return the digests of the files of "module:name" as this process has loaded them, or will."""
    return tuple(_loaded(name, source_files(name)).values())


def _loaded(name: str, files: Sequence[Path]) -> dict[Path, str]:
    """Return the digests of files as they were loaded; as they are where nothing of them is in use."""
    modules, is_used = _modules(), name.partition(":")[0] in sys.modules
    data_are_used = is_used or any(str(path) in modules for path in files)
    digests = dict[Path, str]()
    for path in files:
        if (is_module := str(path) in modules) and path not in _loads:  # by a loader such as that of pytest
            _note(path, file_digest(path))
        is_held = is_module or (is_used if path.suffix == ".py" else data_are_used)
        digests[path] = _loads[path].digest if path in _loads and is_held else file_digest(path)
    return digests


def edited_files(name: str) -> tuple[Path, ...]:
    """Return the files of "module:name" whose content is not what this process runs.

    These are files that were edited after they were loaded, and those that were loaded before a file that
    they import was edited and loaded again. Of code in a notebook they are those of all modules of the user.
    """
    files = [path for path in source_files(name) or _of_notebook(name) if path.is_file()]
    edited = {path for path, digest in _loaded(name, files).items() if digest != file_digest(path)}
    return tuple(sorted(edited | old_users(files)))


def _of_notebook(name: str) -> tuple[Path, ...]:
    modules = _modules()
    return tuple(path for path in _loads if str(path) in modules) if name.startswith("__main__:") else ()


def old_users(files: Collection[Path]) -> set[Path]:
    """Return those of some files that were loaded before what they used then was loaded anew."""
    return {user for user in files if user in _loads and _is_old(user, files)}


def _is_old(user: Path, files: Collection[Path]) -> bool:
    later = {path for path in files if path in _loads and _loads[path].changed > _loads[user].order}
    return bool(later) and not later.isdisjoint(_used_at_load(user, _modules()))


def _used_at_load(user: Path, modules: Mapping[str, str]) -> set[Path]:
    """Return the files that a loaded module used while it was loaded, and those that they import.

    It takes something from a module (``from x import y``), or names the module outside of functions.
    """
    module, used = sys.modules[modules[str(user)]] if str(user) in modules else None, set[Path]()
    names = {} if module is None else vars(module)
    for node in _at_load(ast.parse(user.read_bytes())) if names else ():
        home = ""
        if isinstance(node, ast.ImportFrom):
            target, package = "." * node.level + (node.module or ""), names.get("__package__")
            if not all(isinstance(names.get(each.asname or each.name), ModuleType) for each in node.names):
                home = importlib.util.resolve_name(target, package) if package or not node.level else ""
        elif isinstance(node, ast.Name) and isinstance(value := names.get(node.id), ModuleType):
            home = value.__name__
        for file, name in modules.items():
            if Path(file) in _loads and home and f"{name}.".startswith(f"{home}."):
                used |= {Path(file), *source_files(name)}
    return used


def _at_load(node: Any) -> Iterator[Any]:
    """Yield the nodes of a syntax tree that run while a module is loaded: all but bodies of functions."""
    yield node
    is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
    for field, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not (is_function and field == "body"):
                yield from _at_load(child)
