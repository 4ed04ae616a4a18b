"""Source code of the user: the files that a function or class needs, and their digests.

A data file counts with the module that names it.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from types import CodeType
from typing import Any

from coop_pin.base.errors import is_installed

_STANDARD_LIBRARY = Path(sysconfig.get_path("stdlib"))
_SOURCE, _FOLDER, _NO_FILE = ("", "rb", 1), ("", "", 5), ("", "", 6)
"""What ModuleFinder calls a source file, a package, and a module without source."""
_LONGEST_NAME = 200
_WRITES = {"w", "wb", "a", "ab", "x", "xb", "w+", "a+", "r+"}
_WRITERS = {"dump", "save", "savetxt", "savez", "to_csv", "to_netcdf", "write_bytes", "write_text"}
"""Modes and functions of what writes a file: the files that such code names are not what it reads."""
_READERS = {"genfromtxt", "load", "loadtxt", "read", "read_bytes", "read_csv", "read_text", "readlines"}
"""Functions of what reads one, too."""


def file_digest(path: Path) -> str:
    """Return the SHA-256 digest of a file, 64 hexadecimal digits.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def source_files(name: str) -> tuple[Path, ...]:
    """Return the files of a module, of the local modules that it imports, at any depth, and of their data.

    Local modules lie in the same folder or belong to the same package; installed packages other than the
    module's own are left out. Imports by a computed name are not followed. Nothing is imported. Data are
    files that a module names in a text of its own, or one in a folder that it names, and does not only write.

    Args:
        name: "module:function" or "module".

    Returns:
        The files sorted by path, with the ``__init__.py`` of their packages; empty if there is no such
        module, or it has no file.
    """
    module = name.partition(":")[0]
    if module == "__main__":  # a script is a module of its folder; a notebook has no file
        main = sys.modules[module]
        module = main.__spec__.name if main.__spec__ else Path(getattr(main, "__file__", None) or "").stem
        if _is_typed_in(vars(main).get(name.partition(":")[2]), getattr(main, "__file__", None)):
            return ()
    top = module.partition(".")[0]
    with contextlib.suppress(ImportError, ValueError):  # the run itself reports these better
        spec = importlib.util.find_spec(top)
        locations = [] if spec is None else spec.submodule_search_locations or [spec.origin or ""]
        for root in {Path(location).parent for location in locations}:
            return tuple(sorted(_closure(module, root)))
    return ()


def _is_typed_in(value: Any, file: str | None) -> bool:
    """Return whether a function, or no method of a class, stands in the file of a script."""
    parts = [value, *vars(value).values()] if isinstance(value, type) else [value]
    codes = [part.__code__ for part in parts if hasattr(part, "__code__")]
    return bool(codes) and file not in {code.co_filename for code in codes}


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
                    files.add(source)  # also if Python cannot read it
                    return source.open("rb"), str(source), _SOURCE
                if base.is_dir():
                    return None, str(base), _FOLDER
            if name != "__init__":  # a package need not have one
                raise ImportError(name)
            return None, None, _NO_FILE

    is_own = is_installed(root) or root == _STANDARD_LIBRARY  # then only its own package is user code
    tops = {module.partition(".")[0]} if is_own else None
    finder, files = LocalModules(path=[str(root)]), set[Path]()
    with contextlib.suppress(SyntaxError):
        finder.import_hook(module)
    for entry in finder.modules.values():
        if file := getattr(entry, "__file__", None):
            files |= {*data_files(getattr(entry, "__code__", None), Path(file).parent)}
    return files


def data_files(code: CodeType | None, folder: Path) -> Iterator[Path]:
    """Yield the files that code names, from its folder or the current one, and does not only write."""
    waiting = [code]
    while code := waiting.pop() if waiting else None:
        waiting += [part for part in code.co_consts if isinstance(part, CodeType)]
        texts = {part for part in _flat(code.co_consts) if isinstance(part, str)}
        names = {*code.co_names}
        if (texts & _WRITES or names & _WRITERS) and not names & _READERS:
            continue
        texts = {text for text in texts if len(text) < _LONGEST_NAME and text.isprintable()}
        roots = folder, Path.cwd()
        bases = {*roots, *(base for root in roots for text in texts if (base := root / text).is_dir())}
        files = (base / text for base in bases for text in texts if "." in text)
        yield from (file for file in files if file.is_file() and file.suffix != ".py")


def _flat(values: tuple[Any, ...]) -> Iterator[Any]:
    """Yield constants, also of tuples of them, such as the defaults of a function."""
    for value in values:
        if isinstance(value, tuple):
            yield from _flat(value)
        else:
            yield value


def code_digests(name: str) -> tuple[str, ...]:
    """Return the digests of the files of "module:name" as they are; none if it has no file."""
    return tuple(map(file_digest, source_files(name)))


def named_digests(name: str) -> list[tuple[str, str]]:
    """Return names, without folders, and digests of the files of "module:name" as they are."""
    return [(path.name, file_digest(path)) for path in source_files(name)]
