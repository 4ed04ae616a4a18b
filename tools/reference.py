"""Write fields of a scenario, public names, and claims with their tests into the pages of the documentation.

    python tools/reference.py

The pages can be read as they are in a clone; the built site adds signatures and whole docstrings below.
"""

from __future__ import annotations

import importlib
import inspect
import json
import re
import sys
from pathlib import Path
from typing import Any

import coop_pin
from coop_pin import Payload, Scenario
from coop_pin.base.schema.base import Description
from coop_pin.base.schema.meanings import described, meanings, section

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY / "studies"))
sys.path.insert(0, str(REPOSITORY / "tools"))
import claims  # noqa: E402
from pages import with_block  # noqa: E402

DOCS = REPOSITORY / "docs"
NAMESPACES = {name: value for name in dir(coop_pin) if inspect.ismodule(value := getattr(coop_pin, name))}


def pages() -> dict[Path, str]:
    """Return the generated pages, as they should be."""
    texts = {
        DOCS / "fields.md": ("fields", scenario_fields()),
        DOCS / "api" / "index.md": ("names", namespaces()),
        DOCS / "verification.md": ("claims", claims.table(claims.read(), claims.places())),
    }
    for page in sorted((DOCS / "api").glob("*.md")):
        if modules := re.findall(r"automodule:: (\S+)", page.read_text(encoding="utf-8")):
            texts[page] = "names", _table(entry for module in modules for entry in _names(module))
    return {page: with_block(page.read_text(encoding="utf-8"), *block) for page, block in texts.items()}


def namespaces() -> str:
    """Return a table of the namespaces: links to their pages, first sentences, and names."""
    lines = ["| namespace | description | names |", "| --- | --- | --- |"]
    for name, module in {
        "cp": coop_pin,
        **{f"cp.{name}": module for name, module in NAMESPACES.items()},
    }.items():
        text = "What most scripts need." if module is coop_pin else _plain(_first_paragraph(module))
        names = ", ".join(f"`{one}`" for one in module.__all__)
        lines.append(f"| [`{name}`]({name.removeprefix('cp.')}.md) | {text} | {names} |")
    return "\n".join(lines)


def _names(module: str) -> list[tuple[str, Any]]:
    """Return the public classes and functions of a package or module, by name."""
    things = vars(importlib.import_module(module))
    names = things.get("__all__") or [
        name
        for name, thing in things.items()
        if getattr(thing, "__module__", "") == module and name[0] != "_"
    ]
    found = [(f"`{name}`", getattr(sys.modules[module], name)) for name in sorted(names)]
    return [(name, thing) for name, thing in found if inspect.isclass(thing) or inspect.isroutine(thing)]


def _table(entries: Any) -> str:
    rows = (f"| {name} | {_plain(_first_paragraph(thing))} |" for name, thing in entries)
    return "\n".join(("| name | description |", "| --- | --- |", *rows))


def _linked(name: str) -> str:
    """Return a link to the page of a public name; of another, the name."""
    if name in coop_pin.__all__:
        return f"[`cp.{name}`](api/cp.md)"
    for space, module in NAMESPACES.items():
        if name in module.__all__:
            return f"[`cp.{space}.{name}`](api/{space}.md)"
    return f"`{name}`"


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
            text = f"{_linked(model.__name__)}: {_plain(_first_paragraph(model))}"
            lines += [text, _field_table(model, titles)]
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


def main() -> None:
    """Write the pages."""
    for page, text in pages().items():
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
