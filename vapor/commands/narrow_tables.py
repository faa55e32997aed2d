"""Tables where a terminal is too narrow for them: without lines, or a block for each row instead."""

from __future__ import annotations

import re
from copy import copy

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

_WIDE = 10_000


def fitting(table: Table, console: Console) -> RenderableType:
    """A table, or it without its lines, if it fits the width with every figure in one line; else a block for each row.

    A block is headed by heading and cell of the first column, and has a line with those of each of the others.
    """
    words = _words(_rendered(table, console, _WIDE))
    cells = [_plain(cell) for column in table.columns[1:] for cell in column.cells]
    figures = {line.strip() for cell in cells for line in cell.splitlines()}
    for each in (table, _narrow(table)):
        shown = _rendered(each, console, console.width)
        if _words(shown) == words and all(figure in shown for figure in figures):
            return each
    return Group(*_blocks(table))


def _narrow(table: Table) -> Table:
    """The same with a space between columns, and no lines but that below the headings."""
    narrow = copy(table)
    narrow.box, narrow.padding, narrow.pad_edge, narrow.show_edge = SIMPLE_HEAD, (0, 0), False, False
    return narrow


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
