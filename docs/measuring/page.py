"""The page of the measurements, from their list and their results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from docs.measuring.measurement import Measurement, Measurements

_UNITS = {"cm": (100.0, 1), "%": (100.0, 0), "min": (1.0 / 60.0, 0), "s": (1.0, 1), "ms": (1.0, 1), "°": (1.0, 2)}
"""By how much a number is multiplied in a column of a unit, and its usual digits; any other unit: as it is, whole."""


def page_of(measurements: Measurements) -> str:
    """The whole page, as Markdown."""
    parts = [measurements.introduction.strip()]
    under = ""
    for name, each in measurements.entries.items():
        if each.part != under:
            parts.append(f"## {each.part}")
            under = each.part
        parts += _section(each, measurements.result(name))
    return "\n\n".join(parts) + "\n"


def _section(entry: Measurement, result: Mapping[str, Any] | None) -> Iterator[str]:
    yield f"### {entry.title}"
    yield entry.about.strip()
    for table in [] if result is None else result["tables"]:
        yield _table(table)
    if entry.note:
        yield entry.note.strip()
    yield "```sh\n" + "\n".join(command.strip() for command in entry.commands) + "\n```"
    yield f"*{_provenance(entry, result)}*"


def _provenance(entry: Measurement, result: Mapping[str, Any] | None) -> str:
    if result is None:
        return "Not measured yet."
    minutes = max(round(result["seconds"] / 60), 1)
    took = f"{minutes} min" if minutes < 120 else f"{minutes / 60:.1f} h"
    changed = "" if result["commands"] == [command.strip() for command in entry.commands] else " by earlier commands"
    of_code = f"{result['version']}, commit {result['commit']}"
    return f"Measured on {result['date']}{changed}: {of_code}, {took} on {result['processor']}."


def _table(table: Mapping[str, Any]) -> str:
    title = f"{table['title']}:\n\n" if "title" in table else ""
    if "text" in table:
        return f"{title}```text\n{table['text']}\n```"
    columns = table["columns"]
    lines = [_line([table.get("first", ""), *map(_heading, columns)]), "|---" * (1 + len(columns)) + "|"]
    for name, cells in table["rows"]:
        lines.append(_line([name, *(_shown(cell, column) for cell, column in zip(cells, columns, strict=True))]))
    return title + "\n".join(lines)


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _heading(column: Mapping[str, Any]) -> str:
    return f"{column['name']}, {column['unit']}" if column.get("unit") else column["name"]


def _shown(cell: Any, column: Mapping[str, Any]) -> str:
    factor, digits = _UNITS.get(column.get("unit", ""), (1.0, 0))
    digits = column.get("digits", digits)

    def number(value: float | None) -> str:
        return "–" if value is None else f"{factor * value:.{digits}f}"

    if isinstance(cell, str):
        return cell
    if isinstance(cell, list):
        return ", ".join(map(number, cell))
    if not isinstance(cell, Mapping):
        return number(cell)
    if "of" in cell:
        low, high = (round(cell["of"] * cell[bound]) for bound in ("low", "high"))
        return f"{cell['value']} of {cell['of']} ({low}–{high})"
    value, low, high = (number(cell[key]) for key in ("value", "low", "high"))
    return value if value == low == high else f"{value} ({low}–{high})"
