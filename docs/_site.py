# ruff: noqa: ARG001  (Sphinx fixes the arguments of its callbacks)
"""What the site makes of the package: a table of the public names, and what the reference leaves out."""

import importlib
import inspect
import re
from typing import Any

import coop_pin

_PLACEHOLDER = "PUBLIC-NAMES"
_NOT_OURS = {"model_config", "model_post_init", "model_fields", "model_computed_fields"}


def public_names() -> str:
    """Return a table of everything in ``coop_pin.__all__``: a link to where it is told, and its first sentence."""
    rows = []
    for name in coop_pin.__all__:
        room = coop_pin._PUBLIC[name]
        first = (
            (inspect.getdoc(getattr(importlib.import_module(room), name)) or "")
            .split("\n\n")[0]
            .replace("\n", " ")
        )
        rows.append(f"| [`cp.{name}`](#{room}.{name}) | {first} |")
    return "\n".join(("| name | what it is |", "| --- | --- |", *rows))


def _fill(app: Any, name: str, source: list[str]) -> None:
    if name == "api/index":
        source[0] = source[0].replace(_PLACEHOLDER, public_names())


def _skip(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    doc = getattr(obj, "__doc__", None) or ""
    return True if name in _NOT_OURS or doc.startswith("Alias for field number") else None


def _signature(
    app: Any, what: str, name: str, obj: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Descriptions show the names of their fields: their types stand below, and those of their validators are nobody's business.

    Names of types inside others, as ``dict[str, ArrayLike]``, show as names too.
    """
    fields = getattr(obj, "model_fields", None) if what == "class" else None
    if fields is not None:
        return f"(*, {', '.join(fields)})", None
    signature, returned = (
        text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in (signature, returned)
    )
    return signature, returned


def _constructor(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Tell how a class is made where the class is told; an inherited constructor is told with its own class."""
    told = getattr(vars(obj).get("__init__"), "__doc__", None) if inspect.isclass(obj) else None
    if told is not None:
        lines += ["", *inspect.cleandoc(told).splitlines(), ""]


def setup(app: Any) -> dict[str, bool]:
    """Join Sphinx."""
    app.connect("source-read", _fill)
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-signature", _signature)
    app.connect("autodoc-process-docstring", _constructor, priority=400)  # before napoleon reads the sections
    return {"parallel_read_safe": True}
