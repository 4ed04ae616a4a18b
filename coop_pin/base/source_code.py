"""Source code of the user: the files that a function or class needs, and their content as it was loaded.

Python loads a module once. What runs after an edit is what was loaded, until ``importlib.reload``; a run must
be known by that, not by what stands on disk. Importing this module lets Python compile modules of the user
from their source, whose digest is noted. A data file counts with the module that names it.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import itertools
import os
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NamedTuple

_STANDARD_LIBRARY = sysconfig.get_path("stdlib")
_KNOWN = str(Path(__file__).parents[1]) + os.sep, _STANDARD_LIBRARY + os.sep
_INSTALLED = "site-packages", "dist-packages"
_SOURCE, _FOLDER, _NO_FILE = ("", "rb", 1), ("", "", 5), ("", "", 6)
"""What ModuleFinder calls a source file, a package, and a module without source."""
_CLOCK_S = 2.0
"""Resolution of the times by which Python knows bytecode, s, and that of file systems."""
_LONGEST_NAME = 200
_WRITES = {"w", "wb", "a", "ab", "x", "xb", "w+", "a+", "r+"}
_WRITERS = {"dump", "save", "savetxt", "savez", "to_csv", "to_netcdf", "write_bytes", "write_text"}
"""Modes and functions of what writes a file: the files that such code names are not what it reads."""


class _Load(NamedTuple):
    """Content of a file as a process has loaded it last.

    Attributes:
        digest: SHA-256 digest of the content.
        order: number of the load among all.
        changed: order of the load that brought this content in place of another; 0 for the first content.
    """

    digest: str
    order: int
    changed: int


_loads: dict[Path, _Load] = {}
_orders = itertools.count(1)


def is_users_file(file: str) -> bool:
    """Return whether a file is of neither this package, the standard library nor an installed package."""
    return not (file.startswith(_KNOWN) or {*_INSTALLED} & {*Path(file).parts})


def shown(file: Path) -> str:
    """Return the path of a user's file relative to the current folder if it is below it, else its name."""
    file, here = file.resolve(), Path.cwd()
    is_below = is_users_file(str(file)) and file.is_relative_to(here)
    return file.relative_to(here).as_posix() if is_below else file.name


def file_digest(path: Path) -> str:
    """Return the SHA-256 digest of a file, 64 hexadecimal digits.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# ---------------------------------------------------------------- what is loaded


def _note(path: Path, digest: str) -> None:
    order, before = next(_orders), _loads.get(path)
    is_other = before is not None and before.digest != digest
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
        for file in _data_files(code, path.parent):
            _note(file, file_digest(file))
        _note(path, digest)
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


# ---------------------------------------------------------------- which files


def source_files(name: str) -> tuple[Path, ...]:
    """Return the files of a module, of the local modules that it imports, at any depth, and of their data.

    Local modules lie in the same folder or belong to the same package; installed packages other than the
    module's own are left out. Imports by a computed name are not followed. Nothing is imported. Data are
    files that a module names in a text of its own and does not write.

    Args:
        name: "module:function" or "module".

    Returns:
        The files sorted by path, with the ``__init__.py`` of their packages; empty if there is no such
        module, or it has no file, or Python cannot read it.
    """
    module = name.partition(":")[0]
    if module == "__main__":  # a script is a module of its folder; a notebook has no file
        main = sys.modules[module]
        module = main.__spec__.name if main.__spec__ else Path(getattr(main, "__file__", None) or "").stem
    top = module.partition(".")[0]
    with contextlib.suppress(ImportError, SyntaxError, ValueError):  # the run itself reports these better
        spec = importlib.util.find_spec(top)
        locations = [] if spec is None else spec.submodule_search_locations or [spec.origin or ""]
        for root in {Path(location).parent for location in locations}:
            return tuple(sorted(_closure(module, root)))
    return ()


def _closure(module: str, root: Path) -> set[Path]:
    """Return the files of a module below a folder, and of what it imports from there."""
    from modulefinder import ModuleFinder  # slow to load

    class LocalModules(ModuleFinder):
        """Modules that a module imports, at any depth, from one folder; nothing is imported to find them."""

        def find_module(self, name: str, path: Any, parent: Any = None) -> Any:
            if parent is None and (name in ("", "coop_pin") or name not in (tops or {name})):
                raise ImportError(name)
            for base in (Path(folder, name) for folder in path or self.path):
                source = base.with_suffix(".py")
                if source.is_file() and not (base / "__init__.py").is_file():
                    return source.open("rb"), str(source), _SOURCE
                if base.is_dir():
                    return None, str(base), _FOLDER
            if name != "__init__":  # a package need not have one
                raise ImportError(name)
            return None, None, _NO_FILE

    is_installed = {*_INSTALLED} & {*root.parts} or str(root) == _STANDARD_LIBRARY
    tops = {module.partition(".")[0]} if is_installed else None  # then only its own package is user code
    finder, files = LocalModules(path=[str(root)]), set[Path]()
    finder.import_hook(module)
    for entry in finder.modules.values():
        if file := getattr(entry, "__file__", None):
            files.add(Path(file))
            files |= {*_data_files(getattr(entry, "__code__", None), Path(file).parent)}
    return files


def _data_files(code: CodeType | None, folder: Path) -> Iterator[Path]:
    """Yield the files that code names, from its folder or the current one, and does not write."""
    waiting = [code]
    while code := waiting.pop() if waiting else None:
        waiting += [part for part in code.co_consts if isinstance(part, CodeType)]
        texts = {part for part in _flat(code.co_consts) if isinstance(part, str)}
        if texts & _WRITES or {*code.co_names} & _WRITERS:
            continue
        for text in texts:
            if "." in text and len(text) < _LONGEST_NAME and text.isprintable():
                files = (base / text for base in (folder, Path.cwd()))
                yield from (file for file in files if file.is_file() and file.suffix != ".py")


def _flat(values: tuple[Any, ...]) -> Iterator[Any]:
    """Yield constants, also of tuples of them, such as the defaults of a function."""
    for value in values:
        if isinstance(value, tuple):
            yield from _flat(value)
        else:
            yield value


# ---------------------------------------------------------------- what has changed


def code_digests(name: str) -> tuple[str, ...]:
    """Return the digests of the files of "module:name" as they are; none if it has no file."""
    return tuple(map(file_digest, source_files(name)))


def named_digests(name: str) -> list[tuple[str, str]]:
    """Return names, without folders, and digests of the files of "module:name" as they are."""
    return [(path.name, file_digest(path)) for path in source_files(name)]


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


def old_users(files: Iterable[Path]) -> set[Path]:
    """Return those of some files that were loaded before what they import was loaded anew."""
    known, modules = [path for path in files if path in _loads], _modules()
    return {
        user
        for path in known
        for user in known
        if _loads[user].order < _loads[path].changed and path in source_files(modules.get(str(user), ""))
    }
