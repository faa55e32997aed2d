"""The page of a command that prints tables and draws pictures."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text as RichText

from vapor.reporting.html.page import Block, Code, Folded, Page, Picture, Section, Table, Text

if TYPE_CHECKING:
    from rich.table import Table as RichTable


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
        title: What was looked at.
        asked: What was asked, in a line.
        verdict: What came of it.
        parts: Headings, and what stands below each: blocks, tables as printed, lines,
            and files of pictures.
        settings: What it was made with, as JSON.
        command: The command that was given; empty where there was none.
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
    """The cells of a table of Rich; rows that are bold there are so here.

    Args:
        table: The table.
        caption: What it is of, where the table has no title.
    """
    columns = [[_plain(cell) for cell in column.cells] for column in table.columns]
    rows = list(zip(*columns, strict=True))
    ours = [number for number, row in enumerate(table.rows) if "bold" in str(row.style or "")]
    title = _plain(table.title) if table.title is not None else caption
    return Table([_plain(column.header) for column in table.columns], rows, title or caption, ours)


def _plain(cell: RenderableType) -> str:
    return cell.plain if isinstance(cell, RichText) else RichText.from_markup(str(cell)).plain
