"""The source files behind a module's name: those that a user edits between two sweeps."""

from __future__ import annotations

import ast
import functools
import importlib.util
import sys
import sysconfig
from collections.abc import Iterator
from importlib.machinery import PathFinder
from pathlib import Path


def source_files(name: str) -> tuple[Path, ...]:
    """Return the file of a module, and of the modules that it imports from beside it or from its own package, at any depth.

    What is installed is left out, but for the module's own package: the files are those that a user edits between two sweeps. Nothing
    is imported, so that code which is imported by a computed name is not seen.

    Args:
        name: "module:function" or "module".

    Returns:
        The files in order of their paths, those of its packages included; none where there is no such module, or where no file holds it.
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
    return bool({"site-packages", "dist-packages"} & set(root.parts)) or root == Path(sysconfig.get_path("stdlib"))


def _may_change(top: str, own: str) -> bool:
    """Say whether a user edits a package between two sweeps: not coop_pin, whose version is in the key, nor what is installed beside."""
    return top != "coop_pin" and own in ("", top)


def _beside(root: Path, module: str) -> Path | None:
    place = root.joinpath(*module.split("."))
    return next((file for file in (place / "__init__.py", place.with_name(place.name + ".py")) if file.is_file()), None)


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
