# ruff: noqa: ARG001  (Sphinx fixes the arguments of its callbacks)
"""Generated parts of the site: replays, and options of autodoc."""

import inspect
import json
import re
import shutil
from functools import partial
from pathlib import Path
from typing import Any

from docutils import nodes

import coop_pin
from coop_pin import Scenario, scenario_names
from coop_pin.comparison import Comparison, benchmark_scenario, controllers_for, standard_trials
from coop_pin.comparison.trials import changes_of
from coop_pin.sweeps.heat_map import REPLAYS, replay_file

_NOT_OURS = {"model_config", "model_post_init", "model_fields", "model_computed_fields"}


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


def write_replays(folder: Path, *, is_draft: bool) -> None:
    """Write the replay that a page embeds, those of the gallery, and the explorer with its own.

    Args:
        folder: static files of the site.
        is_draft: one short replay stands for all, which take a third of the time of a site.
    """
    first, replays = folder / "replay.html", folder / REPLAYS
    changes = {"duration": 0.1, "events": ()} if is_draft else {"duration": 12.0}
    coop_pin.viz.save_replay(coop_pin.run("adept-paper", changes, warn=False), first)
    replays.mkdir(parents=True, exist_ok=True)
    shown = {f"{name}.html": partial(coop_pin.run, name, warn=False) for name in scenario_names()}
    shown |= {replay_file([cell]): partial(benchmark_run, *cell) for cell in TELLING}
    for name, run in shown.items():
        if is_draft:
            shutil.copy(first, replays / name)
        else:
            coop_pin.viz.save_replay(run(), replays / name)
    table = Path(__file__).parents[1] / "studies" / "benchmark.csv"
    Comparison.load(table).write_html(folder / "comparison.html")


def _write_replays(app: Any) -> None:
    if app.builder.format == "html":
        write_replays(Path(app.outdir) / "_static", is_draft=app.tags.has("draft"))


def _write_texts(app: Any, problem: Exception | None) -> None:
    """Write the texts of all pages for the excerpts of an offline search."""
    if app.builder.format == "html" and problem is None:
        texts = {}
        for name in sorted(app.env.all_docs):
            page = app.env.get_doctree(name)
            for raw in list(page.findall(nodes.raw)):
                raw.parent.remove(raw)
            texts[name] = " ".join(page.astext().split())
        file = Path(app.outdir) / "_static" / "search_texts.js"
        file.write_text(f"const coopPinTexts = {json.dumps(texts)};\n", encoding="utf-8")


def _search_scripts(app: Any, name: str, template: str, context: Any, page: Any) -> None:
    if name == "search":
        for file in ("search_texts.js", "offline_search.js"):
            app.add_js_file(file)


def setup(app: Any) -> dict[str, bool]:
    """Register the callbacks with Sphinx."""
    app.connect("builder-inited", _write_replays)
    app.connect("build-finished", _write_texts)
    app.connect("html-page-context", _search_scripts)
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-signature", _signature)
    app.connect("autodoc-process-docstring", _constructor, priority=400)  # before napoleon reads the sections
    return {"parallel_read_safe": True}
