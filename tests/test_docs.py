"""What is written agrees with what is there: docstrings with signatures, the site with the package, links with their targets."""

import ast
import functools
import importlib
import importlib.util
import inspect
import itertools
import re
import subprocess
import sys
import textwrap
import tomllib
import types
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlparse

import pytest
from browser import browser_page
from built_once import built_once

import coop_pin
from coop_pin.cli.parsing import parse

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGE, DOCS = Path(coop_pin.__file__).parent, REPOSITORY / "docs"
FILES = sorted(PACKAGE.rglob("*.py"))
PAGES = sorted(path for path in DOCS.rglob("*.md") if "notebooks" not in path.relative_to(DOCS).parts)

# ---------------------------------------------------------------- docstrings

SECTIONS = r"(?:Args|Attributes|Raises|Returns|Yields|Note|Example)s?:"


def section(docstring, name):
    """The names that a section tells, in order; None without the section."""
    found = re.search(rf"^{name}:\n((?:(?!{SECTIONS}$).*\n?)*)", inspect.cleandoc(docstring), re.MULTILINE)
    return (
        None
        if found is None
        else [given.lstrip("*") for given in re.findall(r"^ {4}(\*{0,2}\w+):", found[1], re.MULTILINE)]
    )


def functions_of(file):
    """Every function and method, with the class that it stands in."""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef):
            yield None, node
        if isinstance(node, ast.ClassDef):
            yield from ((node, entry) for entry in node.body if isinstance(entry, ast.FunctionDef))


def arguments_of(node, inside_class):
    given = node.args
    names = [
        argument.arg
        for argument in (
            *given.posonlyargs,
            *given.args,
            *([given.vararg] if given.vararg else []),
            *given.kwonlyargs,
        )
    ]
    names += [given.kwarg.arg] if given.kwarg else []
    static = any(isinstance(mark, ast.Name) and mark.id == "staticmethod" for mark in node.decorator_list)
    return names[1:] if inside_class and not static else names


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_a_docstring_names_the_arguments_of_its_signature_in_their_order(file):
    for owner, node in functions_of(file):
        told = section(ast.get_docstring(node) or "", "Args")
        if told is not None:
            assert told == arguments_of(node, owner is not None), (
                f"{owner.name + '.' if owner else ''}{node.name}"
            )


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_a_docstring_of_a_value_names_all_its_fields_and_no_other(file):
    """Descriptions and NamedTuples tell each field in their docstring, in order, or in a docstring of the field's own."""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.ClassDef) or node.name.startswith("_"):
            continue
        if not any(
            isinstance(base, ast.Name)
            and base.id in ("NamedTuple", "Description", "PoseReference", "SqueezeReference")
            for base in node.bases
        ):
            continue
        fields, below = [], []
        for entry, following in zip(node.body, [*node.body[1:], None], strict=True):
            if (
                isinstance(entry, ast.AnnAssign)
                and not entry.target.id.startswith("_")
                and entry.target.id != "kind"
            ):
                fields.append(entry.target.id)
                if isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant):
                    below.append(entry.target.id)
        told = [name for name in section(ast.get_docstring(node) or "", "Attributes") or [] if name != "kind"]
        assert fields in (told, below), node.name


def rooms():
    return sorted(
        {coop_pin._PUBLIC[name] for name in coop_pin.__all__}
        | {f"coop_pin.{path.parent.name}" for path in PACKAGE.glob("*/__init__.py")}
    )


@functools.cache
def public():
    """Every public thing of the package and of its rooms, by full name."""
    found = {f"{coop_pin._PUBLIC[name]}.{name}": getattr(coop_pin, name) for name in coop_pin.__all__}
    for room in rooms():
        module = importlib.import_module(room)
        found |= {f"{room}.{name}": getattr(module, name) for name in getattr(module, "__all__", ())}
    return found


def test_everything_public_has_a_docstring():
    for name, thing in public().items():
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert inspect.getdoc(thing), name
        for method_name, method in vars(thing).items() if inspect.isclass(thing) else ():
            if (
                inspect.isfunction(method)
                and not method_name.startswith("_")
                and (method.__module__ or "").startswith("coop_pin")
            ):
                assert method.__doc__, f"{name}.{method_name}"


def mentioned(name, text):
    return re.search(rf"(?<![\w.]){re.escape(name)}(?!\w)", text) is not None


def docstrings_of(thing):
    """What a class says of itself and of its constructor, its parents' words included."""
    told = [
        part
        for parent in thing.__mro__
        for part in (parent.__doc__, getattr(vars(parent).get("__init__"), "__doc__", None))
    ]
    return "\n".join(inspect.cleandoc(part) for part in told if part)


def has_constructor(thing):
    """Whether a class has one of its own, written here: not a dataclass's nor a Protocol's."""
    constructor = vars(thing).get("__init__")
    return inspect.isfunction(constructor) and Path(constructor.__code__.co_filename).is_relative_to(PACKAGE)


def test_the_arguments_of_every_public_function_and_constructor_are_told():
    """Errors are left out: coop_pin makes them, users read their attributes."""
    for name, thing in public().items():
        if inspect.isfunction(thing):
            told, given = inspect.getdoc(thing), inspect.signature(thing).parameters
        elif inspect.isclass(thing) and has_constructor(thing) and not issubclass(thing, BaseException):
            told, given = docstrings_of(thing), list(inspect.signature(thing.__init__).parameters)[1:]
        else:
            continue
        assert [argument for argument in given if not mentioned(argument, told)] == [], name


def attributes_of(thing):
    """Public fields of a class, and what its constructor sets, each with the docstring below it."""
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(thing))).body
    found = {}
    for entry, following in itertools.pairwise([*node.body, None]):
        if isinstance(entry, ast.AnnAssign) and not (
            isinstance(entry.annotation, ast.Name) and entry.annotation.id == "ClassVar"
        ):
            below = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
            found[entry.target.id] = following.value.value if below else ""
        if isinstance(entry, ast.FunctionDef) and entry.name == "__init__":
            stored = [
                inner
                for inner in ast.walk(entry)
                if isinstance(inner, ast.Attribute) and isinstance(inner.ctx, ast.Store)
            ]
            found |= {
                inner.attr: ""
                for inner in stored
                if isinstance(inner.value, ast.Name) and inner.value.id == "self"
            }
    return {name: below for name, below in found.items() if not name.startswith("_") and name != "kind"}


def test_the_attributes_of_every_public_class_are_told():
    ours = {
        name: thing
        for name, thing in public().items()
        if inspect.isclass(thing) and thing.__module__.startswith("coop_pin")
    }
    assert len(ours) > 100
    for name, thing in ours.items():
        told = docstrings_of(thing)
        assert [
            given for given, below in attributes_of(thing).items() if not below and not mentioned(given, told)
        ] == [], name


# ---------------------------------------------------------------- the API reference


def documented_modules():
    return set(
        re.findall(
            r"^\.\. automodule:: ([\w.]+)$",
            "\n".join(page.read_text() for page in (DOCS / "api").glob("*.md")),
            re.MULTILINE,
        )
    )


def test_every_room_with_public_names_is_in_the_reference():
    with_names = {
        room
        for room in rooms()
        if getattr(importlib.import_module(room), "__all__", ()) or room in coop_pin._PUBLIC.values()
    }
    assert with_names - documented_modules() == set()
    for module in documented_modules():
        assert importlib.import_module(module).__doc__, module


def test_every_public_name_is_in_the_reference():
    """Each stands in the table of names, and in the module that its link leads to."""
    spec = importlib.util.spec_from_file_location("_site", DOCS / "_site.py")
    site = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(site)
    table = site.public_names()
    for name in coop_pin.__all__:
        room = coop_pin._PUBLIC[name]
        module = importlib.import_module(room)
        (row,) = [
            line for line in table.splitlines() if line.startswith(f"| [`cp.{name}`](#{room}.{name}) | ")
        ]
        assert len(row.split(" | ")[1]) > 10
        assert room in documented_modules()
        assert name in getattr(module, "__all__", vars(module))


def test_every_page_of_the_reference_is_in_its_table_of_contents():
    index = (DOCS / "api" / "index.md").read_text()
    assert {page.stem for page in (DOCS / "api").glob("*.md")} - {"index"} == set(
        re.findall(r"^(\w+)$", index.split("{toctree}")[1], re.MULTILINE)
    )


# ---------------------------------------------------------------- pages


def anchor(heading):
    """The anchor that a heading gets."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


@pytest.mark.parametrize(
    "page", [REPOSITORY / "README.md", *PAGES], ids=lambda page: str(page.relative_to(REPOSITORY))
)
def test_links_and_pictures_of_a_page_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"(?<!`)\]\(([^)\s]+)\)", text):
        if urlparse(target).scheme:
            continue
        path, _, heading = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if "docs/notebooks/" in str(file):
            file = REPOSITORY / "notebooks" / file.name  # copied there when the site is built
        assert file.exists(), target
        if heading and file.suffix == ".md":
            assert heading in {
                anchor(line.lstrip("# ")) for line in file.read_text().splitlines() if line.startswith("#")
            }, target


def test_every_page_is_in_a_table_of_contents():
    listed = set(
        re.findall(
            r"^([\w/-]+)$",
            "\n".join(re.findall(r"```\{toctree\}\n(.*?)```", (DOCS / "index.md").read_text(), re.DOTALL)),
            re.MULTILINE,
        )
    )
    pages = {str(page.relative_to(DOCS).with_suffix("")) for page in PAGES if page.parent != DOCS / "api"} | {
        "api/index"
    }
    assert pages - {"index"} == listed


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_python_on_a_page_compiles_and_uses_names_that_exist(page):
    for block in blocks(page, "python"):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "cp":
                assert node.attr in coop_pin.__all__, node.attr
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("coop_pin"):
                module = importlib.import_module(node.module)
                assert all(hasattr(module, alias.name) for alias in node.names)
    for block in blocks(page, "toml"):
        tomllib.loads(block)


def shell_lines(page):
    """The commands of a page, one a line."""
    return "\n".join(blocks(page, "sh")).replace("\\\n", " ").splitlines()


def words_of(command):
    """The words of a command line without its comment."""
    import shlex

    return shlex.split(command, comments=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_commands_on_a_page_are_understood(page):
    for line in shell_lines(page):
        if words_of(line)[:1] == ["coop-pin"]:
            assert parse(words_of(line)[1:])
    for name in re.findall(r"python (examples/\w+\.py|benchmarks/\w+\.py)", page.read_text()):
        assert (REPOSITORY / name).is_file(), name


def test_the_line_for_conda_names_all_that_the_package_needs_but_pinocchio():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = shell_lines(DOCS / "quickstart.md")
    (given,) = [words_of(line)[2:] for line in lines if line.startswith("pip install 'example-robot-data")]
    assert given == [
        requirement for requirement in project["dependencies"] if not requirement.startswith("pin>=")
    ]
    (conda,) = [words_of(line)[-1] for line in lines if line.startswith("conda install")]
    (pin,) = set(project["dependencies"]) - set(given)
    assert conda.removeprefix("pinocchio") == pin.removeprefix("pin").partition(";")[0]


RUNNABLE = {"howto/arm.md", "howto/scenario.md", "howto/mechanism.md", "quickstart.md"}


@pytest.mark.parametrize("name", sorted(RUNNABLE))
def test_python_on_a_page_runs(name, tmp_path):
    """One block after the other, as somebody who pastes them."""
    code = "\n".join(blocks(DOCS / name, "python"))
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr


def test_tests_named_on_a_page_exist():
    tests = {
        name
        for file in (REPOSITORY / "tests").glob("test_*.py")
        for name in re.findall(r"^def (test_\w+)", file.read_text(), re.MULTILINE)
    }
    for page in PAGES:
        assert set(re.findall(r"`(test_\w+)`", page.read_text())) - tests == set(), page


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


def build_site(folder):
    """As tools/docs.sh does, but for the notebooks, which are run by tests of their own."""
    options = [
        "-b",
        "html",
        "-W",
        "--keep-going",
        "-n",
        "-q",
        "-D",
        "nb_execution_mode=off",
        "-d",
        str(folder / "trees"),
    ]
    command = [sys.executable, "-m", "sphinx", *options, str(DOCS), str(folder / "html")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    (folder / "warnings").write_text(done.stderr)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("sphinx", reason="sphinx is not installed (extra 'docs')")
    folder = built_once(tmp_path_factory, "site", build_site)
    files = [path.resolve() for path in (folder / "html").rglob("*.html") if "_static" not in path.parts]
    return Site(
        folder / "html",
        (folder / "warnings").read_text(),
        {path: Page(path.read_text(encoding="utf-8")) for path in files},
    )


FROM_ELSEWHERE = r"""@import\s*(?:url\()?\s*['"]?(?:https?:)?//|url\(\s*['"]?(?:https?:)?//"""


def test_the_site_builds_without_warnings(site):
    assert site.warnings == ""
    assert len(site.pages) > 30


def test_nothing_on_the_site_is_loaded_from_elsewhere(site):
    for page, found in site.pages.items():
        for target in found.loaded:
            assert urlparse(target).scheme in ("", "data"), (page, target)
            assert not urlparse(target).netloc, (page, target)
            assert target.startswith("data:") or (page.parent / unquote(urlparse(target).path)).exists(), (
                page,
                target,
            )
        assert not re.search(FROM_ELSEWHERE, found.styles), page
    for style in (site.folder / "_static").rglob("*.css"):
        assert not re.search(FROM_ELSEWHERE, style.read_text(encoding="utf-8")), style


def test_links_within_the_site_lead_to_a_page_and_an_anchor_and_others_are_well_formed(site):
    checked = 0
    for page, found in site.pages.items():
        for target in found.links:
            given = urlparse(target)
            if given.scheme or given.netloc:
                assert given.scheme in ("https", "http", "mailto"), (page, target)
                assert given.scheme == "mailto" or re.fullmatch(r"[\w-]+(\.[\w-]+)+(:\d+)?", given.netloc), (
                    page,
                    target,
                )
                assert not re.search(r"\s", target), (page, target)
                continue
            file = (page.parent / unquote(given.path)).resolve() if given.path else page
            assert file.exists(), (page, target)
            assert (
                not given.fragment
                or file not in site.pages
                or unquote(given.fragment) in site.pages[file].ids
            ), (page, target)
            checked += 1
    assert checked > 1000


def members_of(thing):
    """Public methods and properties that a class defines itself."""
    kinds = (types.FunctionType, classmethod, staticmethod, property, functools.cached_property)
    hidden = {"model_post_init"}  # Pydantic's, called by it
    return [
        name
        for name, value in vars(thing).items()
        if isinstance(value, kinds) and not name.startswith("_") and name not in hidden
    ]


def test_every_public_name_and_every_member_of_a_public_class_is_on_the_site(site):
    ids = set().union(*(found.ids for found in site.pages.values()))
    for name, thing in public().items():
        if not (inspect.isclass(thing) or inspect.isfunction(thing)):
            continue
        here = [place for place in (name, f"{thing.__module__}.{thing.__qualname__}") if place in ids]
        assert here, name
        if inspect.isclass(thing) and thing.__module__.startswith("coop_pin"):
            assert [member for member in members_of(thing) if f"{here[0]}.{member}" not in ids] == [], name


def test_the_reference_tells_how_a_class_is_made(site):
    text = (site.folder / "api" / "model.html").read_text(encoding="utf-8")
    assert "pose of the tip in the payload frame" in text


def test_a_browser_opens_the_site_from_its_folder_and_asks_nobody_else(site):
    """Formulas are set, and no request leaves the folder."""
    asked = []
    with browser_page(offline=True) as page:
        page.on("request", lambda request: asked.append(request.url))
        for name in ("index.html", "concepts/law.html", "api/chain.html", "notebooks/01_paper.html"):
            page.goto((site.folder / name).as_uri(), wait_until="load")
            if name == "concepts/law.html":
                page.wait_for_selector("mjx-container")
    assert asked
    assert {urlparse(url).scheme for url in asked} <= {"file", "data", "blob"}
