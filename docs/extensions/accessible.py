"""What the theme leaves out for those who do not see the page, or use no mouse."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

_MENDED = {
    "body": {
        "<pre>": '<pre tabindex="0">',  # wide blocks are scrolled by keys
        '<div class="table-wrapper': '<div tabindex="0" class="table-wrapper',  # and wide tables
        '<th class="head"><p></p></th>': "<td></td>",  # an empty corner is no heading
        '<summary aria-label="Toggle hidden content">': "<summary>",  # its text says what is hidden
    },
    "furo_navigation_tree": {'role="heading"': 'role="heading" aria-level="2"'},
}


_PARAMETERS = re.compile(r"<dl>\s*((?:<dd>.*?</dd>\s*)+)</dl>", re.DOTALL)  # of a signature: a list without terms


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("html-page-context", _mend, priority=900)  # after the theme
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _mend(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object) -> None:
    for part, changes in _MENDED.items():
        for found, better in changes.items():
            context[part] = context.get(part, "").replace(found, better)
    context["body"] = _PARAMETERS.sub(_as_lines, context.get("body", ""))


def _as_lines(found: re.Match[str]) -> str:
    lines = found[1].replace("<dd>", '<span class="parameter">').replace("</dd>", "</span>")
    return f'<span class="parameters">{lines}</span>'
