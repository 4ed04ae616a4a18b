"""Names of user-written functions and classes, ``module:name``, and the import of what they name."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable, Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator

from coop_pin.base.errors import FieldError, NameNotFoundError


def _function_name(value: Any) -> Any:
    """Return ``module:function`` for such a text or for a function at the top of a module or notebook."""
    if callable(value):
        module, name = getattr(value, "__module__", ""), getattr(value, "__qualname__", "")
        if not module or not name or "<" in name:
            raise FieldError(
                f"is {value!r}, which has no name to write down; define it with def at the top of a module"
            )
        return f"{module}:{name}"
    if isinstance(value, str):
        module, colon, name = value.partition(":")
        if not (module and colon and name):
            raise FieldError(f"is {value!r}; it must read 'module:function'")
    return value


FunctionName = Annotated[str, BeforeValidator(_function_name)]
"""``module:function``; a function itself is accepted and named."""


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
    """Import the object ``module:name`` of a kind ("function" or "class"); raises NameNotFoundError."""
    module_name, _, path = name.partition(":")
    module = f"module {module_name!r}"
    try:
        value: Any = importlib.import_module(module_name)
    except ImportError as error:
        raise NameNotFoundError("module", module_name, [], f"the Python path ({error})") from None
    for part in path.split("."):
        if not hasattr(value, part):
            public = [entry for entry in dir(value) if not entry.startswith("_")]
            known = [entry for entry in public if is_kind(getattr(value, entry, None))]
            raise NameNotFoundError(kind, path, known, module)
        value = getattr(value, part)
    if not is_kind(value):
        raise NameNotFoundError(kind, path, [], f"{module}: {path} is {value!r}, which is not a {kind}")
    return value
