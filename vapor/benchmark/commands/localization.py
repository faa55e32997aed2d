"""`vapor-benchmark localization`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.cells import Aggregate, figure, fraction, interval, new_table, over
from vapor.benchmark.commands.options import (
    SceneOptions,
    claim_shared,
    described,
    publish_results,
    with_help,
    write_summary,
)
from vapor.benchmark.evaluation import LAST, OURS, SUCCESS_M, dissent, label, ours_first
from vapor.benchmark.localization import OFTEN, WITHIN_IMAGES, LocalizationBenchmark, LocalizationConfig, summarise
from vapor.benchmark.trials.choose import KINDS
from vapor.commands.console import command_line, parse, show
from vapor.commands.progress import progress
from vapor.commands.workers import workers_for
from vapor.evaluation.consistency import REGIONS
from vapor.evaluation.trajectory import POSITION_M, THRESHOLDS
from vapor.parallel.jobs import Workers
from vapor.reporting.html.page import Page, findings_page, write_page
from vapor.tracking.ablations import ABLATIONS
from vapor.tracking.methods import METHODS

Summary = Mapping[str, Mapping[str, Mapping[str, Aggregate]]]

_OWN = {
    "cue": ("success", "conv.\nat"),
    "no-cue": ("wrong\nruns", "longest\nwrong"),
    "kidnap": (f"within\n{WITHIN_IMAGES}", "median\nimages"),
}


def tables(summary: Summary) -> Iterator[Table]:
    """Per scene and kind of run: the methods, their consistency, after a kidnap their recovery, and the ablations.

    Last, for every scene, kinds that are alike side by side. The second line of a cell is its 95 % interval over walks.
    """
    for scene, kinds in summary.items():
        alike: dict[str, dict[str, Aggregate]] = {}
        for kind, ablations in kinds.items():
            shown, total = ("full", ablations["full"]) if "full" in ablations else next(iter(ablations.items()))
            of_ablation = "" if shown == "full" else f", filter {shown}"
            runs = f"{total['runs']} runs from {total['walks']} walks"
            yield _methods_table(f"{scene}, {KINDS[kind].meaning}: {runs}{of_ablation}", total)
            yield _consistency_table(total)
            yield _status_table(total)
            yield _position_table(total)
            if kind == "kidnap":
                yield _recovery_table(total)
            if "storey" in total["methods"][OURS]:
                yield _storey_table(total)
            if len(ablations) > 1:
                yield _comparison_table(None, "ablation", KINDS[kind].like, ablations)
            alike.setdefault(KINDS[kind].like, {})[f"{kind}{of_ablation}"] = total
        for like, totals in alike.items():
            if len(totals) > 1:
                yield _comparison_table(f"{scene}, the filter by kind of run", "kind", like, totals)


def headline(summary: Summary) -> str:
    """The result, a sentence for each scene and kind of run."""
    sentences = []
    for scene, kinds in summary.items():
        for kind, ablations in kinds.items():
            total = ablations.get("full") or next(iter(ablations.values()))
            own, sure = total["methods"][OURS], total["belief"][OURS]["converged_images"]
            wrong = round((sure["wrong"] or 0.0) * sure["images"])
            doubt = f"sure and wrong in {wrong or 'none'} of the {sure['images']} images that it called converged"
            found = f"finds its place in {own['successes']} of {total['runs']} runs, and " if "successes" in own else ""
            trusted = doubt if sure["images"] else "never sure"
            sentences.append(f"{scene}, {KINDS[kind].meaning}: the filter {found}is {trusted}.")
    return " ".join(f"{text[0].upper()}{text[1:]}" for text in sentences)


def failures(summary: Summary) -> Iterator[str]:
    """A line for every scene, kind and ablation with runs that failed, with their names."""
    for kinds in summary.values():
        for ablations in kinds.values():
            for ablation, total in ablations.items():
                if total["failed"]:
                    yield f"failed, {ablation}: {' '.join(total['failed'])}"


def _methods_table(title: str, total: Aggregate) -> Table:
    limits = ["recall\n{}\n{}°".format(*name.removesuffix("deg").replace("m", " m").split("/")) for name in THRESHOLDS]
    table = new_table(title, "method", "success", "found\nat", "median\nerror", *limits)
    for name in METHODS:
        method = total["methods"][name]
        tracking, intervals = "successes" in method, method["intervals"]
        table.add_row(
            label(name),
            over(str(method["successes"]), interval(intervals["successes"], ".0f")) if tracking else "",
            figure(method["converged_at_s"], ".1f", " s") if tracking else "",
            over(
                f"{method['median_translation_m']:.3f} m {method['median_rotation_deg']:5.1f}°",
                interval(intervals["median_translation_m"], ".3f"),
            ),
            *(
                over(fraction(method["recall"][limit]), interval(intervals["recall"][limit], ".0f", 100))
                for limit in THRESHOLDS
            ),
        )
        if tracking:
            later = (fraction(method["recall_after_convergence"][limit]) for limit in THRESHOLDS)
            table.add_row("  from then on", "", "", "", *later)
    return table


def _consistency_table(total: Aggregate) -> Table:
    """Two rows a method: over the "converged" images, and over those from its convergence on."""
    regions = [f"in {region.replace('%', ' %')}\nregion" for region in REGIONS]
    table = new_table(None, "over the images", "number", "wrong", *regions, "median\nNEES (5.3)")
    for method in ours_first():
        for key, meaning in (("converged_images", "converged"), ("after_convergence", "from found on")):
            part = total["belief"][method][key]
            table.add_row(f"{label(method)}\n  {meaning}", str(part["images"]), *_consistency(part))
    return table


def _status_table(total: Aggregate) -> Table:
    """Statuses of the methods over all images, and in how many runs and for how long they are wrong.

    False recoveries with the number of runs that have any; "often": in at least 5 % of a run's images.
    """
    table = new_table(
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
    for method in ours_first():
        belief = total["belief"][method]
        table.add_row(
            label(method),
            fraction(belief["status"]["converged"]),
            over(fraction(belief["rightly_converged"]), interval(belief["intervals"]["rightly_converged"], ".0f", 100)),
            fraction(belief["status"]["lost"]),
            fraction(belief["truth_among_modes"]),
            f"{belief['false_recoveries']} ({belief['runs_with_false_recovery']})",
            over(str(belief["runs_wrongly_converged"]), interval(belief["intervals"]["runs_wrongly_converged"], ".0f")),
            str(belief["runs_wrongly_converged_often"]),
            f"{belief['longest_wrong_s']:.1f} s",
        )
    table.caption = (
        f"single image: truth among its modes in {fraction(total['image_truth_among_modes'])}\n"
        f"step of the filter: {total['step_ms']:.1f} ms, {total['particles']:.0f} particles\n"
        f"below figures: 95 % intervals over {total['walks']} walks;"
        f" where all agree, up to {fraction(dissent(total['walks']))} of others may not"
    )
    return table


def _position_table(total: Aggregate) -> Table:
    """As others report: positions alone, storeys where there are several, and short sequences from a flat prior."""
    lengths = total.get("sequences", {})
    has_storeys = "storey_accuracy" in total["methods"][OURS]
    columns = [f"within\n{name.replace('m', ' m')}" for name in POSITION_M]
    columns += ["right\nstorey"] if has_storeys else []
    columns += [f"{length} images\n{limit.replace('m', ' m')}" for length in lengths for limit in SUCCESS_M]
    table = new_table(None, "method", *columns)
    for name in METHODS:
        method = total["methods"][name]
        intervals = method["intervals"]
        cells = [(method["position_recall"][limit], intervals["position_recall"][limit]) for limit in POSITION_M]
        cells += [(method["storey_accuracy"], intervals["storey_accuracy"])] if has_storeys else []
        for part in lengths.values():
            if name in part["success"]:
                cells += [(part["success"][name][limit], part["intervals"][name][limit]) for limit in SUCCESS_M]
        table.add_row(label(name), *(over(fraction(value), interval(bounds, ".0f", 100)) for value, bounds in cells))
    if lengths:
        parts_of_walks = " and ".join(f"{part['sequences']} of {length} images" for length, part in lengths.items())
        table.caption = f"sequences, each from a flat prior: {parts_of_walks}; right at all of the last {LAST} images"
    return table


def _recovery_table(total: Aggregate) -> Table:
    table = new_table(None, "method", "right before", f"right within {WITHIN_IMAGES} images", "ever", "median images")
    for method in ours_first():
        kidnap = total["belief"][method]["kidnap"]
        table.add_row(
            label(method),
            str(kidnap["right_before"]),
            over(str(kidnap["recovered_in_time"]), interval(kidnap["intervals"]["recovered_in_time"], ".0f")),
            str(kidnap["recovered"]),
            figure(kidnap["median_images"], ".0f"),
        )
    return table


def _storey_table(total: Aggregate) -> Table:
    """Where storeys look alike: over the images once the storey is right to the end, and over all, right but for it."""
    regions = [f"in {region.replace('%', ' %')}\nregion" for region in REGIONS]
    columns = ["once on its\nstorey: images", "right", *regions, "median\nNEES (5.3)", "right but\nfor storey"]
    table = new_table(None, "method", *columns)
    for name in METHODS:
        storey = total["methods"][name]["storey"]
        intervals = storey["intervals"]
        believed = total["belief"].get(name, {}).get("on_storey")
        table.add_row(
            label(name),
            str(storey["settled_images"]),
            over(fraction(storey["settled_right"], 1), interval(intervals["settled_right"], ".1f", 100)),
            *([""] * (len(REGIONS) + 1) if believed is None else _consistency(believed)[1:]),
            over(fraction(storey["but_for_it"], 1), interval(intervals["but_for_it"], ".1f", 100)),
        )
    return table


def _comparison_table(title: str | None, what: str, like: str, totals: Mapping[str, Aggregate]) -> Table:
    """The filter over the images that it calls converged, a row for each ablation or kind of run."""
    regions = [f"in\n{region.replace('%', ' %')}" for region in REGIONS]
    columns = [*_OWN[like], "median\nerror", "right,\nconv.", "wrong", *regions, "NEES"]
    table = new_table(title, what, *columns)
    table.padding = (0, 0)
    table.caption = "wrong, in regions and NEES: of the converged images; below figures: 95 % intervals over walks"
    for name, total in totals.items():
        belief, method = total["belief"][OURS], total["methods"][OURS]
        table.add_row(
            name,
            *_own_figures(like, total),
            over(
                f"{100 * method['median_translation_m']:.1f} cm",
                interval(method["intervals"]["median_translation_m"], ".1f", 100),
            ),
            over(fraction(belief["rightly_converged"]), interval(belief["intervals"]["rightly_converged"], ".0f", 100)),
            *_consistency(belief["converged_images"]),
        )
    return table


def _own_figures(like: str, total: Aggregate) -> tuple[str, str]:
    """The two figures that a kind of run is about, as headed by `_OWN`."""
    belief, method = total["belief"][OURS], total["methods"][OURS]
    if like == "cue":
        count, bounds = method["successes"], method["intervals"]["successes"]
        other = figure(method["converged_at_s"], ".1f", " s")
    elif like == "no-cue":
        count, bounds = belief["runs_wrongly_converged"], belief["intervals"]["runs_wrongly_converged"]
        other = f"{belief['longest_wrong_s']:.1f} s"
    else:
        kidnap = belief["kidnap"]
        count, bounds = kidnap["recovered_in_time"], kidnap["intervals"]["recovered_in_time"]
        other = figure(kidnap["median_images"], ".0f")
    return over(f"{count}/{total['runs']}", interval(bounds, ".0f")), other


def _consistency(part: Aggregate) -> list[str]:
    intervals = part["intervals"]
    regions = [(part["coverage"][region], intervals["coverage"][region]) for region in REGIONS]
    return [
        over(fraction(part["wrong"], 1), interval(intervals["wrong"], ".1f", 100)),
        *(over(fraction(inside), interval(bounds, ".0f", 100)) for inside, bounds in regions),
        over(figure(part["median_nees"], ".1f"), interval(intervals["median_nees"], ".1f")),
    ]


_CONFIG = with_help(
    LocalizationConfig,
    kinds=f"What happens in the runs. {described({name: kind.meaning for name, kind in KINDS.items()})}.",
    ablations=f"Filters to run. {described({name: ablation.meaning for name, ablation in ABLATIONS.items()})}.",
)


@dataclass(frozen=True, kw_only=True)
class Options(SceneOptions):
    """Localize many synthetic sequences, and count successes."""

    config: Annotated[LocalizationConfig, tyro.conf.arg(name="", constructor=_CONFIG)] = field(default_factory=_CONFIG)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("localization", Options, arguments, program=PROGRAM)
    with workers_for("localization", o.config.workers, o.scheduler, PROGRAM) as workers:
        _measure(o, workers, command_line("localization", arguments, PROGRAM))


def _measure(o: Options, workers: Workers, command: str) -> None:
    benchmark = LocalizationBenchmark(o.model_of, o.output, o.config, workers)
    claim_shared(o.output, "localization", workers, reads=o.files_read, overwrite=o.overwrite)
    with progress("choosing", "runs") as advance:
        trials = benchmark.choose(advance)
    with progress("rendering", "walks") as advance:
        for done, total in benchmark.record(trials):
            advance(done, total)
    results = []
    with progress("localizing", "runs") as advance:
        for result in benchmark.localize(trials):
            results.append(result)
            advance(len(results), len(trials) * len(o.config.ablations))
    results.sort(key=lambda result: (result["variant"], result["name"]))
    summary = summarise(results)
    write_summary(o, o.config.settings(), summary, results)
    printed, failed = [*tables(summary)], [*failures(summary)]
    write_page(o.output / "report.html", _page(o, summary, printed, failed, command))
    publish_results(o.output)
    for shown in [*printed, *failed]:
        show(shown)


def _page(o: Options, summary: Summary, printed: Sequence[Table], failed: Sequence[str], command: str) -> Page:
    parts: list[tuple[str, list[Table | str | Path]]] = []
    for table in printed:  # those without a title belong to the one before
        if table.title is not None:
            parts.append((str(table.title), []))
        parts[-1][1].append(table)
    parts.append(("Runs to look at", [*failed]))
    asked = f"{o.config.runs} runs of each kind ({', '.join(o.config.kinds)}), synthetic images, simulated odometry"
    settings = o.config.settings() | {"models": o.model_of}
    return findings_page(", ".join(o.scenes), asked, headline(summary), parts, settings=settings, command=command)
