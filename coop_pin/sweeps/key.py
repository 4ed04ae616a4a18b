"""The key of a run: a digest of all that determines it."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from coop_pin import __version__
from coop_pin.description.scenario import Scenario
from coop_pin.description.urdf import find_urdf
from coop_pin.errors import CoopPinError


def run_key(scenario: Scenario, metrics: tuple[str, ...] = ()) -> str:
    """Return the key of a run, 64 hexadecimal digits.

    It stands for the resolved scenario with its seed, the contents of the files it names (robot descriptions, tables of poses, the
    modules of the user's own code), the user's own metrics and the version of coop_pin.
    """
    files = {name: _digest(path) for name, path in _files(scenario, metrics)}
    return _hash({"coop_pin": __version__, "scenario": scenario.model_dump_json(), "files": files, "metrics": list(metrics)})


def unresolved_key(base: Scenario, changes: Mapping[str, Any]) -> str:
    """Return the key of a run whose changes make no scenario: of the scenario as it was, and the changes."""
    return _hash({"coop_pin": __version__, "base": base.model_dump_json(), "changes": dict(changes)})


def _hash(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode()).hexdigest()


def _files(scenario: Scenario, metrics: tuple[str, ...]) -> Iterator[tuple[str, Path]]:
    """Yield the files that determine a run beside its scenario; one that is missing is left for the run to complain of."""
    for arm in scenario.cell.arms.values():
        if path := _urdf_path(arm.urdf):
            yield arm.urdf, path
    table = getattr(scenario.motion, "path", None)
    if table and Path(table).is_file():
        yield table, Path(table)
    users = [getattr(part, "target", None) for part in (scenario.controller, scenario.motion, scenario.squeeze)]
    for name in (*filter(None, users), *metrics):
        if path := _module_path(name.partition(":")[0]):
            yield name, path


@functools.lru_cache(maxsize=256)
def _urdf_path(urdf: str) -> Path | None:
    try:
        return find_urdf(urdf).path
    except CoopPinError:
        return None


@functools.lru_cache(maxsize=256)
def _module_path(module: str) -> Path | None:
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, ValueError):  # ValueError: __main__, which a script has and a notebook has not
        file = getattr(sys.modules.get(module), "__file__", None)
        return Path(file) if file else None
    return Path(spec.origin) if spec and spec.origin and Path(spec.origin).is_file() else None


def _digest(path: Path) -> str:
    about = path.stat()
    return _digest_of(path, about.st_mtime_ns, about.st_size)


@functools.lru_cache(maxsize=256)
def _digest_of(path: Path, changed: int, size: int) -> str:  # noqa: ARG001 they are in the cache's key
    """Return the digest of a file; read again when its time or size says that it changed."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
