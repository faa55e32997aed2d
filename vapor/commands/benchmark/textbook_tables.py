"""The tables of `vapor-track benchmark textbook`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.table import Table

from vapor.benchmark.textbook.building_blocks import REACH_M, SURE
from vapor.benchmark.textbook.methods import OURS
from vapor.benchmark.textbook.networks import PAPER
from vapor.benchmark.trials.kinds import KINDS
from vapor.commands.benchmark.cells import Aggregate, fraction, interval, new_table, over


def filter_tables(summary: Mapping[str, Mapping[str, Mapping[str, Aggregate]]]) -> Iterator[Table]:
    """Per scene and kind of run: every filter, how long a step takes, and how well it does."""
    for scene, kinds in summary.items():
        for kind, methods in kinds.items():
            ours = methods[OURS]
            table = new_table(
                f"{scene}, {KINDS[kind].meaning}: {ours['runs']} runs from {ours['walks']} walks",
                "filter",
                "par-\nticles",
                "ms a step\nmedian",
                "\n95 %",
                "times\nours",
                "\nsuccess",
                "median\nerror",
                "said con-\nverged",
                "of these\nwrong",
            )
            for key, total in sorted(methods.items(), key=lambda each: _rank(each[0])):
                table.add_row(_named(key), *_cells(total))
            table.caption = (
                "Below a figure: its 95 % interval over walks. Filters side by side, processor time. Textbook filters"
                f" say converged where {100 * SURE:.0f} % of the weight is within {REACH_M} m of the best pose."
            )
            yield table


def network_table(scene: str, preset: str, timings: Sequence[Mapping[str, Any]]) -> Table:
    """How long networks and the whole step take."""
    table = new_table(
        f"{scene}, network of {preset} beside ours, one thread", "part", "median ms", "95 % ms", "of paper's"
    )
    paper = next(each for each in timings if each["part"] == PAPER)
    for each in timings:
        ratio = f"{each['median_ms'] / paper['median_ms']:.2f}"
        table.add_row(each["part"], f"{each['median_ms']:.1f}", f"{each['p95_ms']:.1f}", ratio)
    return table


def _cells(total: Aggregate) -> list[str]:
    intervals, successes = total["intervals"], total["successes"]
    return [
        f"{total['particles']:.0f}",
        f"{total['median_ms']:.1f}",
        f"{total['p95_ms']:.1f}",
        over(f"{total['over_ours']:.1f}", interval(intervals["over_ours"], ".1f")),
        "–" if successes is None else over(f"{successes}/{total['runs']}", interval(intervals["successes"], ".0f")),
        over(
            f"{100 * total['median_translation_m']:.1f} cm",
            interval(intervals["median_translation_m"], ".1f", 100),
        ),
        fraction(total["converged"]),
        over(fraction(total["converged_and_wrong"], 1), interval(intervals["converged_and_wrong"], ".1f", 100)),
    ]


def _named(key: str) -> str:
    name, _, count = key.partition("-")
    return "ours" if key == OURS else f"ours, all {count} kept" if name == OURS else name


def _rank(key: str) -> tuple[str, int]:
    name, _, count = key.partition("-")
    return ("" if name == OURS else name), int(count or 0)
