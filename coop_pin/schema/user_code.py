"""Names of user-written functions, ``module:function``, and the import of what they name."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable, Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator

from coop_pin.errors import EntryNotFoundError, FieldError


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
        options: its keyword arguments.

    Raises:
        EntryNotFoundError: there is no such module or function.
    """
    module_name, _, path = name.partition(":")
    try:
        found: Any = importlib.import_module(module_name)
    except ImportError as error:
        raise EntryNotFoundError("module", module_name, [], f"the Python path ({error})") from None
    for part in path.split("."):
        if not hasattr(found, part):
            known = [entry for entry in dir(found) if not entry.startswith("_")]
            raise EntryNotFoundError("function", path, known, f"module {module_name!r}")
        found = getattr(found, part)
    if not callable(found):
        raise EntryNotFoundError(
            "function", path, [], f"module {module_name!r}: {path} is {found!r}, which cannot be called"
        )
    return functools.partial(found, **options) if options else found
