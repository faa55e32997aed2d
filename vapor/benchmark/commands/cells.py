"""Tables as the benchmarks print them: their look, and how figures and their intervals are written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from vapor.benchmark.evaluation import Interval

Aggregate = Mapping[str, Any]
"""What some runs add up to."""


def new_table(title: str | None, *columns: str) -> Table:
    """A table of figures, with names in its first column."""
    table = Table(title=title, title_justify="left", caption_justify="left", box=SIMPLE_HEAD, collapse_padding=True)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right", no_wrap=i > 0)
    return table


def fraction(value: float | None, digits: int = 0) -> str:
    """A fraction in per cent, with its unit."""
    return "–" if value is None else f"{percent(value, digits)} %"


def percent(value: float | None, digits: int = 0) -> str:
    """A fraction in per cent, without its unit."""
    return "–" if value is None else f"{100 * value:.{digits}f}"


def figure(value: float | None, form: str, unit: str = "") -> str:
    """A figure, with its unit."""
    return "–" if value is None else f"{value:{form}}{unit}"


def interval(bounds: Interval | None, form: str, factor: int = 1) -> str:
    """An interval; empty if there is none."""
    return "" if bounds is None else f"{factor * bounds[0]:{form}}–{factor * bounds[1]:{form}}"


def over(above: str, below: str) -> str:
    """A cell of two lines, or of one if there is nothing below."""
    return "\n".join(line for line in (above, below) if line.strip())
