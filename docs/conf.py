"""Sphinx builds the site from here: ``bash tools/docs.sh``. Nothing in it is loaded from elsewhere."""

import hashlib
import shutil
import sys
from pathlib import Path

import coop_pin

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parent
sys.path.insert(0, str(HERE))


def package_digest() -> str:
    """Return a digest of everything that the package consists of."""
    digest = hashlib.sha256()
    for file in sorted(
        path for folder in ("coop_pin", "urdf") for path in (REPOSITORY / folder).rglob("*") if path.is_file()
    ):
        if "__pycache__" not in file.parts:
            digest.update(str(file.relative_to(REPOSITORY)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


# Sphinx reads notebooks below its own folder only; the copies are not kept in the repository.
shutil.rmtree(HERE / "notebooks", ignore_errors=True)
(HERE / "notebooks").mkdir()
for notebook in sorted((REPOSITORY / "notebooks").glob("*.ipynb")):
    shutil.copy(notebook, HERE / "notebooks")

project = "coop_pin"
author = "coop_pin contributors"
copyright = "coop_pin contributors"
version = release = coop_pin.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",
    "_site",
]
exclude_patterns = ["_build", "README.md"]
templates_path = []
language = "en"

# ---------------------------------------------------------------- pages

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
# The cache knows the text of a notebook, not the package that it shows: each state of the package has a cache
# of its own.
nb_execution_cache_path = str(REPOSITORY / "out" / "docs-cache" / package_digest())
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_ipywidgets_js = {}  # else every notebook asks a server elsewhere for require.js
nb_mime_priority_overrides = [
    ("html", "application/vnd.jupyter.widget-view+json", None)
]  # a panel's still picture, not its widget
nb_merge_streams = True

# ---------------------------------------------------------------- reference

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {
    name: name for name in ("Array", "ArrayLike", "NDArray")
}  # else each shows all that numpy takes for an array
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
    ),  # numpy, Pinocchio and type aliases stand in other sites, which an offline page cannot ask
    ("py:.*", r"coop_pin\.\w+\.\w+\..*"),  # parts of rooms that are handed back but not public
]

# ---------------------------------------------------------------- looks

html_theme = "furo"
html_title = "coop_pin"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
