"""Links from a page to files of the repository lead to a page that shows the file.

On GitHub `[its loop](../examples/own_loop.py)` opens the file; on the site it opens a page with its text. Files that
are pages of the site already, as CHANGELOG.md is, are named in the setting `repository_pages`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.addnodes import download_reference, pending_xref
from sphinx.application import Sphinx
from sphinx.util.display import status_iterator

_SHOWN = "repository_files"


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_config_value("repository_pages", {}, "env")
    app.connect("doctree-read", _lead_to_pages, priority=400)  # before what they lead to is copied as a download
    app.connect("html-collect-pages", _pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _lead_to_pages(app: Sphinx, doctree: nodes.document) -> None:
    docname, root = app.env.docname, Path(app.srcdir).parent.resolve()
    for node in [*doctree.findall(download_reference), *doctree.findall(pending_xref)]:
        if node.get("reftype") != "myst":
            continue
        path = _path_of(app, node, docname)
        if path is None or not path.is_relative_to(root) or path.is_relative_to(app.srcdir):
            continue
        name = path.relative_to(root).as_posix()
        page = app.config.repository_pages.get(name)
        if page is None:
            app.env.metadata[docname].setdefault(_SHOWN, []).append(name)
            page = _page_of(name)
        uri = app.builder.get_relative_uri(docname, page)
        node.replace_self(nodes.reference("", "", *node.children, refuri=uri, internal=True))


def _path_of(app: Sphinx, node: nodes.Element, docname: str) -> Path | None:
    """The file that a link of Markdown names; None for a link to something else."""
    if node.get("refdomain") == "doc":  # a path without its ending, as for pages
        return Path(app.srcdir, f"{node['reftarget']}.md").resolve()
    path = Path(app.env.relfn2path(node["reftarget"], docname)[1]).resolve()
    return path if path.is_file() else None


def _pages(app: Sphinx) -> Iterator[tuple[str, dict[str, Any], str]]:
    """The pages that show files."""
    names = sorted({name for metadata in app.env.metadata.values() for name in metadata.get(_SHOWN, [])})
    for name in status_iterator(names, "files of the repository... ", "blue", len(names), app.verbosity):
        text = (Path(app.srcdir).parent / name).read_text(encoding="utf-8")
        code = app.builder.highlighter.highlight_block(text, _LANGUAGES.get(Path(name).suffix, "text"), linenos=False)
        yield _page_of(name), {"title": name, "body": f"<h1>{name}</h1>{code}"}, "page.html"


_LANGUAGES = {".py": "python", ".toml": "toml", ".sh": "sh", "": "make"}


def _page_of(name: str) -> str:
    return f"source/{name}"
