"""The tables of `vapor-benchmark faults`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rich.table import Table

from vapor.benchmark.commands.cells import Aggregate, fraction, new_table, percent
from vapor.benchmark.faults.table import FAULTS, NONE
from vapor.benchmark.faults.timing import FAULT_S, LONG_S, NOTICED_S, SETTLED_S
from vapor.benchmark.methods import OURS, ours_first, short_label


def fault_tables(summary: Mapping[str, Mapping[str, Aggregate]]) -> Iterator[Table]:
    """Per scene: how well the methods do without a fault, and with each."""
    others = [short_label(method) for method in ours_first()[1:]]
    for scene, faults in summary.items():
        table = new_table(
            f"{scene}: {faults[NONE]['walks']} walks without a fault, and with each",
            "filter",
            "suc-\ncess",
            "\nright",
            f"{SETTLED_S:g} s\nafter",
            "\nconv.",
            "\nlost",
            f"from\n{NOTICED_S:g} s",
            "sure,\nwrong",
            "at\nmost",
            *(f"\n{name}" for name in others),
        )
        table.columns[0].no_wrap = True
        for name, total in faults.items():
            ours, *theirs = (total["methods"][method] for method in ours_first())
            table.add_row(
                "no fault" if name == NONE else FAULTS[name].meaning,
                str(ours["successes"]),
                *(percent(ours[key]) for key in ("right", "right_after", "converged", "lost", "noticed")),
                percent(ours["sure_and_wrong"], 1),
                f"{ours['longest_s']:.1f} s",
                *(f"{each['successes']} {percent(each['right']):>3}" for each in theirs),
            )
        lost = fraction(faults[NONE]["methods"][OURS]["lost_ever"], 1)
        table.caption = (
            f"In % of the images from the fault's beginning on; it lasts {FAULT_S:g} s where nothing else is said."
            f" {SETTLED_S:g} s after: right from {SETTLED_S:g} s after its end on. From {NOTICED_S:g} s: lost from"
            f" {NOTICED_S:g} s after its beginning to its end. At most: the longest that any walk was sure and wrong."
            f" {' and '.join(others)}: success and right."
            f" Without a fault {lost} of all images of the walks are called lost."
        )
        yield table


def fault_failures(summary: Mapping[str, Mapping[str, Aggregate]]) -> Iterator[str]:
    """A line for every fault with which the filter had no success in some walks, or was sure and wrong for long."""
    for faults in summary.values():
        for name, total in faults.items():
            ours = total["methods"][OURS]
            if ours["unsuccessful"]:
                yield f"no success, {name}: {' '.join(ours['unsuccessful'])}"
            if ours["sure_and_wrong_walks"]:
                when = [
                    f"{walk} ({duration:.1f} s from {first:.1f} s on)"
                    for walk, (first, duration) in ours["sure_and_wrong_walks"].items()
                ]
                yield f"sure and wrong for longer than {LONG_S:g} s, {name}: {', '.join(when)}"
