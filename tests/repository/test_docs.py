"""Documentation agrees with the code: docstrings, code and commands on pages, links, and the built site.

Every test collects all its offenders before it fails.
"""

import ast
import functools
import importlib
import inspect
import itertools
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
import tomllib
import types
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlparse

import numpy as np
import pytest
from browser import browser_page
from built_once import built_once
from linked_cells import box_with_lid
from page_texts import rounds_to
from source_trees import parsed

import coop_pin
from coop_pin.cli.parsing import parse
from coop_pin.comparison import benchmark_scenario

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE, DOCS = Path(coop_pin.__file__).parent, REPOSITORY / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "notebooks" not in path.relative_to(DOCS).parts)

# ---------------------------------------------------------------- docstrings

SECTIONS = r"(?:Args|Attributes|Raises|Returns|Yields|Note|Example)s?:"


def section(docstring, name):
    """The names that a section documents, in order; None without the section."""
    found = re.search(rf"^{name}:\n((?:(?!{SECTIONS}$).*\n?)*)", inspect.cleandoc(docstring), re.MULTILINE)
    if found is None:
        return None
    return [given.lstrip("*") for given in re.findall(r"^ {4}(\*{0,2}\w+):", found[1], re.MULTILINE)]


def classes_and_functions():
    """Every class, function and method of the package: its place, the class around it, its node."""
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in parsed(file).body:
            place = f"{file.relative_to(PACKAGE)}:{getattr(node, 'name', '')}"
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                yield place, None, node
            for entry in node.body if isinstance(node, ast.ClassDef) else ():
                if isinstance(entry, ast.FunctionDef):
                    yield f"{place}.{entry.name}", node, entry


def arguments_of(node, inside_class):
    given = node.args
    kinds = ([*given.posonlyargs, *given.args], [given.vararg], given.kwonlyargs, [given.kwarg])
    names = [argument.arg for argument in itertools.chain(*kinds) if argument]
    static = any(ast.unparse(mark) == "staticmethod" for mark in node.decorator_list)
    return names[1:] if inside_class and not static else names


def test_docstrings_name_the_arguments_of_their_signatures_in_order():
    offenders = []
    for place, owner, node in classes_and_functions():
        told = section(ast.get_docstring(node) or "", "Args")
        if (
            told is not None
            and isinstance(node, ast.FunctionDef)
            and told != arguments_of(node, owner is not None)
        ):
            offenders.append((place, told))
    assert offenders == []


def test_docstrings_of_values_name_all_their_fields():
    """Descriptions and NamedTuples document each field in their docstring, in order, or below the field."""
    offenders = []
    for place, _, node in classes_and_functions():
        bases = {ast.unparse(base) for base in getattr(node, "bases", ())}
        if node.name.startswith("_") or not bases & {"NamedTuple", "Description"}:
            continue
        fields, below = [], []
        for entry, following in itertools.pairwise([*node.body, None]):
            if not isinstance(entry, ast.AnnAssign) or ast.unparse(entry.annotation).startswith("ClassVar"):
                continue
            if not re.match("_|kind$", entry.target.id):
                fields.append(entry.target.id)
                if isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant):
                    below.append(entry.target.id)
        told = [name for name in section(ast.get_docstring(node) or "", "Attributes") or [] if name != "kind"]
        if fields not in (told, below):
            offenders.append((place, fields, told))
    assert offenders == []


def namespaces():
    """Modules with public names: the package itself, and its namespaces."""
    return [
        coop_pin,
        *(module for name in dir(coop_pin) if inspect.ismodule(module := getattr(coop_pin, name))),
    ]


@functools.cache
def public():
    """Every public class and function of the package, by full name."""
    found = {f"{each.__name__}.{name}": getattr(each, name) for each in namespaces() for name in each.__all__}
    return {
        name: thing for name, thing in found.items() if inspect.isclass(thing) or inspect.isfunction(thing)
    }


def ours(thing):
    return inspect.isclass(thing) and thing.__module__.startswith("coop_pin")


def members_of(thing):
    """Public methods and properties that a class defines itself."""
    kinds = (types.FunctionType, classmethod, staticmethod, property, functools.cached_property)
    return {
        name: value
        for name, value in vars(thing).items()
        if isinstance(value, kinds) and not name.startswith("_") and name != "model_post_init"
    }


def docstrings_of(thing):
    """The docstrings of a class and of its constructor, its parents' included."""
    told = [
        part
        for parent in thing.__mro__
        for part in (parent.__doc__, getattr(vars(parent).get("__init__"), "__doc__", None))
    ]
    return "\n".join(inspect.cleandoc(part) for part in told if part)


def constructor_arguments(thing):
    """Arguments of a constructor written here; none of a dataclass, a Protocol or an error."""
    constructor = vars(thing).get("__init__")
    if not inspect.isfunction(constructor) or issubclass(thing, BaseException):
        return []
    written_here = Path(constructor.__code__.co_filename).is_relative_to(PACKAGE)
    return list(inspect.signature(constructor).parameters)[1:] if written_here else []


def attributes_of(thing):
    """Public fields of a class, and what its constructor sets, without those documented below the field."""
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(thing))).body
    found = []
    for entry, following in itertools.pairwise([*node.body, None]):
        below = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
        if isinstance(entry, ast.AnnAssign) and not below and "ClassVar" not in ast.unparse(entry.annotation):
            found.append(entry.target.id)
        if isinstance(entry, ast.FunctionDef) and entry.name == "__init__":
            found += [
                inner.attr
                for inner in ast.walk(entry)
                if isinstance(inner, ast.Attribute)
                and isinstance(inner.ctx, ast.Store)
                and ast.unparse(inner.value) == "self"
            ]
    return [name for name in found if not name.startswith("_") and name != "kind"]


def test_everything_public_is_documented_with_its_arguments_and_attributes():
    offenders = []
    for name, thing in public().items():
        if inspect.isfunction(thing):
            told, needed = inspect.getdoc(thing) or "", list(inspect.signature(thing).parameters)
        else:
            told, needed = docstrings_of(thing), constructor_arguments(thing)
            needed += attributes_of(thing) if ours(thing) else []
            methods = members_of(thing) if ours(thing) else {}
            offenders += [f"{name}.{member}" for member, value in methods.items() if not value.__doc__]
        offenders += [name] if not told else []
        offenders += [
            f"{name}({given})" for given in needed if not re.search(rf"(?<![\w.]){given}(?!\w)", told)
        ]
    assert offenders == []
    assert len(public()) > 100


def test_the_reference_has_a_page_for_every_namespace():
    pages = {page.stem: page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md")}
    documented = set(re.findall(r"^\.\. automodule:: ([\w.]+)$", "\n".join(pages.values()), re.MULTILINE))
    assert {module.__name__ for module in namespaces()} - documented == set()
    assert [name for name in documented if not importlib.import_module(name).__doc__] == []
    assert {*pages} - {"index"} == {
        *re.findall(r"^(\w+)$", pages["index"].split("{toctree}")[1], re.MULTILINE)
    }


# ---------------------------------------------------------------- pages


def anchor(heading):
    """The anchor that a heading gets."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def test_links_and_images_of_pages_lead_somewhere():
    offenders = []
    for page in [REPOSITORY / "README.md", *PAGES]:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"(?<!`)\]\(([^)\s]+)\)", text):
            path, _, heading = target.partition("#")
            file = (page.parent / path).resolve() if path else page
            if "docs/notebooks/" in str(file):
                file = REPOSITORY / "notebooks" / file.name  # copied there when the site is built
            if urlparse(target).scheme:
                continue
            if not file.exists():
                offenders.append((page.name, target))
            elif heading and file.suffix == ".md":
                headings = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE)
                offenders += [(page.name, target)] if heading not in map(anchor, headings) else []
    assert offenders == []


def test_generated_pages_say_what_the_docstrings_say():
    sys.path.insert(0, str(REPOSITORY / "tools"))
    from reference import pages

    outdated = [page.name for page, text in pages().items() if page.read_text(encoding="utf-8") != text]
    assert outdated == [], "python tools/reference.py"


def test_every_image_is_on_a_page_and_has_one_format():
    images = sorted((DOCS / "images").iterdir())
    pages = [REPOSITORY / "README.md", REPOSITORY / "studies" / "README.md", *PAGES]
    shown = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    assert [image.name for image in images if f"images/{image.name})" not in shown] == []
    assert len({image.stem for image in images}) == len(images)


def test_every_page_is_in_a_table_of_contents():
    tables = re.findall(
        r"```\{toctree\}\n(.*?)```", (DOCS / "index.md").read_text(encoding="utf-8"), re.DOTALL
    )
    listed = set(re.findall(r"^([\w/-]+)$", "\n".join(tables), re.MULTILINE))
    pages = {str(page.relative_to(DOCS).with_suffix("")) for page in PAGES if page.parent != DOCS / "api"}
    assert (pages | {"api/index"}) - {"index"} == listed


def blocks(page, language):
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def commands_of(page):
    """The words of every command of a page, without comments."""
    lines = "\n".join(blocks(page, "sh")).replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def missing_names(code):
    """Names of coop_pin that code uses and that do not exist, ``cp.open_view`` included."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Attribute) and re.fullmatch(r"cp(\.\w+)+", ast.unparse(node)):
            thing = coop_pin
            for part in ast.unparse(node).split(".")[1:]:
                if not hasattr(thing, part) and (inspect.ismodule(thing) or inspect.isclass(thing)):
                    yield ast.unparse(node)
                thing = getattr(thing, part, None)
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("coop_pin"):
            module = importlib.import_module(node.module)
            yield from (alias.name for alias in node.names if not hasattr(module, alias.name))


def is_understood(words):
    try:
        return words[0] != "coop-pin" or bool(parse(words[1:]))
    except SystemExit:
        return False


def test_code_and_commands_on_pages_use_what_exists():
    offenders = []
    tests = "\n".join(path.read_text(encoding="utf-8") for path in (REPOSITORY / "tests").rglob("test_*.py"))
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        offenders += [(page.name, name) for code in blocks(page, "python") for name in missing_names(code)]
        for block in blocks(page, "toml"):
            tomllib.loads(block)
        offenders += [(page.name, words) for words in commands_of(page) if not is_understood(words)]
        files = re.findall(r"python (examples/\w+\.py|benchmarks/\w+\.py)", text)
        offenders += [(page.name, name) for name in files if not (REPOSITORY / name).is_file()]
        named = re.findall(r"`(test_\w+)`", text)
        offenders += [(page.name, name) for name in named if f"def {name}(" not in tests]
    assert offenders == []


def test_the_line_for_conda_names_all_requirements_but_pinocchio():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    commands = commands_of(DOCS / "quickstart.md")
    (pip,) = [
        words[2:]
        for words in commands
        if words[:2] == ["pip", "install"] and "example-robot-data" in words[2]
    ]
    assert pip == [
        requirement for requirement in project["dependencies"] if not requirement.startswith("pin>=")
    ]
    (conda,) = [words[-1] for words in commands if words[:2] == ["conda", "install"]]
    (pin,) = set(project["dependencies"]) - set(pip)
    assert conda.removeprefix("pinocchio") == pin.removeprefix("pin").partition(";")[0]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("concepts/control-view.md", marks=pytest.mark.slow),
        "concepts/internal-force.md",
        "concepts/measurements.md",
        pytest.param("concepts/messages.md", marks=pytest.mark.slow),
        pytest.param("concepts/commands.md", marks=pytest.mark.gate),
        pytest.param("howto/arm.md", marks=pytest.mark.slow),
        "howto/doors-lids-beams.md",
        pytest.param("howto/grasps.md", marks=pytest.mark.gate),
        pytest.param("howto/laws.md", marks=pytest.mark.gate),
        "howto/mechanism.md",
        pytest.param("howto/scenario.md", marks=pytest.mark.gate),
        pytest.param("quickstart.md", marks=pytest.mark.gate),
    ],
)
def test_python_on_a_page_runs(name, tmp_path, monkeypatch):
    """One block after the other, pasted into an empty folder."""
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__"}
    exec(compile("\n".join(blocks(DOCS / name, "python")), name, "exec"), names)
    assert any(getattr(value, "__name__", "").startswith("coop_pin") for value in names.values())


def test_the_payload_of_links_on_the_page_runs_and_its_limits_are_named(tmp_path, monkeypatch):
    page = DOCS / "howto" / "doors-lids-beams.md"
    (fields,) = map(tomllib.loads, blocks(page, "toml"))
    (tmp_path / "box_with_lid.urdf").write_text(box_with_lid(), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    scenario = coop_pin.Scenario.load("two-pandas-box", {"duration": 0.01, "motion.start_time": 0.0})
    cell = scenario.model_dump()["cell"]
    cell["grasps"]["right"] |= fields["cell"]["grasps"]["right"]
    scenario = coop_pin.Scenario(
        **scenario.model_dump() | {"cell": cell | fields["cell"] | {"grasps": cell["grasps"]}}
    )
    assert scenario.cell.held_links == {"right": "lid"}
    hinge = scenario.cell.payload.links.joint("hinge")
    assert (hinge.stiffness, hinge.damping) == (1.5, 0.02)
    data = coop_pin.run(scenario, warn=False).data
    names = re.search(r"`payload_joint_position`((?:,| and) `_\w+`)+", page.read_text(encoding="utf-8"))
    assert names is not None
    for name in re.findall(r"`(\w+)`", names[0]):
        assert (name if name.startswith("p") else f"payload_joint{name}") in data
    text = page.read_text(encoding="utf-8").lower()
    assert all(words in text for words in ("no rods of large deflection", "no cloth"))


def test_the_table_of_lengths_is_the_load_on_hinges_of_the_cell():
    text = (DOCS / "howto" / "grasps.md").read_text(encoding="utf-8")
    _, _, table = text.partition("| $l$, m |")
    rows = re.findall(r"^\| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|", table, re.MULTILINE)
    assert len(rows) == 4
    cell = coop_pin.Scenario.load("two-pandas-hinges").cell
    weight = cell.payload.mass * np.array([*cell.gravity, 0.0, 0.0, 0.0])
    for length, *told in rows:
        stated = cell.replace(split_length=float(length))
        for F in stated.loads_within([True, True]) @ weight:
            sizes = np.linalg.norm(F[:2]), np.linalg.norm(F[3:])
            assert all(rounds_to(size, number) for size, number in zip(sizes, told, strict=True))
    assert rows[2][0] == f"{cell.split_length}"


@pytest.mark.parametrize("scenario", ["adept-anchored", "two-pandas-box"])
def test_the_controller_of_the_page_runs_as_a_file(scenario, tmp_path, monkeypatch):
    (code,) = [
        code for code in blocks(DOCS / "howto" / "controller.md", "python") if "(cp.ArmController)" in code
    ]
    module = f"controller_{scenario}".replace("-", "_")  # modules stay imported: each has a name of its own
    (tmp_path / f"{module}.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    cell = benchmark_scenario(coop_pin.Scenario.load(scenario), 0.5)
    law = coop_pin.UserController(target=f"{module}:Law")
    result = coop_pin.run(cell, {"controller": law}, warn=False)
    assert result.simulation_sound, result.verdict()


def sentences(text):
    """Sentences of a page: without code, formulas, tables, markup, targets of links and headings."""
    text = re.sub(r"```.*?```|\$\$.*?\$\$|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"^(#|\||!\[|<).*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"`[^`]*`|\$[^$]*\$", "x", re.sub(r"\]\([^)]*\)", "]", text))
    for paragraph in re.split(r"\n\s*\n|\n\s*(?:-|\d+\.) ", text):
        yield from re.split(r"(?<=[.?!])\s+", " ".join(paragraph.replace("*", "").split()))


GENERATED = [DOCS / "verification.md", DOCS / "fields.md", *(DOCS / "api").glob("*.md")]
RECORDS = r"""\btest_\w+|\bpytest\b|\b(?=[0-9]*[a-f])(?=[a-f]*[0-9])[0-9a-f]{7,40}\b"""
"""Names of tests, and commits: hexadecimal words of letters and digits."""


def test_pages_for_users_name_no_tests_and_no_commits():
    """A claim has its tests on the page of verification."""
    users = [page for page in PAGES if page not in GENERATED]
    offenders = {page.name: re.findall(RECORDS, page.read_text(encoding="utf-8")) for page in users}
    assert {name: records for name, records in offenders.items() if records} == {}
    assert re.findall(RECORDS, "`test_a_claim` at 4e94d81, not 2166136 or defaced") == [
        "test_a_claim",
        "4e94d81",
    ]


@pytest.mark.parametrize(
    "page",
    [REPOSITORY / "README.md", *(page for page in PAGES if page.stem != "verification")],
    ids=lambda page: page.stem,
)
def test_sentences_have_at_most_35_words(page):
    lengths = {
        sentence: sum(bool(re.search(r"\w", word)) for word in sentence.split())
        for sentence in sentences(page.read_text(encoding="utf-8"))
    }
    assert {sentence: length for sentence, length in lengths.items() if length > 35} == {}


MOST_WORDS = 36_000


def test_explanations_and_how_to_pages_are_short():
    """Together, as ``cat docs/concepts/*.md docs/howto/*.md | wc -w`` counts."""
    pages = [page for folder in ("concepts", "howto") for page in (DOCS / folder).glob("*.md")]
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in pages) <= MOST_WORDS


def test_a_release_has_at_most_60_lines_in_the_changelog():
    text = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    _, *releases = re.split(r"^## ", text, flags=re.MULTILINE)
    assert {release.partition("\n")[0]: n for release in releases if (n := release.count("\n")) > 60} == {}
    assert [line for line in text.splitlines() if len(line) > 160] == []
    groups = {"Breaking", "Added", "Changed", "Faster", "Fixed"}
    assert set(re.findall(r"^### (.*)$", text, re.MULTILINE)) <= groups


# ---------------------------------------------------------------- the site


class Page(HTMLParser):
    """What a built page refers to, what it makes a browser load, and its anchors."""

    LOADING = ("src", "srcset", "poster", "data")

    def __init__(self, text):
        super().__init__()
        self.links, self.loaded, self.ids, self.styles = [], [], set(), ""
        self._inside = ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self._inside = tag
        self.ids |= {given[name] for name in ("id", "name") if given.get(name)}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        elif tag == "link" and given.get("rel") != "canonical" and "href" in given:
            self.loaded.append(given["href"])
        self.loaded += [given[name] for name in self.LOADING if given.get(name)]
        self.styles += given.get("style") or ""

    def handle_data(self, data):
        if self._inside == "style":
            self.styles += data


class Site(NamedTuple):
    folder: Path
    warnings: str
    pages: dict[Path, Page]


def build_site(folder, tag, docs=DOCS):
    """As tools/docs.sh does, but for the notebooks, which are run by tests of their own."""
    options = f"-b html -W --keep-going -n -q -t {tag} -D nb_execution_mode=off -d {folder / 'trees'}".split()
    command = [sys.executable, "-m", "sphinx", *options, str(docs), str(folder / "html")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    (folder / "warnings").write_text(done.stderr)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param("draft", marks=pytest.mark.gate),
        pytest.param("full", marks=pytest.mark.slow),
    ],
)
def site(request, tmp_path_factory):
    """All pages; a draft has no pages of source code, and only headings in its tables of contents."""
    pytest.importorskip("sphinx", reason="sphinx is not installed (extra 'docs')")
    build = functools.partial(build_site, tag=request.param)
    folder = built_once(tmp_path_factory, f"site-{request.param}", build)
    files = [path.resolve() for path in (folder / "html").rglob("*.html") if "_static" not in path.parts]
    return Site(
        folder / "html",
        (folder / "warnings").read_text(),
        {path: Page(path.read_text(encoding="utf-8")) for path in files},
    )


SMALL = """# A site of one page

A force $f$ and a motion.

```{eval-rst}
.. automodule:: coop_pin.squeezes
   :members:
   :imported-members:
```
"""


@pytest.mark.slow
def test_a_site_of_one_page_builds_with_the_settings_of_all(tmp_path):
    """With a formula and a part of the reference; its folder is a copy, in which no notebooks stand."""
    pytest.importorskip("sphinx", reason="sphinx is not installed (extra 'docs')")
    docs = tmp_path / "repository" / "docs"
    docs.mkdir(parents=True)
    for name in ("conf.py", "_site.py", "_replays.py"):
        shutil.copy(DOCS / name, docs)
    (docs / "_static").mkdir()
    shutil.copy(DOCS / "_static" / "site.css", docs / "_static")
    (docs.parent / "studies").symlink_to(REPOSITORY / "studies")
    (docs / "index.md").write_text(SMALL)
    build_site(tmp_path, "draft", docs)
    page = Page((tmp_path / "html" / "index.html").read_text(encoding="utf-8"))
    assert (tmp_path / "warnings").read_text() == ""
    assert "coop_pin.squeezes.ConstantSqueeze" in page.ids
    assert [target for target in page.loaded if urlparse(target).netloc] == []
    assert (tmp_path / "html" / "_static" / "replay.html").is_file()


def test_pages_of_source_lead_back_to_anchors_that_there_are(tmp_path, monkeypatch):
    """Also to names under which only others of their module are documented, and to their members."""
    pytest.importorskip("sphinx", reason="sphinx is not installed (extra 'docs')")
    monkeypatch.syspath_prepend(DOCS)
    from _site import mend_back_links

    (tmp_path / "_modules").mkdir()
    back = '<a class="viewcode-back" href="../api.html#{}">[docs]</a>'
    names = {
        "coop_pin.one.Thing": "coop_pin.one.Thing",
        "coop_pin.one.Other": "coop_pin.two.Other",
        "coop_pin.one.Other.part": "coop_pin.two.Other.part",
        "coop_pin.one.gone": "coop_pin.one.gone",
    }
    ids = ("coop_pin.one.Thing", "coop_pin.two.Other", "coop_pin.two.Other.part", "coop_pin.two.deep.AnOther")
    (tmp_path / "api.html").write_text("".join(f'<dt id="{one}">' for one in ids))
    (tmp_path / "_modules" / "m.html").write_text("".join(map(back.format, names)))
    mend_back_links(tmp_path)
    assert (tmp_path / "_modules" / "m.html").read_text() == "".join(map(back.format, names.values()))


FROM_ELSEWHERE = r"""@import\s*(?:url\()?\s*['"]?(?:https?:)?//|url\(\s*['"]?(?:https?:)?//"""
HOST = r"[\w-]+(\.[\w-]+)+(:\d+)?"


def test_the_site_builds_without_warnings(site):
    assert site.warnings == ""
    assert len(site.pages) > 30


def test_the_site_loads_nothing_from_elsewhere(site):
    offenders = []
    for page, found in site.pages.items():
        for target in found.loaded:
            given = urlparse(target)
            here = not given.scheme and not given.netloc and (page.parent / unquote(given.path)).exists()
            offenders += [] if here or given.scheme == "data" else [(page.name, target)]
        offenders += [page.name] if re.search(FROM_ELSEWHERE, found.styles) else []
    styles = (site.folder / "_static").rglob("*.css")
    offenders += [
        style.name for style in styles if re.search(FROM_ELSEWHERE, style.read_text(encoding="utf-8"))
    ]
    assert offenders == []


def test_links_within_the_site_lead_to_a_page_and_an_anchor_and_others_are_well_formed(site):
    offenders, checked = [], 0
    for page, found in site.pages.items():
        for target in found.links:
            given = urlparse(target)
            if given.scheme or given.netloc:
                web = given.scheme in ("https", "http") and re.fullmatch(HOST, given.netloc)
                sound = (web or given.scheme == "mailto") and not re.search(r"\s", target)
            else:
                checked += 1
                file = (page.parent / unquote(given.path)).resolve() if given.path else page
                anchors = site.pages[file].ids if file in site.pages else {unquote(given.fragment)}
                sound = file.exists() and (not given.fragment or unquote(given.fragment) in anchors)
            offenders += [] if sound else [(page.name, target)]
    assert offenders == []
    assert checked > 1000


def test_every_public_name_and_every_member_of_a_public_class_is_on_the_site(site):
    ids = set().union(*(found.ids for found in site.pages.values()))
    offenders = []
    for name, thing in public().items():
        here = [place for place in (name, f"{thing.__module__}.{thing.__qualname__}") if place in ids]
        members = members_of(thing) if here and ours(thing) else ()
        offenders += [] if here else [name]
        offenders += [f"{name}.{member}" for member in members if f"{here[0]}.{member}" not in ids]
    assert offenders == []


def test_a_browser_opens_the_site_from_its_folder_and_asks_nobody_else(site):
    """Formulas are typeset, and no request leaves the folder."""
    asked = []
    with browser_page(offline=True) as page:
        page.on("request", lambda request: asked.append(request.url))
        for name in ("index.html", "concepts/law.html", "api/chain.html", "notebooks/01_your_own_arms.html"):
            page.goto((site.folder / name).as_uri(), wait_until="load")
            if name == "concepts/law.html":
                page.wait_for_selector("mjx-container")
        page.goto(f"{(site.folder / 'search.html').as_uri()}?q=squeeze", wait_until="load")
        page.wait_for_selector("#search-results p.context")  # an excerpt, though no page may read another
    assert asked
    assert {urlparse(url).scheme for url in asked} <= {"file", "data", "blob"}
