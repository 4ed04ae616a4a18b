"""Public names that are loaded on first use: Pinocchio, matplotlib and dask take their time, and nobody needs all of them."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from typing import Any


def load_public(package: str, public: Mapping[str, str], name: str) -> Any:
    """Load a public name of a package and keep it there; what the package's ``__getattr__`` does.

    Args:
        package: the package's full name.
        public: the module that each public name stands in.
        name: the name asked for.

    Raises:
        AttributeError: the package has no such public name.
    """
    if name not in public:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(public[name]), name)
    setattr(sys.modules[package], name, value)
    return value
