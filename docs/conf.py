"""Sphinx configuration of the site (``bash tools/docs.sh``). Its pages load nothing from other servers."""

import hashlib
import logging
import shutil
import sys
from pathlib import Path

import coop_pin

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parent
sys.path.insert(0, str(HERE))


def package_digest() -> str:
    """Return a digest of all files of the package."""
    digest = hashlib.sha256()
    for file in sorted(
        path for folder in ("coop_pin", "urdf") for path in (REPOSITORY / folder).rglob("*") if path.is_file()
    ):
        if "__pycache__" not in file.parts:
            digest.update(str(file.relative_to(REPOSITORY)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


# A style of code blocks turns on the messages of libraries; the first of matplotlib tells of its fonts.
logging.getLogger("matplotlib").setLevel(logging.WARNING)

# Sphinx reads notebooks only below its own folder; the copies are not committed.
shutil.rmtree(HERE / "notebooks", ignore_errors=True)
(HERE / "notebooks").mkdir()
for notebook in sorted((REPOSITORY / "notebooks").glob("*.ipynb")):
    shutil.copy(notebook, HERE / "notebooks")

project = "coop_pin"
author = "coop_pin contributors"
copyright = "coop_pin contributors"
version = release = coop_pin.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx-mathjax-offline", "_site"]
# Source pages and the members in every page's table of contents take half of the time: ``-t draft`` leaves
# them out.
draft = tags.has("draft")  # noqa: F821  (Sphinx defines tags)
extensions += [] if draft else ["sphinx.ext.viewcode"]
toc_object_entries = not draft
exclude_patterns = ["_build", "README.md"]
templates_path = []
language = "en"

# ---------------------------------------------------------------- pages

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
# The cache compares the text of a notebook, not the package that it uses: each state of the package has a
# cache of its own.
nb_execution_cache_path = str(REPOSITORY / "out" / "docs-cache" / package_digest() / "notebooks")
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_ipywidgets_js = {}  # otherwise every notebook loads require.js from another server
nb_mime_priority_overrides = [
    ("html", "application/vnd.jupyter.widget-view+json", None)
]  # a panel's still image, not its widget
nb_merge_streams = True

# ---------------------------------------------------------------- reference

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {
    name: name for name in ("Array", "ArrayLike", "NDArray")
}  # otherwise each is expanded to all types that numpy accepts as an array
autodoc_class_signature = "mixed"
autodoc_default_options = {"show-inheritance": True}
add_module_names = False
python_use_unqualified_type_names = True
napoleon_use_ivar = True
napoleon_use_rtype = False
nitpick_ignore_regex = [
    (
        "py:.*",
        r"(?!coop_pin).*",
    ),  # numpy, Pinocchio and type aliases are documented on other sites, which an offline page cannot load
    ("py:.*", r"coop_pin\.\w+\._\w+"),  # private base classes
    ("py:.*", r"coop_pin\.\w+\.\w+\..*"),  # parts of packages that are returned but not public
]

# ---------------------------------------------------------------- looks

html_theme = "furo"
html_title = "coop_pin"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
