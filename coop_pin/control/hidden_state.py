"""State of a user's law besides that of init and step: attributes of its objects, classes and modules.

Code of a law is traced once and run many times: what the law changes in between is lost, and what differs
between the runs without being an attribute of its object is that of one of them. What runs share, such as a
list of a class or the random numbers of numpy, makes a run depend on those before it.
"""

from __future__ import annotations

import collections
import contextlib
import dis
import functools
import hashlib
import random
import sys
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.errors import TracingError
from coop_pin.base.schema.user_code import load_function
from coop_pin.control.controller import ArmController, CellController

Contents = dict[str, Hashable]
"""Content of attributes, by where they are."""
_OWN = ("builtins", "abc", "typing", "coop_pin")
"""Top packages whose classes are no user's."""
_OUTSIDE = {
    *("_io", "_random", "contextvars", "ctypes", "datetime", "gc", "inspect", "io", "multiprocessing"),
    *("numpy.random", "os", "pathlib", "posix", "random", "secrets", "socket", "subprocess", "sys"),
    *("tempfile", "threading", "time", "uuid"),
}
"""Modules whose functions may return something else each time."""
_CLOCKS = {"datetime", "secrets", "time", "uuid"}
"""Modules whose functions are another each time without a state that can be kept."""
_MAKERS = {"default_rng", "RandomState", "Random", "SeedSequence", "SystemRandom", "urandom"}
"""Functions that make generators, without an argument from the entropy of the machine."""
_RANDOM = "numpy.random", "random"
_GLOBAL = "LOAD_GLOBAL", "LOAD_NAME", "STORE_GLOBAL", "DELETE_GLOBAL"
_SEES_ALL = {"__import__", "eval", "exec", "globals", "input", "open"}
"""Functions of Python by which a law reaches what it does not name."""
_STATEFUL = (Iterator, bytearray, random.Random)
"""Objects without attributes whose state can be read."""


def of_objects(controller: CellController) -> Contents:
    """Return the attributes of a law's objects."""
    return {
        f"its attribute {name!r} ({owner})": content
        for owner, law in users_laws("cell", controller)
        for name, content in _attributes(law)
    }


def users_laws(owner: str, law: Any) -> Iterator[tuple[str, Any]]:
    """Yield the objects of users' classes in a controller: itself, those of its arms, and what it wraps."""
    if isinstance(law, Mapping):
        for name, part in law.items():
            yield from users_laws(str(name), part)
    elif isinstance(law, ArmController | CellController):
        if not _is_own(type(law)):
            yield owner, law
            return
        for part in vars(law).values():
            yield from users_laws(owner, part)


def _is_own(kind: type) -> bool:
    return kind.__module__.partition(".")[0] in _OWN


def of_classes(targets: Iterable[str]) -> Contents:
    """Return attributes of the classes of laws, "module:Class", and what functions use of their modules."""
    parts = (of_kind(kind) for target in targets for kind in users_kinds(load_function(target, {})))
    return {name: content for part in parts for name, content in part.items()}


def of_all_runs(targets: Sequence[str]) -> Contents:
    """Return what all runs of a process share that code may change: as of_classes, and random numbers.

    Nothing of code that cannot be loaded, which the run refuses, and nothing of none.
    """
    try:
        contents = of_classes(targets)
    except Exception:  # of a user's module
        return {}
    if not targets:
        return {}
    return contents | random_numbers()


def random_numbers() -> Contents:
    """Return the states of the random numbers that belong to nobody."""
    states = np.random.get_state(legacy=False), random.getstate()  # noqa: NPY002
    named = zip(_RANDOM, states, strict=True)
    return {f"the random numbers of {name}": content_of(state, {}) for name, state in named}


def names_random_numbers(kind: Any) -> bool:
    """Return whether functions of a class name a module of random numbers."""
    return "random" in _names(kind).all


def users_kinds(called: Any) -> Iterator[Any]:
    """Yield a function, or a class and those of the user that it derives from."""
    yield from (kind for kind in getattr(called, "__mro__", (called,)) if not _is_own(kind))


def of_kind(kind: Any) -> Contents:
    """Return the attributes of a class of the user, and what its functions use of its module."""
    contents, module = Contents(), vars(sys.modules[kind.__module__])
    if isinstance(kind, type):
        contents |= {f"{name!r} of class {kind.__qualname__}": part for name, part in _attributes(kind)}
    for name in sorted(_names(kind).globals & module.keys()):
        contents[f"{name!r} of module {kind.__module__}"] = content_of(module[name], {})
    return contents


class _UsedNames(NamedTuple):
    """Names in functions: those of globals, and those of attributes with them."""

    globals: frozenset[str]
    all: frozenset[str]


@functools.cache  # for every run of a batch
def _names(kind: Any) -> _UsedNames:
    """Return the names that the functions of a class use, also by other functions of its module."""
    names, every = set[str](), set[str]()
    for code in _all_code(kind):
        names |= {each.argval for each in dis.get_instructions(code) if each.opname in _GLOBAL}
        every.update(code.co_names)
    return _UsedNames(frozenset(names), frozenset(every))


def _all_code(kind: Any) -> Iterator[CodeType]:
    """Yield the code of the functions of a class, and of those of its module that they name."""
    module, seen = vars(sys.modules[kind.__module__]), set[str]()
    parts = vars(kind).values() if isinstance(kind, type) else [kind]
    waiting = [code for value in parts for code in _code(value)]
    while waiting:
        code = waiting.pop()
        yield code
        waiting += [part for part in code.co_consts if isinstance(part, CodeType)]
        new = {each.argval for each in dis.get_instructions(code) if each.opname in _GLOBAL} - seen
        seen |= new
        waiting += [part for name in new & module.keys() for part in _code(module[name])]


def require_no_outside(targets: Iterable[str]) -> None:
    """Refuse laws that name what is another each time: iterators, files, clocks, random numbers, caches.

    Raises:
        TracingError: they do.
    """
    for kind in (kind for target in targets for kind in users_kinds(load_function(target, {}))):
        values, (names, every) = _named_values(kind), _names(kind)
        outside = [name for name, value in values.items() if _is_outside(value)]
        if any(value is np for value in values.values()) and "random" in every:
            outside.append("numpy.random")
        if outside := sorted({*outside, *(names & _SEES_ALL) - vars(sys.modules[kind.__module__]).keys()}):
            raise TracingError(f"names {', '.join(outside)}, which may be another each time")


def unrepeatable(targets: Iterable[str]) -> list[str]:
    """Return a sentence on each clock and each generator without a seed that functions of laws name."""
    kinds = [kind for target in targets for kind in users_kinds(load_function(target, {}))]
    named = {name for kind in kinds for name, value in _named_values(kind).items() if _homes(value) & _CLOCKS}
    used = dict.fromkeys(named, "a run is another each time; take the time of the measurements")
    seeded = "its random numbers are others in each run; state a seed, default_rng(seed)"
    unseeded = {name: seeded for kind in kinds for name in _calls_without_seed(kind)}
    return [f"the code uses {name}: {advice}" for name, advice in sorted((used | unseeded).items())]


def _named_values(kind: Any) -> dict[str, Any]:
    """Return what functions of a class name: globals, attributes, defaults, variables of outer functions."""
    module = vars(sys.modules[kind.__module__])
    values = {name: module[name] for name in _names(kind).globals & module.keys()} | vars(kind)
    held = {
        f"{name} (a default or a variable of a function around it)": part
        for name, value in values.items()
        for function in _functions(value)
        for part in (*(function.__defaults__ or ()), *_cells(function))
    }
    return values | held


def _calls_without_seed(kind: Any) -> Iterator[str]:
    """Yield the makers of generators that functions of a class call without an argument."""
    for code in _all_code(kind):
        name = ""
        for step in dis.get_instructions(code):
            if step.argval in _MAKERS:
                name = step.argval
            elif step.opname.startswith("CALL"):
                if name and step.arg == 0:
                    yield f"{name}()"
                name = ""
            elif step.opname not in ("PRECALL", "PUSH_NULL", "CACHE"):
                name = ""


def _is_outside(value: Any) -> bool:
    """Return whether a value is, or belongs to, what returns something else each time."""
    return bool(_homes(value) & _OUTSIDE) or isinstance(value, Iterator) or hasattr(value, "cache_info")


def _homes(value: Any) -> set[str]:
    """Return the modules that a value is or comes from; none of a text."""
    owner = getattr(value, "__self__", value)
    if isinstance(value, ModuleType):
        return {value.__name__}
    return (
        set()
        if isinstance(value, str)
        else {
            *map(
                str,
                (getattr(value, "__module__", ""), type(owner).__module__, getattr(value, "__name__", "")),
            )
        }
    )


def _functions(value: Any) -> Iterator[FunctionType]:
    """Yield a function, also that of a property, or of a method of a class."""
    for function in (value, *(getattr(value, name, None) for name in ("__func__", "fget", "__wrapped__"))):
        if isinstance(function, FunctionType):
            yield function


def _code(value: Any) -> Iterator[CodeType]:
    """Yield the code of a function."""
    yield from (function.__code__ for function in _functions(value))


def digest(contents: object) -> str:
    """Return a digest of numbers, texts and classes that is the same in every process."""
    return hashlib.sha256(repr(contents).encode()).hexdigest()


def leaks(before: Contents, targets: Sequence[str]) -> list[str]:
    """Return a sentence on each content that was another before a run: the next one begins with it."""
    return [
        f"a run changes {name}, which all runs share, so that they depend on their order; keep it in the"
        " state of init and step, and random numbers in a generator of the object, default_rng(seed)"
        for name in changes(before, of_all_runs(targets) if before else {})
    ]


def changes(before: Contents, after: Contents) -> list[str]:
    """Return what differs between two contents."""
    return [name for name in before | after if before.get(name) != after.get(name)]


def require_unchanged(before: Contents, after: Contents, where: str = "over its steps") -> None:
    """Refuse a law whose attributes change.

    Raises:
        TracingError: They do.
    """
    for name in changes(before, after):
        raise TracingError(f"changes {name} {where}; keep it in the state of init and step")


def _attributes(owner: Any) -> Iterator[tuple[str, Hashable]]:
    """Yield names and contents of what vars() shows of an object, a class or a module."""
    for name, value in vars(owner).items():
        if not name.startswith("__"):
            yield name, content_of(value, {})


def content_of(value: Any, memo: dict[int, int]) -> Hashable:
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
        content = content_of(value.tolist(), memo) if value.dtype.hasobject else value.tobytes()
        return value.shape, value.dtype.str, content
    if isinstance(value, Mapping):
        return tuple((content_of(key, memo), content_of(part, memo)) for key, part in value.items())
    if isinstance(value, list | tuple | collections.deque):
        return tuple(content_of(part, memo) for part in value)
    if isinstance(value, set | frozenset):
        return tuple(sorted(repr(content_of(part, memo)) for part in value))
    if isinstance(value, staticmethod | classmethod):
        value = value.__func__
    if isinstance(value, FunctionType):
        held = value.__defaults__, value.__kwdefaults__, vars(value), [*_cells(value)]
        return value.__qualname__, content_of(held, memo)
    if isinstance(value, np.random.Generator):
        return type(value).__qualname__, content_of(value.bit_generator.state, memo)
    if isinstance(value, _STATEFUL):
        with contextlib.suppress(Exception):  # generators and files have none that can be read
            return type(value).__qualname__, content_of(value.__reduce_ex__(4)[1:], memo)
    if slots := [name for kind in type(value).__mro__ for name in vars(kind).get("__slots__", ())]:
        parts = {name: getattr(value, name, None) for name in slots if isinstance(name, str)}
        return type(value).__qualname__, content_of(parts | getattr(value, "__dict__", {}), memo)
    if isinstance(value, type | ModuleType) or not hasattr(value, "__dict__"):
        return getattr(value, "__qualname__", type(value).__qualname__)
    return type(value).__qualname__, content_of(vars(value), memo)


def _cells(function: FunctionType) -> Iterator[Any]:
    """Yield the values of outer functions that a function uses."""
    for cell in function.__closure__ or ():
        with contextlib.suppress(ValueError):  # it has none yet
            yield cell.cell_contents
