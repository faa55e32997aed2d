"""Outputs read back: pages as a browser parses them, recordings as Rerun's own tool reads them."""

import base64
import gzip
import json
import re
import subprocess
import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

_STYLE = {"colors", "radii", "names", "widths"}
_VOID = {"meta", "img", "input", "br", "link", "rect"}


@dataclass
class ReadPage(HTMLParser):
    """A parsed page.

    Attributes:
        tags: Every tag with its attributes, in order.
        cells: Text of every cell of a table, in order.
        words: All text but that of scripts and styles.
        scripts: Text of every script by its id; "" for the page's own.
    """

    tags: list[tuple[str, dict[str, str | None]]] = field(default_factory=list)
    cells: list[str] = field(default_factory=list)
    words: str = ""
    scripts: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__init__()
        self._open: list[tuple[str, dict[str, str | None]]] = []

    @classmethod
    def of(cls, text: str) -> "ReadPage":
        page = cls()
        page.feed(text)
        page.close()
        assert not page._open, f"never closed: {page._open}"
        return page

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag in ("td", "th"):
            self.cells.append("")
        if tag not in _VOID:
            self._open.append((tag, dict(attrs)))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        opened, _ = self._open.pop()
        assert opened == tag, f"</{tag}> closes <{opened}>"

    def handle_data(self, data: str) -> None:
        inside = [tag for tag, _ in self._open]
        if "script" in inside:
            self.scripts[self._open[-1][1].get("id") or ""] = data
        elif "style" not in inside:
            self.words += data
            if inside and inside[-1] in ("td", "th"):
                self.cells[-1] += data

    @property
    def data(self) -> dict[str, Any]:
        return json.loads(gzip.decompress(base64.b64decode(self.scripts["data"])))


def entities_of(path: Path) -> set[str]:
    """The entities of a recording that have more than a style."""
    command = [sys.executable, "-m", "rerun_cli", "rrd", "print", str(path)]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    chunks = re.findall(r"^Chunk\(.* - (/\S*) - data columns: \[(.*)\]", text, re.MULTILINE)
    return {entity for entity, columns in chunks if {*re.findall(r":(\w+)", columns)} - _STYLE}
