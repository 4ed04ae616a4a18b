"""The key of a run: a digest of all that determines it."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from coop_pin import __version__
from coop_pin.description.scenario import Scenario
from coop_pin.description.urdf import find_urdf
from coop_pin.errors import CoopPinError
from coop_pin.sweeps.digest import file_digest
from coop_pin.sweeps.user_code import UserCode, user_code


def run_key(scenario: Scenario, metrics: tuple[str, ...] = (), code: tuple[UserCode, ...] | None = None) -> str:
    """Return the key of a run, 64 hexadecimal digits.

    It stands for the resolved scenario with its seed, the contents of the files it names (robot descriptions, tables of poses), the
    source of the user's own code and of what that imports from beside it, the user's own metrics, and the version of coop_pin. It does
    not stand for the source of coop_pin, for files that a xacro or a mesh refers to, or for the versions of other packages.

    Args:
        scenario: the resolved scenario.
        metrics: the user's own metrics, "module:function".
        code: the user's own code as ``user_code`` read it; read now when omitted.
    """
    code = user_code(scenario, metrics) if code is None else code
    content = {"coop_pin": __version__, "scenario": scenario.model_dump_json(), "metrics": list(metrics)}
    files = {name: file_digest(path) for name, path in _files(scenario)}
    return _hash(content | {"files": files, "code": dict(code)})


def unresolved_key(base: Scenario, changes: Mapping[str, Any]) -> str:
    """Return the key of a run whose changes make no scenario: of the scenario as it was, and the changes."""
    return _hash({"coop_pin": __version__, "base": base.model_dump_json(), "changes": dict(changes)})


def _hash(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode()).hexdigest()


def _files(scenario: Scenario) -> Iterator[tuple[str, Path]]:
    """Yield the files that determine a run beside its scenario; one that is missing is left for the run to complain of."""
    for arm in scenario.cell.arms.values():
        if path := _urdf_path(arm.urdf):
            yield arm.urdf, path
    table = getattr(scenario.motion, "path", None)
    if table and Path(table).is_file():
        yield table, Path(table)


@functools.lru_cache(maxsize=256)
def _urdf_path(urdf: str) -> Path | None:
    try:
        return find_urdf(urdf).path
    except CoopPinError:
        return None
