# ruff: noqa: ARG001  (Sphinx fixes the arguments of its callbacks)
"""Generated parts of the site: the table of public names, the fields of a scenario, options of autodoc."""

import importlib
import inspect
import json
import re
from pathlib import Path
from typing import Any

import coop_pin
from coop_pin.comparison import Comparison, benchmark_scenario, controllers_for, standard_trials
from coop_pin.comparison.trials import changes_of
from coop_pin.description import Payload, Scenario, scenario_names
from coop_pin.heat_map import REPLAYS, replay_file
from coop_pin.schema.base import Description
from coop_pin.schema.meanings import described, meanings, section

_NOT_OURS = {"model_config", "model_post_init", "model_fields", "model_computed_fields"}


def public_names() -> str:
    """Return a table of ``coop_pin.__all__``: links into the reference, and first sentences."""
    rows = []
    for name in coop_pin.__all__:
        package = coop_pin._PUBLIC[name]
        first = _first_paragraph(getattr(importlib.import_module(package), name))
        rows.append(f"| [`cp.{name}`](#{package}.{name}) | {first} |")
    return "\n".join(("| name | description |", "| --- | --- |", *rows))


def scenario_fields() -> str:
    """Return the fields of a scenario, of all classes in it and of all their kinds, as Markdown."""
    groups: dict[str, list[Any]] = {"scenario": [Scenario]}
    classes = [Scenario]
    for model in classes:
        for name, field in model.model_fields.items():
            for inner in described(field.annotation):
                if inner not in classes:
                    classes.append(inner)
                    groups.setdefault(name, []).append(inner)
    titles = {
        model: group[0].__name__ if len(group) == 1 else name.replace("_", " ").capitalize()
        for name, group in groups.items()
        for model in group
    }
    lines = []
    for group in groups.values():
        lines.append(f"## {titles[group[0]]}")
        for model in group:
            kind = model.model_fields.get("kind")
            heading = f'`kind = "{kind.default}"`' if kind is not None else model.__name__
            lines += [f"### {heading}"] * (len(group) > 1)
            package = coop_pin._PUBLIC.get(model.__name__)
            name = (
                f"[`cp.{model.__name__}`](#{package}.{model.__name__})" if package else f"`{model.__name__}`"
            )
            lines += [f"{name}: {_plain(_first_paragraph(model))}", _field_table(model, titles)]
            lines += _payload_kinds() if model is Payload else []
    return "\n\n".join(lines)


def _field_table(model: Any, titles: dict[Any, str]) -> str:
    rows, texts = [], meanings(model)
    for name, field in model.model_fields.items():
        if name == "kind":
            continue
        inner = dict.fromkeys(titles[part] for part in described(field.annotation))
        links = "".join(f" See [{title}](#{title.lower().replace(' ', '-')})." for title in inner)
        value = "required" if field.is_required() else _value(field.get_default(call_default_factory=True))
        rows.append(f"| `{name}` | {value} | {_plain(texts.get(name, ''))}{links} |")
    return (
        "\n".join(("| field | default | meaning |", "| --- | --- | --- |", *rows)) if rows else "No fields."
    )


def _payload_kinds() -> list[str]:
    """Return the kinds from which a payload can be made: its constructors and their arguments."""
    lines = ["A payload can also be made from one of these kinds."]
    for name, method in vars(Payload).items():
        if not isinstance(method, classmethod) or name.startswith("_"):
            continue
        texts = section(method.__doc__ or "", "Args")
        rows = ["| field | default | meaning |", "| --- | --- | --- |"]
        for argument in inspect.signature(getattr(Payload, name)).parameters.values():
            value = "required" if argument.default is argument.empty else _value(argument.default)
            rows.append(f"| `{argument.name}` | {value} | {_plain(texts.get(argument.name, ''))} |")
        lines += [
            f'### `kind = "{name.removeprefix("from_")}"`',
            _plain(_first_paragraph(method).removeprefix("Return ")),
        ]
        lines.append("\n".join(rows))
    return lines


def _value(default: Any) -> str:
    """Return a default as written in a scenario file."""
    if default is None:
        return "omitted"
    if isinstance(default, Description):
        return f'`kind = "{default.kind}"`' if hasattr(default, "kind") else "its defaults"
    return f"`{json.dumps(default)}`"


def _first_paragraph(thing: Any) -> str:
    return (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ")


def _plain(text: str) -> str:
    """Return the text of a docstring with the characters escaped that mean something else in Markdown."""
    return re.sub(r"([|$<])", r"\\\1", text)


_GENERATED = {
    "api/index": ("PUBLIC-NAMES", public_names),
    "fields": ("SCENARIO-FIELDS", scenario_fields),
}
"""Placeholder of a page, and the function that returns its text."""


def _fill(app: Any, name: str, source: list[str]) -> None:
    if name in _GENERATED:
        placeholder, text = _GENERATED[name]
        source[0] = source[0].replace(placeholder, text())


def _skip(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    doc = getattr(obj, "__doc__", None) or ""
    return True if name in _NOT_OURS or doc.startswith("Alias for field number") else None


def _signature(
    app: Any, what: str, name: str, obj: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Return the signature of a configuration class as the names of its fields; types are listed below it.

    Names of types inside others, as in ``dict[str, ArrayLike]``, are shown as names, too.
    """
    fields = getattr(obj, "model_fields", None) if what == "class" else None
    if fields is not None:
        return f"(*, {', '.join(fields)})", None
    signature, returned = (
        text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in (signature, returned)
    )
    return signature, returned


def _constructor(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Add the docstring of a class's own constructor to that of the class."""
    texts = getattr(vars(obj).get("__init__"), "__doc__", None) if inspect.isclass(obj) else None
    if texts is not None:
        lines += ["", *inspect.cleandoc(texts).splitlines(), ""]


TELLING = (
    *(("adept-anchored", law, "bias 1 mm") for law in ("printed", "zeroed-leaky", "anchored")),
    *(
        ("two-pandas-box", law, "bias 1 mm")
        for law in ("printed", "computed-torque", "mean-pose", "anchored")
    ),
    *(("two-pandas-box", "anchored", trial) for trial in ("push", "torque of an arm lost")),
    *(("three-ur5-plate", law, "bias 1 mm") for law in ("leader-follower", "anchored")),
    ("panda-ur5-bar", "anchored", "wrist lost at half time"),
)
"""Cells of the comparison whose replays the site has: scenario, controller, trial."""


def benchmark_run(scenario: str, controller: str, trial: str) -> coop_pin.RunResult:
    """Return the run of a cell of the benchmark, with its stored gains."""
    base = benchmark_scenario(Scenario.load(scenario))
    law = controllers_for(base, [controller])[controller]
    return coop_pin.run(base, changes_of(base, standard_trials(base)[trial], law), warn=False)


def write_replays(folder: Path, **changes: Any) -> None:
    """Write the replay that a page embeds, those of the gallery, and the explorer with its own.

    Args:
        folder: static files of the site.
        changes: changes of all runs but the first, for a draft.
    """
    coop_pin.viz.save_replay(coop_pin.run("adept-paper", {"duration": 12.0}), folder / "replay.html")
    replays = folder / REPLAYS
    replays.mkdir(parents=True, exist_ok=True)
    for name in scenario_names():
        coop_pin.viz.save_replay(coop_pin.run(name, changes, warn=False), replays / f"{name}.html")
    for cell in TELLING:
        # A draft takes the cell's own trial: what fails later in a trial is not in its short runs.
        result = coop_pin.run(cell[0], changes, warn=False) if changes else benchmark_run(*cell)
        coop_pin.viz.save_replay(result, replays / replay_file([cell]))
    table = Path(__file__).parents[1] / "studies" / "benchmark.csv"
    Comparison.load(table).write_html(folder / "comparison.html")


def _write_replays(app: Any) -> None:
    if app.builder.format == "html":
        short = {"duration": 0.1, "events": ()} if app.tags.has("draft") else {}
        write_replays(Path(app.outdir) / "_static", **short)


def setup(app: Any) -> dict[str, bool]:
    """Register the callbacks with Sphinx."""
    app.connect("builder-inited", _write_replays)
    app.connect("source-read", _fill)
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-signature", _signature)
    app.connect("autodoc-process-docstring", _constructor, priority=400)  # before napoleon reads the sections
    return {"parallel_read_safe": True}
