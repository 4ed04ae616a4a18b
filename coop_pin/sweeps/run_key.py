"""Key of a stored run: a digest of its scenario, the files that it reads and the user's code that it runs."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from coop_pin import __version__
from coop_pin.base.errors import CodeChangedError, CoopPinError, ScenarioError
from coop_pin.base.loaded_code import edited_files, loaded_digests, loads, old_users
from coop_pin.base.schema.parts import Pattern, fields_of
from coop_pin.base.schema.user_code import code_of, require_allowed
from coop_pin.base.source_code import code_digests, file_digest, source_files
from coop_pin.description.scenario import Scenario
from coop_pin.description.urdf import find_urdf
from coop_pin.sweeps.plan import Point, SweepPlan
from coop_pin.sweeps.template import Number, Template, Templates

Code = tuple[tuple[str, tuple[str, ...]], ...]
"""Names of a user's functions and classes, "module:name", and the digests of the source files of each."""


def code_for(
    scenario: Scenario, metrics: tuple[str, ...], digests: Callable[[str], tuple[str, ...]] = code_digests
) -> Code:
    """Return the user's code that a run needs, each name once, with the digests of its files.

    Raises:
        CodeRefusedError: code may not be named.
    """
    names = dict.fromkeys([*code_of(scenario), *metrics])
    require_allowed(names)
    return tuple((name, digests(name)) for name in names)


def require_unchanged(code: Code) -> None:
    """Require that this process has loaded code as it was when a run's key was made.

    Python loads a module once: after an edit, a process or worker that is still running would store results
    of the old code under the key of the new code.

    Raises:
        CodeChangedError: this process has loaded other code.
    """
    _require_loaded(code, loads())


@functools.lru_cache(maxsize=64)
def _require_loaded(code: Code, _loads: int) -> None:
    """Require code of what this process has loaded, once until it loads more; raises CodeChangedError."""
    for name, digests in code:
        if loaded_digests(name) != digests or old_users(source_files(name)):
            raise CodeChangedError(name, edited_files(name))


# ---------------------------------------------------------------- keys


def run_key(
    scenario: Scenario,
    metrics: tuple[str, ...] = (),
    code: Code | None = None,
    digest: Callable[[Path], str] = file_digest,
    *,
    engine: str = "pinocchio",
) -> str:
    """Return the key of a run, 64 hexadecimal digits.

    The key covers the resolved scenario, the contents of the files that it names (robot descriptions, tables
    of poses, what options of the user's code name), the source of the user's code with the local modules that
    it imports, the names of the user's metrics, and the version of coop_pin. It does not cover the source of
    coop_pin, files that a xacro or a mesh refers to, or the versions of other packages.

    Args:
        scenario: the resolved scenario.
        metrics: the user's metrics, "module:function".
        code: digests of the user's code; computed when omitted.
        digest: ``file_digest``, or one that remembers.
        engine: engine of the plan; compiled runs differ from those of Pinocchio by rounding.
    """
    if code is None:
        code = code_for(scenario, metrics)
    content = _content(scenario, metrics, code, digest, engine)
    return _hash(content | {"scenario": scenario.model_dump_json()})


def _content(
    scenario: Scenario,
    metrics: tuple[str, ...],
    code: Code,
    digest: Callable[[Path], str],
    engine: str,
) -> dict[str, Any]:
    """Return what the key of a run covers besides the scenario; see run_key."""
    files = {name: digest(path) for name, path in _files(scenario)}
    named = {} if engine == "pinocchio" else {"engine": engine}
    content = {"coop_pin": __version__, "metrics": list(metrics)}
    return content | {"files": files, "code": dict(code)} | named


def unresolved_key(base: Scenario, changes: Mapping[str, Any]) -> str:
    """Return the key of a run whose changed scenario has mistakes: of the base scenario and the changes."""
    content = {"coop_pin": __version__, "base": base.model_dump_json()}
    return _hash(content | {"changes": dict(changes)})


def _hash(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(_json(content).encode()).hexdigest()


def _json(content: Mapping[str, Any]) -> str:
    return json.dumps(content, sort_keys=True, default=repr)


def _files(scenario: Scenario) -> Iterator[tuple[str, Path]]:
    """Yield the files that a scenario names; a missing one is skipped, since the run reports it."""
    for arm in scenario.cell.arms.values():
        with contextlib.suppress(CoopPinError):
            yield arm.urdf, _urdf_path(arm.urdf)
    table = fields_of(scenario.motion).get("path", "")
    options = _texts([getattr(part, "options", ()) for part in vars(scenario).values()])
    yield from ((text, Path(text)) for text in (table, *options) if os.path.isfile(text))  # noqa: PTH113  any text


def _texts(options: Any) -> Iterator[str]:
    """Yield the texts in the options of a user's code, of which some may name files."""
    for part in options.values() if isinstance(options, Mapping) else options:
        if isinstance(part, str):
            yield part
        elif isinstance(part, Mapping | Sequence):
            yield from _texts(part)


@functools.lru_cache(maxsize=256)
def _urdf_path(urdf: str) -> Path:
    return find_urdf(urdf).path


class KeyedPoint(NamedTuple):
    """One run of a plan and its key.

    Attributes:
        point: the run.
        key: key of the run, by ``run_key`` or ``unresolved_key``.
        example: scenario of the run, with a pattern that of another run; the error if it has mistakes.
        code: digests of the user's code that the key covers.
        pattern: pattern of the scenario, if it is one of several that differ in plain numbers.
        numbers: numbers of the run in the pattern.
    """

    point: Point
    key: str
    example: Scenario | ScenarioError
    code: Code = ()
    pattern: Pattern | None = None
    numbers: tuple[float, ...] = ()


class _KeyTemplate:
    """Keys of the runs of a template: its JSON is hashed up to their first number once."""

    def __init__(self, template: Template, content: dict[str, Any]) -> None:
        """Hash what the runs share; ``content`` is what their keys cover besides the scenario."""
        whole = _json(content | {"scenario": "\0".join(template.texts)})
        before, *self._texts = whole.encode().split(json.dumps("\0")[1:-1].encode())
        self._begun = hashlib.sha256(before)

    def key(self, numbers: Sequence[Number]) -> str:
        """Return the key of a run, as run_key does."""
        digest = self._begun.copy()
        for number, text in zip(numbers, self._texts, strict=True):
            digest.update(number.text + text)
        return digest.hexdigest()


def keyed_points(plan: SweepPlan, runs: Iterable[int] | None = None) -> Iterator[KeyedPoint]:
    """Yield points of a plan, all without numbers, with their keys; every file is looked at once."""
    digests, digest = functools.cache(code_digests), functools.cache(file_digest)
    engine, metrics, templates = plan.engine, plan.metrics, Templates(plan)

    @functools.lru_cache(1)
    def shared(template: Template) -> tuple[_KeyTemplate, Code]:
        first = template.pattern.first
        code = code_for(first, metrics, digests)
        content = _content(first, metrics, code, digest, engine)
        return _KeyTemplate(template, content), code

    for point in plan.points(runs):
        template = templates.of(point)
        if template is not None and (values := template.numbers(point.changes)) is not None:
            keys, code = shared(template)
            numbers = tuple([number.value for number in values])
            pattern = template.pattern
            yield KeyedPoint(point, keys.key(values), pattern.first, code, pattern, numbers)
            continue
        scenario = plan.resolved(point)
        if isinstance(scenario, ScenarioError):
            yield KeyedPoint(point, unresolved_key(plan.base[point.base], point.changes), scenario)
            continue
        code = code_for(scenario, metrics, digests)
        key = run_key(scenario, metrics, code, digest, engine=engine)
        yield KeyedPoint(point, key, scenario, code)
