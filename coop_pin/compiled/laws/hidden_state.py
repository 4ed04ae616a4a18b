"""State of a user's law besides that of init and step: attributes of its objects, classes and modules.

Code of a law is traced once and run many times: what the law changes in between is lost, and what differs
between the runs without being an attribute of its object is that of one of them.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import sys
from collections.abc import Hashable, Iterable, Iterator, Mapping
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from coop_pin.base.errors import TracingError
from coop_pin.base.schema.user_code import load_class
from coop_pin.control import CellController, DecentralisedController

Contents = dict[str, Hashable]
"""Content of attributes, by where they are."""
_OWN = ("builtins", "abc", "typing", "coop_pin")
"""Top packages whose classes are no user's."""


def of_objects(controller: CellController) -> Contents:
    """Return the attributes of a law's objects."""
    laws = controller.controllers if isinstance(controller, DecentralisedController) else {"cell": controller}
    return {
        f"its attribute {name!r} ({owner})": content
        for owner, law in laws.items()
        for name, content in _attributes(law)
    }


def of_classes(targets: Iterable[str]) -> Contents:
    """Return attributes of the classes of laws, "module:Class", and what their functions use of modules."""
    parts = map(_of_class, targets)
    return {name: content for part in parts for name, content in part.items()}


def _of_class(target: str) -> Contents:
    contents = Contents()
    for kind in load_class(target).__mro__:
        if kind.__module__.partition(".")[0] in _OWN:
            continue
        contents |= {f"{name!r} of class {kind.__qualname__}": part for name, part in _attributes(kind)}
        module = vars(sys.modules[kind.__module__])
        for name in _globals(kind):
            contents[f"{name!r} of module {kind.__module__}"] = _content(module.get(name), {})
    return contents


@functools.cache  # for every run of a batch
def _globals(kind: type) -> list[str]:
    """Return the names of a class's module that its functions use, also by other functions of the module."""
    module = vars(sys.modules[kind.__module__])
    names, waiting = set[str](), [code for value in vars(kind).values() for code in _code(value)]
    while waiting:
        code = waiting.pop()
        waiting += [part for part in code.co_consts if isinstance(part, CodeType)]
        new = {name for name in code.co_names if name in module} - names
        names |= new
        waiting += [part for name in new for part in _code(module[name])]
    return sorted(names)


def _code(value: Any) -> Iterator[CodeType]:
    """Yield the code of a function, also of a property, or of a method of a class."""
    for function in (value, *(getattr(value, name, None) for name in ("__func__", "fget", "__wrapped__"))):
        if isinstance(function, FunctionType):
            yield function.__code__


def digest(contents: object) -> str:
    """Return a digest of numbers, texts and classes that is the same in every process."""
    return hashlib.sha256(repr(contents).encode()).hexdigest()


def require_unchanged(before: Contents, after: Contents) -> None:
    """Refuse a law whose attributes change.

    Raises:
        TracingError: They do.
    """
    for name in before | after:
        if before.get(name) != after.get(name):
            raise TracingError(f"changes {name} over its steps; keep it in the state of init and step")


def _attributes(owner: Any) -> Iterator[tuple[str, Hashable]]:
    """Yield names and contents of what vars() shows of an object, a class or a module."""
    for name, value in vars(owner).items():
        if not name.startswith("__"):
            yield name, _content(value, {})


def _content(value: Any, memo: dict[int, int]) -> Hashable:
    """Return what equal values share: numbers, texts and arrays in it; of other objects only the class.

    Args:
        value: Value.
        memo: Objects met before, by id, each with its number; a value may contain itself.
    """
    if value is None or isinstance(value, int | float | complex | str | bytes | np.generic):
        return type(value).__qualname__, repr(value)
    if id(value) in memo:
        return memo[id(value)]
    memo[id(value)] = len(memo)
    if isinstance(value, np.ndarray):
        content = _content(value.tolist(), memo) if value.dtype.hasobject else value.tobytes()
        return value.shape, value.dtype.str, content
    if isinstance(value, Mapping):
        return tuple((_content(key, memo), _content(part, memo)) for key, part in value.items())
    if isinstance(value, list | tuple):
        return tuple(_content(part, memo) for part in value)
    if isinstance(value, set | frozenset):
        return tuple(sorted(repr(_content(part, memo)) for part in value))
    if isinstance(value, staticmethod | classmethod):
        value = value.__func__
    if isinstance(value, FunctionType):
        held = value.__defaults__, value.__kwdefaults__, vars(value), [*_cells(value)]
        return value.__qualname__, _content(held, memo)
    if isinstance(value, type | ModuleType) or not hasattr(value, "__dict__"):
        return getattr(value, "__qualname__", type(value).__qualname__)
    return type(value).__qualname__, _content(vars(value), memo)


def _cells(function: FunctionType) -> Iterator[Any]:
    """Yield the values of outer functions that a function uses."""
    for cell in function.__closure__ or ():
        with contextlib.suppress(ValueError):  # it has none yet
            yield cell.cell_contents
