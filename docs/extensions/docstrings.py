"""Docstrings as reStructuredText: what they say is kept, and nothing in them is taken for a mark by accident.

They are written to be read in an editor: code in single backticks, `|ω|` for a length, `*` for a product. A public name
in backticks becomes a link. Shapes of arrays in signatures are written `Float64[n, 6, 6]`.
"""

from __future__ import annotations

import dataclasses
import re
from typing import Any

from sphinx.application import Sphinx

import vapor


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _as_restructured_text, priority=400)  # before napoleon finds its sections
    app.connect("autodoc-process-docstring", _with_colons, priority=600)
    app.connect("autodoc-process-signature", _readable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _as_restructured_text(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    lines[:] = _marked_but_for_examples(lines)
    if what in ("attribute", "property"):  # of which napoleon takes what is before a colon for the type
        lines[:] = [line.replace(": ", _COLON) for line in lines]


def _with_colons(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    lines[:] = [line.replace(_COLON, ": ") for line in lines]


_COLON = "\ue000"


def _marked_but_for_examples(lines: list[str]) -> list[str]:
    """The lines, and examples as they are: from `>>>` to the next empty line."""
    done, is_example = [], False
    for line in lines:
        is_example = line.lstrip().startswith(">>>") or (is_example and line.strip() != "")
        done.append(line if is_example else _marked(line))
    return done


def _marked(line: str) -> str:
    parts = re.split(r"`([^`]+)`", line)
    return "".join(_code(part) if i % 2 else re.sub(r"([*|\\]|_(?!\w))", r"\\\1", part) for i, part in enumerate(parts))


def _code(text: str) -> str:
    """Code, or a link where it begins with a public name: to that name, or to its method."""
    name, _, member = text.partition(".")
    if name not in vapor.__all__ or not text.replace(".", "").isidentifier():
        return f"``{text}``"
    target = text if callable(getattr(getattr(vapor, name), member or "__init__", None)) else name
    return f":py:obj:`{text} <vapor.{target}>`"


def _readable(
    app: Sphinx, what: str, name: str, obj: object, options: object, signature: str | None, result: str | None
) -> tuple[str | None, str | None]:
    """A signature with shapes of arrays; none of a dataclass whose fields are each explained below it."""
    if dataclasses.is_dataclass(obj) and "Attributes:" not in (obj.__doc__ or ""):
        return "", None
    return _with_shapes(signature), _with_shapes(result)


def _with_shapes(text: str | None) -> str | None:
    return text and re.sub(r"(\w+)\[ndarray, '([^']*)'\]", lambda found: f"{found[1]}[{_shape(found[2])}]", text)


def _shape(dimensions: str) -> str:
    return ", ".join(dimensions.split()) or "()"
