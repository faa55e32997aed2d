"""Tables where a terminal is too narrow for them: a block for each row instead."""

from __future__ import annotations

import re

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

_WIDE = 10_000


def fitting(table: Table, console: Console) -> RenderableType:
    """A table if it fits the console's width with every figure whole and in one line; else a block for each row.

    A block is headed by heading and cell of the first column, and has a line with those of each of the others.
    """
    shown = _rendered(table, console, console.width)
    words = _words(_rendered(table, console, _WIDE))
    figures = (line for column in table.columns[1:] for cell in column.cells for line in _plain(cell).splitlines())
    fits = _words(shown) == words and all(figure.strip() in shown for figure in figures)
    return table if fits else Group(*_blocks(table))


def _rendered(table: Table, console: Console, width: int) -> str:
    options = console.options.update_width(width)
    lines = console.render_lines(table, options, pad=False)
    return "\n".join("".join(segment.text for segment in line) for line in lines)


def _words(text: str) -> list[str]:
    return sorted(word for word in text.split() if any(map(str.isalnum, word)))


def _blocks(table: Table) -> list[RenderableType]:
    """Title, blocks and caption."""
    names, *columns = ([_plain(cell) for cell in column.cells] for column in table.columns)
    first, *headings = (_plain(column.header).replace("-\n", "").replace("\n", " ").strip() for column in table.columns)
    blocks: list[RenderableType] = [Text(_plain(table.title), style="italic")] if table.title else []
    for name, row, cells in zip(names, table.rows, zip(*columns, strict=True), strict=True):
        block = Table.grid(padding=(0, 2, 0, 0))
        block.add_column(min_width=min(max(map(len, headings)), 14))
        block.add_column()
        for heading, cell in zip(headings, cells, strict=True):
            if cell.strip():
                block.add_row(heading, re.sub(r" *\n *", "\n", re.sub(r"  +", "  ", cell.strip())))
        head = f"{first}: {name}" if first else name
        blocks += [Text(" ".join(head.split()), style=row.style or "bold"), Padding(block, (0, 0, 0, 2))]
    return [*blocks, *([Text(_plain(table.caption), style="italic")] if table.caption else [])]


def _plain(content: RenderableType | None) -> str:
    return content.plain if isinstance(content, Text) else "" if content is None else str(content)
