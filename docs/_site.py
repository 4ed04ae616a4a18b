"""What the reference leaves out: what pydantic and NamedTuple add to every class."""

from typing import Any

_NOT_OURS = {"model_config", "model_post_init", "model_fields", "model_computed_fields"}


def _skip(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    doc = getattr(obj, "__doc__", None) or ""
    return True if name in _NOT_OURS or doc.startswith("Alias for field number") else None


def setup(app: Any) -> dict[str, bool]:
    app.connect("autodoc-skip-member", _skip)
    return {"parallel_read_safe": True}
