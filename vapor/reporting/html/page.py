"""A page with the findings of a command: one HTML file that needs no network."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib import resources
from importlib.metadata import distribution
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

from sequences.atomic import atomic_output

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table as RichTable

_BEGIN = '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="generator" content="vapor-track">'
_PACKING = 6  # of gzip: 9 takes twice as long for two per cent


@dataclass(frozen=True)
class Block:
    """Part of a page: its HTML, and data for the script of the page, each under a name of its own."""

    html: str
    data: Mapping[str, Any] = field(default_factory=dict)


def paragraph(words: str, kind: Literal["note", "notice"] = "note") -> Block:
    """Plain text: a note, or a notice, which is a warning or a hint."""
    return Block(f'<p class="{kind}">{escape(words)}</p>')


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    caption: str,
    ours: Container[int] = (),
    *,
    words: bool = False,
    links: Mapping[str, str] = MappingProxyType({}),
) -> Block:
    """A table, whose first column names the rows; the caption is also its name for a screen reader.

    Rows with the numbers `ours` are bold; names of rows with an address among `links` lead there. Cells of words are
    wrapped, unlike figures; two figures in a cell, which two spaces are between, are wrapped on a narrow screen.
    """
    cells = (f'<th scope="col">{escape(name)}</th>' if name else "<td></td>" for name in columns)
    head = f"<thead><tr>{''.join(cells)}</tr></thead>" if any(columns) else ""
    body = "".join(
        f'<tr{" class=ours" if number in ours else ""}><th scope="row">{_linked(row[0], links)}</th>'
        + "".join(f"<td{' class=two' if '  ' in cell else ''}>{escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for number, row in enumerate(rows)
    )
    kind = ' class="words"' if words else ""
    return Block(
        f'<div class="scroll" role="region" tabindex="0" aria-label="{escape(caption)}"><table{kind}>'
        f"<caption>{escape(caption)}</caption>{head}<tbody>{body}</tbody></table></div>"
    )


def _linked(name: str, links: Mapping[str, str]) -> str:
    return f'<a href="{escape(links[name])}">{escape(name)}</a>' if name in links else escape(name)


def picture(image: bytes, alt: str, caption: str = "") -> Block:
    """A PNG or JPEG file, with a text for a screen reader, and a caption if any."""
    shown = f'<img src="{data_url(image)}" alt="{escape(alt)}" loading="lazy">'
    return Block(f"<figure>{shown}{_below(caption)}</figure>")


def plot(
    name: str, traces: Sequence[Mapping[str, Any]], layout: Mapping[str, Any], label: str, caption: str = ""
) -> Block:
    """A figure that Plotly draws, by a name of letters, with a label for a screen reader; with a third y axis higher.

    In traces the colour "ink" is that of text; the layout is without the colours of light and dark.
    """
    drawn = f'<div class="plot{" three" if "yaxis3" in layout else ""}"></div>'
    shown = f'<figure data-figure="{name}" aria-label="{escape(label)}">{drawn}{_below(caption)}</figure>'
    return Block(shown, {name: {"traces": traces, "layout": layout}})


def folded(title: str, blocks: Iterable[Block]) -> Block:
    """Blocks that are shown after a click on the title; no `plot`, which needs a width."""
    return _joined(f"<details><summary>{escape(title)}</summary>", blocks, "</details>")


def code(words: str) -> Block:
    """Text as it is, such as a command."""
    return Block(f"<pre>{escape(words)}</pre>")


def section(title: str, blocks: Iterable[Block]) -> Block:
    """A heading, and the blocks below it."""
    return _joined(f"<section><h2>{escape(title)}</h2>", blocks, "</section>")


def _joined(before: str, blocks: Iterable[Block], after: str) -> Block:
    parts = list(blocks)
    data = {name: each for block in parts for name, each in block.data.items()}
    return Block(before + "".join(block.html for block in parts) + after, data)


@dataclass(frozen=True)
class Page:
    """The findings of a command: title, question in a line, answer in a sentence, notices, and sections.

    `steps` are what to do next, the most urgent first: an action and its reason each.
    """

    title: str
    asked: str
    verdict: str
    sections: Sequence[Block] = ()
    notices: Sequence[str] = ()
    steps: Sequence[tuple[str, str]] = ()

    def html(self) -> str:
        """The file's text."""
        notices = "".join(paragraph(notice, "notice").html for notice in self.notices)
        sections, scripts = _joined("", self.sections, ""), ""
        if sections.data:
            data = json.dumps(sections.data, separators=(",", ":"), allow_nan=False).encode()
            scripts = (
                f'<script type="text/plain" id="data">{_packed(data)}</script>'
                f'<script type="text/plain" id="plotly">{_packed_plotly()}</script><script>{_asset("page.js")}</script>'
            )
        return (
            f"{_BEGIN}"
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{escape(self.title)} - vapor-track</title><style>{_asset('page.css')}</style></head><body>"
            f'<header><h1>{escape(self.title)}</h1><p class="asked">{escape(self.asked)}</p>'
            f'<p class="verdict">{escape(self.verdict)}</p>{self._next()}{notices}</header>'
            f"<main>{sections.html}</main><footer>Made by vapor-track. The file needs no network.</footer>{scripts}"
            "</body></html>\n"
        )

    def _next(self) -> str:
        steps = "".join(f"<li><strong>{escape(do)}</strong> {escape(reason)}</li>" for do, reason in self.steps)
        return f'<section class="next"><h2>What to do next</h2><ol>{steps}</ol></section>' if steps else ""


def _below(caption: str) -> str:
    return f"<figcaption>{escape(caption)}</figcaption>" if caption else ""


def write_page(path: Path, page: Page) -> None:
    """Write a page; the file appears under its name only when complete. What is no text in names is `?`."""
    with atomic_output(path) as partial:
        partial.write_text(page.html(), encoding="utf-8", errors="replace")


def is_page(path: Path) -> bool:
    """Whether a file is a page that was written here."""
    with path.open("rb") as file:
        return file.read(len(_BEGIN)) == _BEGIN.encode()


def data_url(data: bytes) -> str:
    """A PNG or JPEG as a data URL."""
    kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _packed(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, _PACKING, mtime=0)).decode("ascii")


@cache
def _packed_plotly() -> str:
    script = distribution("plotly").locate_file("plotly/package_data/plotly.min.js")  # without an import of the package
    return _packed(Path(str(script)).read_bytes())


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
    """A page with a section for each part: a heading, and blocks, printed tables, lines and files of pictures.

    Settings of the command are JSON; the command line is empty where there was none.
    """
    sections = [section(heading, [_block(item, heading) for item in items]) for heading, items in parts if items]
    made = [code(command)] if command else []
    if settings is not None:
        made.append(folded("Settings", [code(json.dumps(settings, indent=2, default=str))]))
    return Page(title, asked, verdict, [*sections, *([section("How it was made", made)] if made else [])])


def _block(item: RichTable | str | Path | Block, heading: str) -> Block:
    if isinstance(item, Path):
        return picture(item.read_bytes(), f"{heading}: {item.stem}")
    if isinstance(item, str):
        return paragraph(item, "notice")
    return item if isinstance(item, Block) else _printed_table(item, heading)


def _printed_table(printed: RichTable, caption: str) -> Block:
    """A table of Rich with its bold rows; the caption is for one without a title."""
    rows = list(zip(*(map(_plain, column.cells) for column in printed.columns), strict=True))
    ours = [number for number, row in enumerate(printed.rows) if "bold" in str(row.style or "")]
    title = _plain(printed.title) if printed.title is not None else caption
    return table([_plain(column.header) for column in printed.columns], rows, title or caption, ours)


def _plain(cell: RenderableType) -> str:
    from rich.text import Text as RichText

    return cell.plain if isinstance(cell, RichText) else RichText.from_markup(str(cell)).plain
