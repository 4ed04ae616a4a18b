"""State of a user's law besides that of init and step: attributes of its objects, classes and modules.

Code of a law is traced once and run many times: what the law changes in between is lost, and what differs
between the runs without being an attribute of its object is that of one of them. What runs share, such as a
list of a class or the random numbers of numpy, makes a run depend on those before it.
"""

from __future__ import annotations

import collections
import contextlib
import contextvars
import dis
import functools
import gc
import hashlib
import random
import sys
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from coop_pin.base.errors import CoopPinError, TracingError
from coop_pin.base.loaded_code import loads
from coop_pin.base.schema.user_code import load_function
from coop_pin.base.source_code import file_digest, source_files
from coop_pin.control.controller import ArmController, CellController
from coop_pin.control.used_names import cells_of, functions_of, used_names

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
_CLOCKS = dict.fromkeys(("datetime", "time"), "a run is another each time; take the time of the measurements")
"""Modules whose functions are another each time without a state that can be kept, and what to do instead."""
_DRAWN = "its random numbers are others in each run; state a seed, default_rng(seed)"
_UNREPEATABLE = _CLOCKS | dict.fromkeys(("secrets", "uuid"), _DRAWN)
_MAKERS = {"default_rng", "RandomState", "Random", "SeedSequence"}
"""Functions that make generators, without an argument from the entropy of the machine."""
_ENTROPY = {"SystemRandom", "urandom"}
"""Functions that have it with any."""
_CACHED = "an entry of the cache"
_RANDOM = "numpy.random", "random"
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
    """Return what all runs of a process share that code may change: as of_classes, caches, random numbers.

    Nothing of code that cannot be loaded, which the run refuses, and nothing of none.
    """
    if not targets:
        return {}
    try:
        kinds = [kind for target in targets for kind in users_kinds(load_function(target, {}))]
        parts = [part for kind in kinds for part in (of_kind(kind), _of_caches(kind))]
    except Exception:  # of a user's module
        return {}
    files = {f"the file {path.name}": file_digest(path) for path in _data(tuple(targets), loads())}
    return {name: content for part in parts for name, content in part.items()} | files | random_numbers()


@functools.lru_cache(maxsize=64)
def _data(targets: tuple[str, ...], _loads: int) -> list[Path]:
    """Return the data files that code of the user's names."""
    return [path for name in targets for path in source_files(name) if path.suffix != ".py"]


def random_numbers() -> Contents:
    """Return the states of the random numbers that belong to nobody."""
    states = {"numpy.random": np.random.get_state(legacy=False), "random": random.getstate()}  # noqa: NPY002
    if torch := sys.modules.get("torch"):
        states["torch"] = torch.get_rng_state().numpy()
    return {f"the random numbers of {name}": content_of(state, {}) for name, state in states.items()}


def _of_caches(kind: Any) -> Contents:
    """Return what functions of a class have cached, entry by entry: of CPython's lru_cache alone."""
    contents = Contents()
    for name, cache in _named_values(kind).items():
        if isinstance(cache, functools._lru_cache_wrapper):
            _, *held = gc.get_referents(cache)
            is_bounded, count = cache.cache_parameters()["maxsize"] is not None, cache.cache_info().currsize
            pairs = zip(held[: 2 * count : 2], held[1 : 2 * count : 2], strict=True)
            for key, value in pairs if is_bounded else held[0].items():
                contents[f"{_CACHED} {name!r} for {key!r}"] = content_of(value, {})
    return contents


def names_random_numbers(kind: Any) -> bool:
    """Return whether functions of a class name a module of random numbers."""
    return "random" in used_names(kind).names


def users_kinds(called: Any) -> Iterator[Any]:
    """Yield a function, or a class and those of the user that it derives from."""
    yield from (kind for kind in getattr(called, "__mro__", (called,)) if not _is_own(kind))


def of_kind(kind: Any) -> Contents:
    """Return the attributes of a class of the user, and what its functions use of the user's modules."""
    used = used_names(kind)
    contents = {
        f"{name!r} of class {each.__qualname__}": part
        for each in (kind, *used.kinds)
        if isinstance(each, type)
        for name, part in _attributes(each)
    }
    for (home, name), module in sorted(used.globals.items(), key=lambda item: item[0]):
        if name in module:
            contents[f"{name!r} of module {home}"] = content_of(module[name], {})
    return contents


def require_no_outside(targets: Iterable[str]) -> None:
    """Refuse laws that name what is another each time: iterators, files, clocks, random numbers, caches.

    Raises:
        TracingError: they do.
    """
    for kind in (kind for target in targets for kind in users_kinds(load_function(target, {}))):
        values, used = _named_values(kind), used_names(kind)
        outside = [name for name, value in values.items() if _is_outside(value)]
        if any(value is np for value in values.values()) and "random" in used.names:
            outside.append("numpy.random")
        if outside := sorted({*outside, *(used.names & _SEES_ALL) - values.keys()}):
            raise TracingError(f"names {', '.join(outside)}, which may be another each time")


def unrepeatable(targets: Iterable[str]) -> list[str]:
    """Return a sentence on each clock and each generator without a seed that functions of laws name."""
    kinds = list[Any]()
    for target in targets:
        with contextlib.suppress(CoopPinError):  # code that is not there: the run has told it
            kinds += users_kinds(load_function(target, {}))
    used = {
        name: _UNREPEATABLE[home]
        for kind in kinds
        for name, value in _named_values(kind).items()
        for home in _homes(value) & _UNREPEATABLE.keys()
    }
    unseeded = {name: _DRAWN for kind in kinds for name in _calls_without_seed(kind)}
    return [f"the code uses {name}: {advice}" for name, advice in sorted((used | unseeded).items())]


def _named_values(kind: Any) -> dict[str, Any]:
    """Return what functions of a class name: globals, attributes, defaults, variables of outer functions."""
    globals_ = used_names(kind).globals.items()
    values = {name: module[name] for (_, name), module in globals_ if name in module} | vars(kind)
    held = {
        f"{name} (a default or a variable of a function around it)": part
        for name, value in values.items()
        for function in functions_of(value)
        for part in (*(function.__defaults__ or ()), *cells_of(function))
    }
    return values | held


def _calls_without_seed(kind: Any) -> Iterator[str]:
    """Yield the makers of generators that functions of a class call without an argument."""
    for code in used_names(kind).code:
        name = ""
        for step in dis.get_instructions(code):
            if step.argval in _ENTROPY:
                yield f"{step.argval}()"
            elif step.argval in _MAKERS:
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


def digest(contents: object) -> str:
    """Return a digest of numbers, texts and classes that is the same in every process."""
    return hashlib.sha256(repr(contents).encode()).hexdigest()


def leaks(before: Contents, targets: Sequence[str]) -> list[str]:
    """Return a sentence on each content that was another before a run: the next one begins with it."""
    after = of_all_runs(targets) if before else {}
    return [
        f"a run changes {name}, which all runs share, so that they depend on their order; keep it in the"
        " state of init and step, and random numbers in a generator of the object, default_rng(seed)"
        for name in changes(before, after)
        if not name.startswith(_CACHED) or name in before.keys() & after.keys()  # a new entry harms nobody
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
    if isinstance(value, contextvars.ContextVar):
        return value.name, content_of(value.get(None), memo)
    if isinstance(value, FunctionType):
        held = value.__defaults__, value.__kwdefaults__, vars(value), [*cells_of(value)]
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
