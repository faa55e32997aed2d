"""The documentation site: `make docs` builds it into build/site."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

# Code cells run in kernels of their own: with this checkout, its command, and one thread each, as two run at a time.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
os.environ["OMP_NUM_THREADS"] = "1"

# What code cells make to be looked at as a page of its own; copied beside the pages once all are written.
MADE = ROOT / "build" / "site-made"
MADE.mkdir(parents=True, exist_ok=True)
os.environ["SITE_MADE"] = str(MADE)
html_extra_path = [str(MADE)]

project = "vapor-track"
author = "the authors of vapor-track"
html_title = project
smartquotes_action = "D"  # dashes; quotes stay as they are written
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "docs.extensions.accessible",
    "docs.extensions.command_help",
    "docs.extensions.docstrings",
    "docs.extensions.mathml",
    "docs.extensions.repository_files",
]
exclude_patterns = ["**.ipynb_checkpoints"]

myst_enable_extensions = ["attrs_block", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

repository_pages = {"CHANGELOG.md": "changelog", "CONTRIBUTING.md": "contributing", "README.md": "index"}

nb_execution_mode = "force"  # not from a cache, which would not notice that the library has changed
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600  # seconds a cell: a guard, also where other programs run
nb_merge_streams = True

# Of Python's names only `vapor.Name` and `vapor.Name.member` are looked up: those of others would need a network.
nitpick_ignore_regex = [(r"py:.*", r"(?!vapor\.\w+(\.\w+)?$).*")]

autodoc_member_order = "bysource"
napoleon_use_ivar = True  # attributes of a class as one list
napoleon_attr_annotations = False  # their types stand in its signature
maximum_signature_line_length = 90  # a longer one has a line for each parameter
toc_object_entries_show_parents = "hide"

html_math_renderer = "mathml"
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("env-before-read-docs", _spread)


def _spread(app: Sphinx, env: object, docnames: list[str]) -> None:
    """Pages whose code is run lie side by side in the alphabet, and processes take pages that do."""
    docnames[:] = [name for first in range(3) for name in docnames[first::3]]
