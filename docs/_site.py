# ruff: noqa: ARG001  (Sphinx fixes the arguments of its callbacks)
"""Generated parts of the site: replays, and options of autodoc."""

import inspect
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import _replays
from _replays import write_drafts, write_explorer
from docutils import nodes
from sphinx.errors import ExtensionError

from coop_pin.sweeps.heat_map import REPLAYS

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


def _start_replays(app: Any) -> None:
    """Start the process that writes the replays while Sphinx reads and writes pages; drafts need none."""
    static = Path(app.outdir) / "_static"
    if app.builder.format != "html":
        return
    (static / REPLAYS).mkdir(parents=True, exist_ok=True)
    if app.tags.has("draft"):
        write_drafts(static)
        write_explorer(static)
        return
    cache = Path(app.config.nb_execution_cache_path).parent / "replays"
    app.replays = subprocess.Popen([sys.executable, _replays.__file__, str(static), str(cache)])


def _await_replays(app: Any, problem: Exception | None) -> None:
    """Wait for the replays; a page without its replay fails the build."""
    process = getattr(app, "replays", None)
    if process is None:
        return
    if problem is not None:
        process.terminate()
    if process.wait() != 0 and problem is None:
        raise ExtensionError("the replays could not be written: their messages are above")


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


_BACK = re.compile(r'(class="viewcode-back" href=")([^"#]+)#([^"]+)"')


def mend_back_links(folder: Path) -> None:
    """Lead the links from pages of source back to the anchors that there are.

    Sphinx writes those of a module by the first name under which something of it is documented; others of it
    are documented under other names.

    Args:
        folder: the built site.
    """
    ids: dict[Path, set[str]] = {}
    for page in sorted((folder / "_modules").rglob("*.html")):

        def mended(link: re.Match[str], page: Path = page) -> str:
            target = (page.parent / link[2]).resolve()
            if target not in ids:
                ids[target] = set(re.findall(r'\bid="([^"]+)"', target.read_text(encoding="utf-8")))
            return f'{link[1]}{link[2]}#{_anchor(link[3], ids[target])}"'

        text = page.read_text(encoding="utf-8")
        page.write_text(_BACK.sub(mended, text), encoding="utf-8")


def _anchor(name: str, ids: set[str]) -> str:
    """Return the anchor of a name, or else the shortest of those that share most of its end."""
    parts = name.split(".")
    for start in range(len(parts)):
        ends = (".".join(parts[start:]), "." + ".".join(parts[start:]))
        anchors = [one for one in ids if one == ends[0] or one.endswith(ends[1])]
        if anchors:
            return min(anchors, key=len)
    return name


def _mend_back_links(app: Any, problem: Exception | None) -> None:
    if app.builder.format == "html" and problem is None:
        mend_back_links(Path(app.outdir))


def _search_scripts(app: Any, name: str, template: str, context: Any, page: Any) -> None:
    if name == "search":
        for file in ("search_texts.js", "offline_search.js"):
            app.add_js_file(file)


def setup(app: Any) -> dict[str, bool]:
    """Register the callbacks with Sphinx."""
    app.connect("builder-inited", _start_replays)
    app.connect("build-finished", _await_replays)
    app.connect("build-finished", _write_texts)
    app.connect("build-finished", _mend_back_links)
    app.connect("html-page-context", _search_scripts)
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-signature", _signature)
    app.connect("autodoc-process-docstring", _constructor, priority=400)  # before napoleon reads the sections
    return {"parallel_read_safe": True}
