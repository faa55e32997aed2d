"""A page that shows what a command found: one HTML file that needs no network."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from sequences.atomic import atomic_output

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table as RichTable

_BEGIN = '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="generator" content="vapor-track">'
_PACKING = 6  # of gzip: 9 takes twice as long for two per cent


@runtime_checkable
class Block(Protocol):
    """Part of a page; parts stand one below the other."""

    def html(self, packed: dict[str, Any]) -> str:
        """Its HTML; data for its script go into `packed` under a name of their own."""
        ...


@dataclass(frozen=True)
class Text:
    """A paragraph of plain text, whose kind is "note" or, for warnings and hints, "notice"."""

    words: str
    kind: str = "note"

    def html(self, packed: dict[str, Any]) -> str:
        """See `Block`."""
        return f'<p class="{self.kind}">{escape(self.words)}</p>'


@dataclass(frozen=True)
class Table:
    """A table; its first column names the rows.

    Attributes:
        columns: Headings, the first of the names.
        rows: Cells, as text.
        caption: Also its name for a screen reader.
        ours: Numbers of the rows that are set in bold.
        words: Whether cells are words, to be wrapped, rather than figures.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str
    ours: Sequence[int] = ()
    words: bool = False

    def html(self, packed: dict[str, Any]) -> str:
        """See `Block`."""
        cells = (f'<th scope="col">{escape(name)}</th>' if name else "<td></td>" for name in self.columns)
        head = f"<thead><tr>{''.join(cells)}</tr></thead>" if any(self.columns) else ""
        body = "".join(
            f'<tr{" class=ours" if number in self.ours else ""}><th scope="row">{escape(row[0])}</th>'
            + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
            + "</tr>"
            for number, row in enumerate(self.rows)
        )
        kind = ' class="words"' if self.words else ""
        return (
            f'<div class="scroll" role="region" tabindex="0" aria-label="{escape(self.caption)}"><table{kind}>'
            f"<caption>{escape(self.caption)}</caption>{head}<tbody>{body}</tbody></table></div>"
        )


@dataclass(frozen=True)
class Picture:
    """A picture.

    Attributes:
        data: The bytes of a PNG or JPEG file.
        alt: Text for a screen reader.
        caption: Below it; empty for none.
    """

    data: bytes
    alt: str
    caption: str = ""

    def html(self, packed: dict[str, Any]) -> str:
        """See `Block`."""
        seen = f'<img src="{data_url(self.data)}" alt="{escape(self.alt)}" loading="lazy">'
        return f"<figure>{seen}{_below(self.caption)}</figure>"


@dataclass(frozen=True)
class Plot:
    """A figure that Plotly draws.

    Attributes:
        name: Its name on the page, of letters.
        traces: Plotly's traces; the colour "ink" is that of text.
        layout: Plotly's layout, without the colours of light and dark.
        label: Text for a screen reader.
        caption: Below it; empty for none.
    """

    name: str
    traces: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any]
    label: str
    caption: str = ""

    def html(self, packed: dict[str, Any]) -> str:
        """See `Block`."""
        packed[self.name] = {"traces": self.traces, "layout": self.layout}
        return (
            f'<figure data-figure="{self.name}" aria-label="{escape(self.label)}"><div class="plot"></div>'
            f"{_below(self.caption)}</figure>"
        )


@dataclass(frozen=True)
class Folded:
    """Blocks that are shown after a click on the title; no `Plot`, which needs a width."""

    title: str
    blocks: Sequence[Block]

    def html(self, packed: dict[str, Any]) -> str:
        """See `Block`."""
        return f"<details><summary>{escape(self.title)}</summary>{_html(self.blocks, packed)}</details>"


@dataclass(frozen=True)
class Code:
    """Text as it is, such as a command."""

    words: str

    def html(self, packed: dict[str, Any]) -> str:
        """See `Block`."""
        return f"<pre>{escape(self.words)}</pre>"


@dataclass(frozen=True)
class Section:
    """A heading, and the blocks below it."""

    title: str
    blocks: Sequence[Block]

    def html(self, packed: dict[str, Any]) -> str:
        """See `Block`."""
        return f"<section><h2>{escape(self.title)}</h2>{_html(self.blocks, packed)}</section>"


@dataclass(frozen=True)
class Page:
    """The findings of a command.

    Attributes:
        title: Such as the name of the sequence.
        asked: The question, in a line.
        verdict: The answer, in a sentence.
        sections: The rest.
        notices: Warnings and hints, shown first.
    """

    title: str
    asked: str
    verdict: str
    sections: Sequence[Section] = field(default_factory=tuple)
    notices: Sequence[str] = ()

    def html(self) -> str:
        """The file's text."""
        packed: dict[str, Any] = {}
        notices = "".join(Text(notice, "notice").html(packed) for notice in self.notices)
        sections = "".join(section.html(packed) for section in self.sections)
        scripts = ""
        if packed:
            data = json.dumps(packed, separators=(",", ":"), allow_nan=False).encode()
            scripts = (
                f'<script type="text/plain" id="data">{_packed(data)}</script>'
                f'<script type="text/plain" id="plotly">{_packed_plotly()}</script><script>{_asset("page.js")}</script>'
            )
        return (
            f"{_BEGIN}"
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{escape(self.title)} - vapor-track</title><style>{_asset('page.css')}</style></head><body>"
            f'<header><h1>{escape(self.title)}</h1><p class="asked">{escape(self.asked)}</p>'
            f'<p class="verdict">{escape(self.verdict)}</p>{notices}</header>'
            f"<main>{sections}</main><footer>Made by vapor-track. The file needs no network.</footer>{scripts}"
            "</body></html>\n"
        )


def _below(caption: str) -> str:
    return f"<figcaption>{escape(caption)}</figcaption>" if caption else ""


def write_page(path: Path, page: Page) -> None:
    """Write a page; the file appears under its name only when complete."""
    with atomic_output(path) as partial:
        partial.write_text(page.html(), encoding="utf-8")


def is_page(path: Path) -> bool:
    """Whether a file is a page that was written here."""
    with path.open("rb") as file:
        return file.read(len(_BEGIN)) == _BEGIN.encode()


def data_url(data: bytes) -> str:
    """A PNG or JPEG as a data URL."""
    kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _html(blocks: Sequence[Block], packed: dict[str, Any]) -> str:
    return "".join(block.html(packed) for block in blocks)


def _packed(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, _PACKING, mtime=0)).decode("ascii")


@cache
def _packed_plotly() -> str:
    return _packed(resources.files("plotly").joinpath("package_data/plotly.min.js").read_bytes())


def _asset(name: str) -> str:
    return resources.files("vapor.reporting.html").joinpath(name).read_text(encoding="utf-8")


def findings_page(
    title: str,
    asked: str,
    verdict: str,
    parts: Iterable[tuple[str, Sequence[RichTable | str | Path | Block]]],
    *,
    settings: Mapping[str, Any] | None = None,
    command: str = "",
) -> Page:
    """A page with a section for each part.

    Args:
        title: See `Page`.
        asked: See `Page`.
        verdict: See `Page`.
        parts: Headings, each with blocks, printed tables, lines and files of pictures.
        settings: Settings of the command, as JSON.
        command: The command line; empty where there was none.
    """
    sections = [Section(heading, [_block(item, heading) for item in items]) for heading, items in parts if items]
    made: list[Block] = [] if not command else [Code(command)]
    if settings is not None:
        made.append(Folded("Settings", [Code(json.dumps(settings, indent=2, default=str))]))
    return Page(title, asked, verdict, [*sections, *([Section("How it was made", made)] if made else [])])


def _block(item: RichTable | str | Path | Block, heading: str) -> Block:
    if isinstance(item, Path):
        return Picture(item.read_bytes(), f"{heading}: {item.stem}")
    if isinstance(item, str):
        return Text(item, "notice")
    return item if isinstance(item, Block) else _printed_table(item, heading)


def _printed_table(table: RichTable, caption: str) -> Table:
    """A table of Rich with its bold rows; the caption is for one without a title."""
    rows = list(zip(*(map(_plain, column.cells) for column in table.columns), strict=True))
    ours = [number for number, row in enumerate(table.rows) if "bold" in str(row.style or "")]
    title = _plain(table.title) if table.title is not None else caption
    return Table([_plain(column.header) for column in table.columns], rows, title or caption, ours)


def _plain(cell: RenderableType) -> str:
    from rich.text import Text as RichText

    return cell.plain if isinstance(cell, RichText) else RichText.from_markup(str(cell)).plain
