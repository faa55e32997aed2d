"""Figures of many runs with their intervals, and the tables that have them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float64
from rich.box import SIMPLE_HEAD
from rich.table import Table

Row = TypeVar("Row")
Number = int | float


class Figure(NamedTuple):
    """A figure of several runs, None if no run has one, and its interval, if there is one."""

    value: Number | None
    low: float | None = None
    high: float | None = None


UNKNOWN = Figure(None)


def values_at(results: Sequence[Mapping[str, Any]], *keys: str) -> list[Any]:
    """A value of every result, by the keys that lead to it; None where there is none on the way."""
    values: list[Any] = list(results)
    for key in keys:
        values = [value and value[key] for value in values]
    return values


def spread(values: Sequence[Number | None]) -> Figure:
    """The median of the values that are known, with the lowest and the highest where they differ."""
    known = [value for value in values if value is not None]
    if not known:
        return UNKNOWN
    low, high = min(known), max(known)
    return Figure(float(np.median(known)), *((low, high) if low < high else ()))


_RESAMPLES = 1000
_TAILS = (2.5, 97.5)  # percentiles: 95 % lie between


class Walks:
    """The walks of n ≥ 1 runs, drawn a thousand times with replacement: all runs cut from a walk come with it.

    Intervals are percentiles of a figure over these draws (bootstrap of clusters: Davison and Hinkley, "Bootstrap
    Methods and Their Application", 1997, §3.8); the same runs give the same. There is no interval where fewer than two
    walks have a value. Where all walks agree it has no width, which is no proof: see `dissent`.

    Args:
        walks: Which walk each run is cut from, (n,).
    """

    def __init__(self, walks: Sequence[int]) -> None:
        self._walk = np.unique(walks, return_inverse=True)[1]
        every = self.count
        drawn = np.random.default_rng(0).multinomial(every, np.full(every, 1.0 / every), size=_RESAMPLES)
        self._times = drawn[:, self._walk]  # how often each run is in each draw

    @property
    def count(self) -> int:
        """How many walks there are."""
        return int(self._walk.max()) + 1

    def mean(self, values: Sequence[Number | None], weights: Sequence[Number] | None = None) -> Figure:
        """Mean of the runs' values (n,), weighted if asked for; runs without a value do not count."""
        known = np.array([value is not None for value in values])
        weight = known * (1.0 if weights is None else np.array(weights, np.float64))
        if not weight.any():
            return UNKNOWN
        weighted = weight * np.array([value or 0.0 for value in values])
        total, of_draws = self._times @ weight, self._times @ weighted
        return self._figure(weighted.sum() / weight.sum(), known, of_draws[total > 0] / total[total > 0])

    def number(self, flags: Sequence[bool]) -> Figure:
        """How many of the runs have a flag, (n,)."""
        _, *bounds = self.mean(flags)
        return Figure(sum(flags), *(None if bound is None else len(flags) * bound for bound in bounds))

    def median(self, values: Sequence[Number | None]) -> Figure:
        """Median of the runs' values (n,); runs without one do not count."""
        known = np.array([value is not None for value in values])
        numbers = np.array([value for value in values if value is not None], np.float64)
        if not len(numbers):
            return UNKNOWN
        order = np.argsort(numbers)
        up_to = np.cumsum(self._times[:, known][:, order], axis=1)
        up_to = up_to[up_to.any(axis=1)]
        total = up_to[:, -1:]
        middle = [(up_to <= rank).sum(axis=1) for rank in ((total - 1) // 2, total // 2)]
        return self._figure(np.median(numbers), known, numbers[order][np.array(middle)].mean(axis=0))

    def _figure(self, value: float, known: np.ndarray, of_draws: Float64[np.ndarray, " k"]) -> Figure:
        if len(np.unique(self._walk[known])) < 2:
            return Figure(float(value))
        low, high = np.percentile(of_draws, _TAILS)
        return Figure(float(value), float(low), float(high))


def dissent(walks: int) -> float:
    """The largest fraction of walks that are otherwise, with 95 % confidence, where so many agree: about 3 in n."""
    return 1.0 - 0.05 ** (1.0 / walks)


# --- tables -----------------------------------------------------------------------------------------


def new_table(title: str | None, *columns: str) -> Table:
    """A table of figures, with names in its first column."""
    table = Table(title=title, title_justify="left", caption_justify="left", box=SIMPLE_HEAD, collapse_padding=True)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right", no_wrap=i > 0)
    return table


def table_of(
    title: str | None, what: str, columns: Mapping[str, Callable[[Row], str]], rows: Mapping[str, Row]
) -> Table:
    """A table of figures.

    Args:
        title: Its title; None for a table that belongs to the one before.
        what: Heading of the names of the rows.
        columns: By its heading the cell of a row in each column.
        rows: The rows by name.
    """
    table = new_table(title, what, *columns)
    for name, row in rows.items():
        table.add_row(name, *(cell(row) for cell in columns.values()))
    return table


def text(value: Number | None, form: str = ".0f", unit: str = "", factor: float = 1.0) -> str:
    """A number with its unit."""
    return "–" if value is None else f"{factor * value:{form}}{unit}"


def percent(value: Number | None, digits: int = 0, unit: str = " %") -> str:
    """A fraction in per cent."""
    return text(value, f".{digits}f", unit, 100.0)


def cell(figure: Figure, form: str = ".0f", unit: str = "", factor: float = 1.0) -> str:
    """A figure with its unit, and its interval below."""
    return above(text(figure.value, form, unit, factor), figure, lambda bound: text(bound, form, "", factor))


def percent_cell(figure: Figure, digits: int = 0) -> str:
    """A fraction in per cent, and its interval below."""
    return cell(figure, f".{digits}f", " %", 100.0)


def above(shown: str, figure: Figure, number: Callable[[Number], str]) -> str:
    """A figure as shown, and its interval below, if there is one."""
    if figure.low is None or figure.high is None:
        return shown
    return f"{shown}\n{number(figure.low)}–{number(figure.high)}"


Aggregate = Mapping[str, Any]
"""Sums over some runs."""
