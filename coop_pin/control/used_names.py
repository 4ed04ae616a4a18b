"""What the functions of a user's class use: code, globals of the user's modules, and further classes."""

from __future__ import annotations

import contextlib
import dis
import functools
import sys
from collections.abc import Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple

from coop_pin.base.errors import is_users_file

_GLOBAL = "LOAD_GLOBAL", "LOAD_NAME", "STORE_GLOBAL", "DELETE_GLOBAL"


class UsedNames(NamedTuple):
    """What functions of a class use, also by other functions of the user's.

    Attributes:
        code: their code.
        globals: modules that hold the names that they use, by the name of the module and the name.
        names: all names in them, those of attributes, too.
        kinds: further classes of the user's whose functions they may call.
    """

    code: list[CodeType]
    globals: dict[tuple[str, str], dict[str, Any]]
    names: set[str]
    kinds: list[type]


@functools.cache  # for every run of a batch
def used_names(kind: Any) -> UsedNames:
    """Return what the functions of a class use."""
    used = UsedNames([], {}, set(), [])
    first = _users_functions(kind) if isinstance(kind, type) else functions_of(kind)
    waiting = [(each.__code__, each.__globals__) for each in first]
    while waiting:
        code, module = waiting.pop()
        if code in used.code:
            continue
        used.code.append(code)
        used.names.update(code.co_names)
        waiting += [(part, module) for part in code.co_consts if isinstance(part, CodeType)]
        named = {each.argval for each in dis.get_instructions(code) if each.opname in _GLOBAL} & module.keys()
        homes = [(module, named)]
        for other in (module[name] for name in named if isinstance(module[name], ModuleType)):
            if is_users_file(getattr(other, "__file__", None) or __file__):
                homes.append((vars(other), {*code.co_names} & vars(other).keys()))
        for home, names in homes:
            used.globals.update({(home["__name__"], name): home for name in names})
            for value in (home[name] for name in names):
                other = value if isinstance(value, type) else type(value)
                if other is not kind and other not in used.kinds and _is_users_kind(other):
                    used.kinds.append(other)
                    value = other
                waiting += [(each.__code__, each.__globals__) for each in _users_functions(value)]
    return used


def _is_users_kind(kind: type) -> bool:
    file = getattr(sys.modules.get(kind.__module__), "__file__", None)
    return kind.__module__ == "__main__" or is_users_file(file or __file__)


def _users_functions(value: Any) -> Iterator[FunctionType]:
    """Yield a function of the user's, or the functions of a class of the user's."""
    parts = vars(value).values() if isinstance(value, type) else [value]
    for function in (function for part in parts for function in functions_of(part)):
        if is_users_file(function.__code__.co_filename):
            yield function


def functions_of(value: Any) -> Iterator[FunctionType]:
    """Yield a function, also that of a property, or of a method of a class."""
    for function in (value, *(getattr(value, name, None) for name in ("__func__", "fget", "__wrapped__"))):
        if isinstance(function, FunctionType):
            yield function


def cells_of(function: FunctionType) -> Iterator[Any]:
    """Yield the values of outer functions that a function uses."""
    for cell in function.__closure__ or ():
        with contextlib.suppress(ValueError):  # it has none yet
            yield cell.cell_contents
