"""Docstrings as reStructuredText: what they say is kept, and nothing in them is taken for a mark by accident.

They are written to be read in an editor: code in single backticks, `|ω|` for a length, `*` for a product. A public name
in backticks becomes a link.
"""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

import vapor


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _as_restructured_text, priority=400)  # before napoleon finds its sections
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _as_restructured_text(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    lines[:] = "\n".join(_lines(line) for line in lines).splitlines()


def _lines(line: str) -> str:
    parts = re.split(r"`([^`]+)`", line)
    return "".join(_code(part) if i % 2 else re.sub(r"([*|\\]|_(?!\w))", r"\\\1", part) for i, part in enumerate(parts))


def _code(text: str) -> str:
    first = text.partition(".")[0]
    return f":py:obj:`~vapor.{text}`" if first in vapor.__all__ and text.replace(".", "").isidentifier() else f"``{text}``"
