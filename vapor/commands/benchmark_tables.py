"""The tables of `vapor-track benchmark localization` and `benchmark faults`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from vapor.benchmark.faults import FAULT_S, FAULTS, LONG_S, NONE, NOTICED_S, SETTLED_S
from vapor.benchmark.summary import OFTEN, WITHIN_IMAGES
from vapor.benchmark.windows import KINDS
from vapor.evaluation.consistency import REGIONS
from vapor.evaluation.intervals import Interval, dissent
from vapor.evaluation.trajectory import THRESHOLDS
from vapor.tracking.methods import BASELINES, METHODS

Aggregate = Mapping[str, Any]
Summary = Mapping[str, Mapping[str, Mapping[str, Aggregate]]]

_BELIEVERS = ("filter", *BASELINES)
_OWN = {
    "cue": ("success", "conv.\nat"),
    "no-cue": ("wrong\nruns", "longest\nwrong"),
    "kidnap": (f"within\n{WITHIN_IMAGES}", "median\nimages"),
}


def tables(summary: Summary) -> Iterator[Table]:
    """Per scene and kind of run: the methods, how honest they are, after a kidnap their recovery, and the variants.

    Last, for every scene, kinds that are alike side by side. The second line of a cell is its 95 % interval over walks.
    """
    for scene, kinds in summary.items():
        alike: dict[str, dict[str, Aggregate]] = {}
        for kind, variants in kinds.items():
            shown, total = ("full", variants["full"]) if "full" in variants else next(iter(variants.items()))
            of_variant = "" if shown == "full" else f", filter {shown}"
            runs = f"{total['runs']} runs from {total['walks']} walks"
            yield _methods_table(f"{scene}, {KINDS[kind].meaning}: {runs}{of_variant}", total)
            yield _honesty_table(total)
            yield _status_table(total)
            if kind == "kidnap":
                yield _recovery_table(total)
            if "floor" in total["methods"]["filter"]:
                yield _floor_table(total)
            if len(variants) > 1:
                yield _comparison_table(None, "variant", KINDS[kind].like, variants)
            alike.setdefault(KINDS[kind].like, {})[f"{kind}{of_variant}"] = total
        for like, totals in alike.items():
            if len(totals) > 1:
                yield _comparison_table(f"{scene}, the filter by kind of run", "kind", like, totals)


def failures(summary: Summary) -> Iterator[str]:
    """A line for every scene, kind and variant in which runs failed, with their names."""
    for kinds in summary.values():
        for variants in kinds.values():
            for variant, total in variants.items():
                if total["failed"]:
                    yield f"failed, {variant}: {' '.join(total['failed'])}"


def fault_tables(summary: Mapping[str, Mapping[str, Aggregate]]) -> Iterator[Table]:
    """Per scene: what the methods are worth without a fault, and with each."""
    for scene, faults in summary.items():
        table = _table(
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
            *(f"\n{METHODS[name].short_label or METHODS[name].label}" for name in BASELINES),
        )
        table.columns[0].no_wrap = True
        for name, total in faults.items():
            ours, *others = (total["methods"][method] for method in _BELIEVERS)
            table.add_row(
                "no fault" if name == NONE else FAULTS[name].meaning,
                str(ours["successes"]),
                *(_percent(ours[key]) for key in ("right", "right_after", "converged", "lost", "noticed")),
                _percent(ours["sure_and_wrong"], 1),
                f"{ours['longest_s']:.1f} s",
                *(f"{each['successes']} {_percent(each['right']):>3}" for each in others),
            )
        lost = _share(faults[NONE]["methods"]["filter"]["lost_ever"], 1)
        table.caption = (
            f"In % of the images from the fault's beginning on; it lasts {FAULT_S:g} s where nothing else is said."
            f" {SETTLED_S:g} s after: right from {SETTLED_S:g} s after its end on. From {NOTICED_S:g} s: lost from"
            f" {NOTICED_S:g} s after its beginning to its end. At most: the longest that any walk was sure and wrong."
            f" {' and '.join(METHODS[name].label for name in BASELINES)}: success and right."
            f" Without a fault {lost} of all images of the walks are called lost."
        )
        yield table


def fault_failures(summary: Mapping[str, Mapping[str, Aggregate]]) -> Iterator[str]:
    """A line for every fault with which the filter had no success in some walks, or was sure and wrong for long."""
    for faults in summary.values():
        for name, total in faults.items():
            ours = total["methods"]["filter"]
            if ours["unsuccessful"]:
                yield f"no success, {name}: {' '.join(ours['unsuccessful'])}"
            if ours["sure_and_wrong_walks"]:
                when = [
                    f"{walk} ({duration:.1f} s from {first:.1f} s on)"
                    for walk, (first, duration) in ours["sure_and_wrong_walks"].items()
                ]
                yield f"sure and wrong for longer than {LONG_S:g} s, {name}: {', '.join(when)}"


def _methods_table(title: str, total: Aggregate) -> Table:
    limits = ["recall\n{}\n{}°".format(*name.removesuffix("deg").replace("m", " m").split("/")) for name in THRESHOLDS]
    table = _table(title, "method", "success", "found\nat", "median\nerror", *limits)
    for name in METHODS:
        method = total["methods"][name]
        tracking, between = "successes" in method, method["intervals"]
        table.add_row(
            _named(name),
            _over(str(method["successes"]), _between(between["successes"], ".0f")) if tracking else "",
            _number(method["converged_at_s"], ".1f", " s") if tracking else "",
            _over(
                f"{method['median_translation_m']:.3f} m {method['median_rotation_deg']:5.1f}°",
                _between(between["median_translation_m"], ".3f"),
            ),
            *(
                _over(_share(method["recall"][limit]), _between(between["recall"][limit], ".0f", 100))
                for limit in THRESHOLDS
            ),
        )
        if tracking:
            later = (_share(method["recall_after_convergence"][limit]) for limit in THRESHOLDS)
            table.add_row("  from then on", "", "", "", *later)
    return table


def _honesty_table(total: Aggregate) -> Table:
    """Two rows a method: over the images that say "converged", and over those from when on the method was right."""
    regions = [f"in {region.replace('%', ' %')}\nregion" for region in REGIONS]
    table = _table(None, "over the images", "number", "wrong", *regions, "median\nNEES (5.3)")
    for method in _BELIEVERS:
        for key, meaning in (("said_converged", "said converged"), ("after_convergence", "from found on")):
            part = total["belief"][method][key]
            table.add_row(f"{_named(method)}\n  {meaning}", str(part["images"]), *_honesty(part))
    return table


def _status_table(total: Aggregate) -> Table:
    """What the methods say of themselves, over all images, and in how many runs and how long it is a wrong place.

    False recoveries with the number of runs that have any; "often": in at least 5 % of a run's images.
    """
    table = _table(
        None,
        "method",
        "conv.",
        "rightly",
        "lost",
        "truth in\nmodes",
        "false\nrecov.",
        "wrong\nruns",
        f"often\n({100 * OFTEN:.0f} %)",
        "longest\nwrong",
    )
    for method in _BELIEVERS:
        belief = total["belief"][method]
        table.add_row(
            _named(method),
            _share(belief["status"]["converged"]),
            _over(_share(belief["rightly_converged"]), _between(belief["intervals"]["rightly_converged"], ".0f", 100)),
            _share(belief["status"]["lost"]),
            _share(belief["truth_among_modes"]),
            f"{belief['false_recoveries']} ({belief['runs_with_false_recovery']})",
            _over(
                str(belief["runs_wrongly_converged"]), _between(belief["intervals"]["runs_wrongly_converged"], ".0f")
            ),
            str(belief["runs_wrongly_converged_often"]),
            f"{belief['longest_wrong_s']:.1f} s",
        )
    table.caption = (
        f"single image: truth among its modes in {_share(total['image_truth_among_modes'])}\n"
        f"step of the filter: {total['step_ms']:.1f} ms, {total['particles']:.0f} particles\n"
        f"below figures: 95 % intervals over {total['walks']} walks;"
        f" where all agree, up to {_share(dissent(total['walks']))} of others may not"
    )
    return table


def _recovery_table(total: Aggregate) -> Table:
    table = _table(None, "method", "right before", f"right within {WITHIN_IMAGES} images", "ever", "median images")
    for method in _BELIEVERS:
        kidnap = total["belief"][method]["kidnap"]
        table.add_row(
            _named(method),
            str(kidnap["right_before"]),
            _over(str(kidnap["recovered_in_time"]), _between(kidnap["intervals"]["recovered_in_time"], ".0f")),
            str(kidnap["recovered"]),
            _number(kidnap["median_images"], ".0f"),
        )
    return table


def _floor_table(total: Aggregate) -> Table:
    """Where floors look alike: over the images from when on the floor is right to the end, and of all but for it."""
    regions = [f"in {region.replace('%', ' %')}\nregion" for region in REGIONS]
    columns = ["once on its\nfloor: images", "right", *regions, "median\nNEES (5.3)", "right but\nfor floor"]
    table = _table(None, "method", *columns)
    for name in METHODS:
        floor = total["methods"][name]["floor"]
        between = floor["intervals"]
        believed = total["belief"].get(name, {}).get("on_floor")
        table.add_row(
            _named(name),
            str(floor["settled_images"]),
            _over(_share(floor["settled_right"], 1), _between(between["settled_right"], ".1f", 100)),
            *([""] * (len(REGIONS) + 1) if believed is None else _honesty(believed)[1:]),
            _over(_share(floor["but_for_it"], 1), _between(between["but_for_it"], ".1f", 100)),
        )
    return table


def _comparison_table(title: str | None, what: str, like: str, totals: Mapping[str, Aggregate]) -> Table:
    """The filter over the images that it calls converged, a row for each variant or kind of run."""
    regions = [f"in\n{region.replace('%', ' %')}" for region in REGIONS]
    columns = [*_OWN[like], "median\nerror", "right,\nconv.", "wrong", *regions, "NEES"]
    table = _table(title, what, *columns)
    table.padding = (0, 0)
    table.caption = "wrong, in regions and NEES: of the images said converged; below figures: 95 % intervals over walks"
    for name, total in totals.items():
        belief, method = total["belief"]["filter"], total["methods"]["filter"]
        table.add_row(
            name,
            *_own_figures(like, total),
            _over(
                f"{100 * method['median_translation_m']:.1f} cm",
                _between(method["intervals"]["median_translation_m"], ".1f", 100),
            ),
            _over(_share(belief["rightly_converged"]), _between(belief["intervals"]["rightly_converged"], ".0f", 100)),
            *_honesty(belief["said_converged"]),
        )
    return table


def _own_figures(like: str, total: Aggregate) -> tuple[str, str]:
    """The two figures that a kind of run is about, as headed by `_OWN`."""
    belief, method = total["belief"]["filter"], total["methods"]["filter"]
    if like == "cue":
        number, between = method["successes"], method["intervals"]["successes"]
        other = _number(method["converged_at_s"], ".1f", " s")
    elif like == "no-cue":
        number, between = belief["runs_wrongly_converged"], belief["intervals"]["runs_wrongly_converged"]
        other = f"{belief['longest_wrong_s']:.1f} s"
    else:
        kidnap = belief["kidnap"]
        number, between = kidnap["recovered_in_time"], kidnap["intervals"]["recovered_in_time"]
        other = _number(kidnap["median_images"], ".0f")
    return _over(f"{number}/{total['runs']}", _between(between, ".0f")), other


def _honesty(part: Aggregate) -> list[str]:
    """Share wrong, shares in the regions and NEES of some images, with their intervals."""
    between = part["intervals"]
    regions = [(part["coverage"][region], between["coverage"][region]) for region in REGIONS]
    return [
        _over(_share(part["wrong"], 1), _between(between["wrong"], ".1f", 100)),
        *(_over(_share(share), _between(interval, ".0f", 100)) for share, interval in regions),
        _over(_number(part["median_nees"], ".1f"), _between(between["median_nees"], ".1f")),
    ]


def _table(title: str | None, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", caption_justify="left", box=SIMPLE_HEAD, collapse_padding=True)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right", no_wrap=i > 0, overflow="fold")
    return table


def _named(method: str) -> str:
    return method.replace("_", " ")


def _share(value: float | None, digits: int = 0) -> str:
    return "–" if value is None else f"{100 * value:.{digits}f} %"


def _percent(value: float | None, digits: int = 0) -> str:
    return "–" if value is None else f"{100 * value:.{digits}f}"


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "–" if value is None else f"{value:{form}}{unit}"


def _between(interval: Interval | None, form: str, factor: int = 1) -> str:
    return "" if interval is None else f"{factor * interval[0]:{form}}–{factor * interval[1]:{form}}"


def _over(figure: str, below: str) -> str:
    """A cell of two lines, of one where there is nothing below."""
    return "\n".join(line for line in (figure, below) if line.strip())
