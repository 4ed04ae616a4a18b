"""Names of user-written functions and classes, ``module:name``: who may name what, and the import of it.

A name may stand in a file of somebody else. Python runs a module that it imports, and a motion calls its
function with the options that stand beside it. A name is therefore taken only of

- a file below the working folder, or in the folder of the script that runs,
- a module of the user's own that the process has imported already,
- coop_pin itself,
- a module or package that the environment variable COOP_PIN_ALLOW_CODE lists.

Functions and classes that a script passes as objects are of the script, wherever they are defined.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Annotated, Any, get_args

from pydantic import BaseModel, BeforeValidator

from coop_pin.base.errors import CodeRefusedError, FieldError, NameNotFoundError, is_users_file
from coop_pin.base.schema.parts import fields_of

ALLOWED = "COOP_PIN_ALLOW_CODE"
"""Environment variable: modules and packages, separated by commas, whose code a scenario may name."""
_OF_USER = ("__main__", "__mp_main__", "coop_pin")
"""Modules that are never looked for: the script that runs, as a worker of multiprocessing names it, too."""

_accepted: dict[str, bool] = {}
"""Names that this process may use: passed as objects, sent with the jobs of a sweep, or loaded before; and
whether they are loaded."""


def _function_name(value: Any) -> Any:
    """Return ``module:function`` for such a text or for a function at the top of a module or notebook."""
    if callable(value):
        module, name = getattr(value, "__module__", ""), getattr(value, "__qualname__", "")
        if not module or not name or "<" in name:
            raise FieldError(
                f"is {value!r}, which has no name to write down; define it with def at the top of a module"
            )
        accept_code([f"{module}:{name}"])
        return f"{module}:{name}"
    if isinstance(value, str):
        module, colon, name = value.partition(":")
        if not (module and colon and name):
            raise FieldError(f"is {value!r}; it must read 'module:function'")
    return value


FunctionName = Annotated[str, BeforeValidator(_function_name)]
"""``module:function``; a function itself is accepted and named."""


_IS_NAME = get_args(FunctionName)[1]


@functools.cache
def _name_fields(kind: type[BaseModel]) -> frozenset[str]:
    """Return the fields of a class that hold such names."""
    fields = kind.model_fields.items()
    return frozenset(
        name
        for name, field in fields
        if _IS_NAME in field.metadata or FunctionName in get_args(field.annotation)
    )


def code_named(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield the path and the name, "module:name", of all code that a value and its parts name.

    Args:
        value: a configuration value, or a table or tuple of them.
        path: dotted path of the value.
    """
    parts: Mapping[Any, Any] = {}
    names = frozenset[str]()
    if isinstance(value, BaseModel):
        parts, names = fields_of(value), _name_fields(type(value))
    elif isinstance(value, Mapping):
        parts = value
    elif isinstance(value, tuple):
        parts = dict(enumerate(value))
    for field, part in parts.items():
        below = f"{path}.{field}".lstrip(".")
        if field in names:
            yield from ((below, name) for name in ((part,) if isinstance(part, str) else part or ()))
        elif isinstance(part, BaseModel | Mapping | tuple):
            yield from code_named(part, below)


def code_of(value: Any) -> tuple[str, ...]:
    """Return the names, "module:name", of all code that a configuration value names, each once."""
    return tuple(dict.fromkeys(name for _, name in code_named(value)))


def accept_code(names: Iterable[str]) -> None:
    """Let this process use names of code that its user, or the process that sent them, has passed."""
    for name in names:
        _accepted.setdefault(name, False)


def require_allowed(names: Iterable[str]) -> None:
    """Require that code, "module:name", may be named: see the module's text. Nothing is imported.

    Raises:
        CodeRefusedError: one of the modules is neither the user's nor listed.
    """
    for name in names:
        module = name.partition(":")[0].partition(".")[0]
        if not (name in _accepted or module in (*_OF_USER, *_listed()) or _is_users_module(module)):
            remedy = f"list it if you trust it: --allow-code {module}, or {ALLOWED}={module}"
            detail = f"of the module {module!r}, which is no file below the working folder; {remedy}"
            raise CodeRefusedError(name, f"{detail}, or pass the object itself in Python")


def _listed() -> list[str]:
    return os.environ.get(ALLOWED, "").replace(",", " ").split()


def _is_users_module(top: str) -> bool:
    """Return whether a module at the top is the user's: loaded, or in a folder of his; or is not there."""
    try:
        spec = importlib.util.find_spec(top)
    except ValueError:  # made by hand, as in a notebook
        return True
    if spec is None:  # whose import says so
        return True
    origin = [spec.origin] if spec.origin and spec.has_location else spec.submodule_search_locations or ()
    files = [Path(entry).resolve() for entry in origin]
    script = Path(getattr(sys.modules["__main__"], "__file__", None) or "")
    folders = [Path.cwd(), *([script.resolve().parent] if script.suffix == ".py" else [])]
    is_here = top in sys.modules or all(any(map(file.is_relative_to, folders)) for file in files)
    return bool(files) and is_here and all(map(is_users_file, map(str, files)))


def load_function(name: str, options: Mapping[str, Any]) -> Callable[..., Any]:
    """Return the function of a name with its options bound to it.

    Args:
        name: ``module:function``.
        options: keyword arguments of the function.

    Raises:
        NameNotFoundError: there is no such module or function.
    """
    function = _load(name, "function", callable)
    return functools.partial(function, **options) if options else function


def load_class(name: str) -> type[Any]:
    """Return the class of a name.

    Args:
        name: ``module:Class``.

    Raises:
        NameNotFoundError: there is no such module or class.
    """
    return _load(name, "class", lambda value: isinstance(value, type))


def _load(name: str, kind: str, is_kind: Callable[[Any], bool]) -> Any:
    """Import the object ``module:name`` of a kind, "function" or "class".

    Raises:
        CodeRefusedError: the module, or that of the object, may not be named.
        NameNotFoundError: there is no such module or object.
    """
    module_name, _, path = name.partition(":")
    alone = " of this process; put it into a module (a file of its own), which others can import, too"
    module = f"module {module_name!r}{alone * (module_name == '__main__')}"
    require_allowed([name])
    try:
        value: Any = importlib.import_module(module_name)
    except ImportError as error:
        raise NameNotFoundError("module", module_name, [], f"the Python path ({error})") from None
    for part in path.split("."):
        if isinstance(value, ModuleType):
            require_allowed([f"{value.__name__}:{part}"] if value.__name__ != module_name else [])
        if not hasattr(value, part):
            public = [entry for entry in dir(value) if not entry.startswith("_")]
            known = [entry for entry in public if is_kind(getattr(value, entry, None))]
            raise NameNotFoundError(kind, path, known, module)
        value = getattr(value, part)
    if not is_kind(value):
        raise NameNotFoundError(kind, path, [], f"{module}: {path} is {value!r}, which is not a {kind}")
    if not _accepted.get(name):
        if isinstance(value, type | FunctionType | BuiltinFunctionType | MethodType) and value.__module__:
            require_allowed(
                [f"{value.__module__}:{value.__qualname__}"]
            )  # also where it is imported by others
        _accepted[name] = True
    return value
