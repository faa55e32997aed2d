"""A table that is printed in a terminal -> the same on a page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.text import Text as RichText

from vapor.reporting.html.page import Table

if TYPE_CHECKING:
    from rich.table import Table as RichTable


def printed_table(table: RichTable, caption: str = "") -> Table:
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
