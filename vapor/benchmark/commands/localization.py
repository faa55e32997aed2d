"""`vapor-benchmark localization`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table

from filtering.errors import require_within
from sequences.outputs import claim_folder
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import SceneOptions, described, require_each_once, write_summary
from vapor.benchmark.evaluation import BELIEVING, LAST, OURS, SUCCESS_M, label
from vapor.benchmark.figures import Aggregate, Figure, cell, dissent, percent, percent_cell, table_of, text
from vapor.benchmark.jobs import completed
from vapor.benchmark.localization import OFTEN, WITHIN_IMAGES, summarise
from vapor.benchmark.recordings.storage import RecordingSettings
from vapor.benchmark.trials.choose import KINDS, Kind, Trial, choose_trials
from vapor.benchmark.trials.replay import run_trial
from vapor.benchmark.trials.setup import Setup, TrialsConfig
from vapor.commands.console import command_line, parse, show
from vapor.commands.progress import progress
from vapor.evaluation.consistency import REGIONS
from vapor.evaluation.trajectory import POSITION_M, THRESHOLDS
from vapor.reporting.html.page import Page, findings_page, write_page
from vapor.tracking.ablations import ABLATIONS
from vapor.tracking.methods import METHODS

Summary = Mapping[str, Mapping[str, Mapping[str, Aggregate]]]
Columns = dict[str, Callable[[Aggregate], str]]

_KINDS = f"What happens in the runs. {described({name: kind.meaning for name, kind in KINDS.items()})}."
_ABLATIONS = f"Filters to run. {described({name: ablation.meaning for name, ablation in ABLATIONS.items()})}."


@dataclass(frozen=True)
class LocalizationConfig(TrialsConfig):
    """Settings of a benchmark of localization."""

    kinds: Annotated[tuple[Kind, ...], tyro.conf.arg(help=_KINDS)] = ("cue", "no-cue", "kidnap")
    runs: int = 100
    """Runs of each kind and scene."""
    ablations: Annotated[tuple[str, ...], tyro.conf.arg(help=_ABLATIONS)] = ("full",)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, runs=(1, 10**6))
        require_each_once("kinds", self.kinds)
        require_each_once("ablations", self.ablations, ABLATIONS)


@dataclass(frozen=True, kw_only=True)
class Options(SceneOptions):
    """Localize many synthetic sequences, and count successes."""

    config: Annotated[LocalizationConfig, tyro.conf.arg(name="")] = field(default_factory=LocalizationConfig)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("localization", Options, arguments, program=PROGRAM)
    c = o.config
    setups = {scene: Setup.of(model, c.replay) for scene, model in o.model_of.items()}
    claim_folder(o.output, f"{PROGRAM} localization", reads=o.files_read, overwrite=o.overwrite)
    trials: list[Trial] = []
    with progress("choosing", "runs") as advance:
        for (scene, setup), kind in product(setups.items(), c.kinds):
            path, frames = setup.camera_paths(scene, kind), c.replay.frames
            trials += choose_trials(scene, kind, runs=c.runs, first_seed=c.first_seed, frames=frames, path=path)
            advance(len(trials), len(setups) * len(c.kinds) * c.runs)
    # Runs of two kinds may share recordings, and neighbouring kidnaps do.
    wanted: dict[RecordingSettings, Setup] = {}
    for trial in trials:
        setup = setups[trial.scene]
        wanted |= {setup.recording(trial.scene, trial.kind, segment): setup for segment in trial.segments}
    recordings = [(setup, settings, o.output / "recordings") for settings, setup in wanted.items()]
    completed("rendering", "walks", Setup.record, recordings, c.workers)
    runs = [
        (trial, replace(setups[trial.scene], ablation=ablation), o.output)
        for ablation in c.ablations
        for trial in trials
    ]
    results = completed("localizing", "runs", run_trial, runs, c.workers)
    results.sort(key=lambda result: (result["variant"], result["name"]))
    summary = summarise(results)
    write_summary(o, asdict(c), summary, runs=results)
    printed, failed = [*tables(summary)], [*failures(summary)]
    page = _page(o, summary, printed, failed, command_line("localization", arguments, PROGRAM))
    write_page(o.output / "report.html", page)
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
    settings: dict[str, Any] = asdict(o.config) | {"models": o.model_of}
    return findings_page(", ".join(o.scenes), asked, headline(summary), parts, settings=settings, command=command)


def headline(summary: Summary) -> str:
    """The result, a sentence for each scene and kind of run."""
    sentences = []
    for scene, kinds in summary.items():
        for kind, ablations in kinds.items():
            total = ablations.get("full") or next(iter(ablations.values()))
            own, sure = total["methods"][OURS], total["belief"][OURS]["converged_images"]
            wrong = round((sure["wrong"].value or 0.0) * sure["images"])
            doubt = f"sure and wrong in {wrong or 'none'} of the {sure['images']} images that it called converged"
            successes = f"{own['successes'].value} of {total['runs']}" if "successes" in own else ""
            found = f"finds its place in {successes} runs, and " if successes else ""
            trusted = doubt if sure["images"] else "never sure"
            sentences.append(f"{scene}, {KINDS[kind].meaning}: the filter {found}is {trusted}.")
    return " ".join(f"{sentence[0].upper()}{sentence[1:]}" for sentence in sentences)


def failures(summary: Summary) -> Iterator[str]:
    """A line for every scene, kind and ablation with runs that failed, with their names."""
    for kinds in summary.values():
        for ablations in kinds.values():
            for ablation, total in ablations.items():
                if total["failed"]:
                    yield f"failed, {ablation}: {' '.join(total['failed'])}"


# --- tables -----------------------------------------------------------------------------------------


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
            yield _reliability_table(total["belief"][OURS]["reliability"])
            yield _position_table(total)
            if kind == "kidnap":
                yield table_of(None, "method", _RECOVERY, _by_label(BELIEVING, total["belief"], "kidnap"))
            if "storey" in total["methods"][OURS]:
                yield _storey_table(total)
            if len(ablations) > 1:
                yield _comparison_table(None, "ablation", KINDS[kind].like, ablations)
            alike.setdefault(KINDS[kind].like, {})[f"{kind}{of_ablation}"] = total
        for like, totals in alike.items():
            if len(totals) > 1:
                yield _comparison_table(f"{scene}, the filter by kind of run", "kind", like, totals)


def _by_label(methods: Sequence[str], of: Mapping[str, Any], key: str | None = None) -> dict[str, Any]:
    """What is known of each method, or a part of it, by the method's name in tables."""
    return {label(name): of[name] if key is None else of[name][key] for name in methods}


def _position(name: str) -> str:
    return name.replace("m", " m")


def _value_at(limit: str) -> Callable[[Aggregate], str]:
    return lambda figures: percent_cell(figures[limit])


def _of_part(key: str, of: Callable[[Aggregate], str]) -> Callable[[Aggregate], str]:
    return lambda row: of(row[key]) if key in row else ""


def _consistency(wrap: str = "in {}\nregion") -> Columns:
    """Columns of the images that a method is sure of: how many are wrong, and how far the covariances hold."""
    return {
        "wrong": lambda part: percent_cell(part["wrong"], 1),
        **{wrap.format(name.replace("%", " %")): _of_part("coverage", _value_at(name)) for name in REGIONS},
        "median\nNEES (5.3)": lambda part: cell(part["median_nees"], ".1f"),
    }


def _methods_table(title: str, total: Aggregate) -> Table:
    limits = {"recall\n{}\n{}°".format(*_position(limit.removesuffix("deg")).split("/")): limit for limit in THRESHOLDS}

    def error(method: Aggregate) -> str:
        metres, degrees = method["median_translation_m"], method["median_rotation_deg"].value
        return cell(metres, ".3f", f" m {degrees:5.1f}°")

    columns: Columns = {
        "success": lambda method: cell(method["successes"]) if "successes" in method else "",
        "found\nat": lambda method: text(method["converged_at_s"].value, ".1f", " s") if "successes" in method else "",
        "median\nerror": error,
        **{heading: _of_part("recall", _value_at(limit)) for heading, limit in limits.items()},
    }
    table = table_of(title, "method", columns, {})
    for name, method in _by_label(list(METHODS), total["methods"]).items():
        table.add_row(name, *(of(method) for of in columns.values()))
        if "successes" in method:
            later = (percent(method["recall_after_convergence"][limit].value) for limit in THRESHOLDS)
            table.add_row("  from then on", "", "", "", *later)
    return table


def _consistency_table(total: Aggregate) -> Table:
    """Two rows a method: over the "converged" images, and over those from its convergence on."""
    rows = {
        f"{label(method)}\n  {meaning}": total["belief"][method][key]
        for method in BELIEVING
        for key, meaning in (("converged_images", "converged"), ("after_convergence", "from found on"))
    }
    columns: Columns = {"number": lambda part: str(part["images"]), **_consistency()}
    return table_of(None, "over the images", columns, rows)


_STATUS: Columns = {
    "conv.": lambda belief: percent(belief["status"]["converged"].value),
    "rightly": lambda belief: percent_cell(belief["rightly_converged"]),
    "lost": lambda belief: percent(belief["status"]["lost"].value),
    "truth in\nmodes": lambda belief: percent(belief["truth_among_modes"].value),
    "false\nrecov.": lambda belief: f"{belief['false_recoveries']} ({belief['runs_with_false_recovery']})",
    "wrong\nruns": lambda belief: cell(belief["runs_wrongly_converged"]),
    f"often\n({100 * OFTEN:.0f} %)": lambda belief: str(belief["runs_wrongly_converged_often"]),
    "longest\nwrong": lambda belief: f"{belief['longest_wrong_s']:.1f} s",
}
"""Statuses of a method over all images, and in how many runs and for how long it is wrong.

False recoveries with the number of runs that have any; "often": in at least 5 % of a run's images.
"""


def _status_table(total: Aggregate) -> Table:
    table = table_of(None, "method", _STATUS, _by_label(BELIEVING, total["belief"]))
    table.caption = (
        f"single image: truth among its modes in {percent(total['image_truth_among_modes'].value)}\n"
        f"step of the filter: {total['step_ms']:.1f} ms, {total['particles']:.0f} particles\n"
        f"below figures: 95 % intervals over {total['walks']} walks;"
        f" where all agree, up to {percent(dissent(total['walks']))} of others may not"
    )
    return table


def _reliability_table(ranges: Aggregate) -> Table:
    """Whether the weight of the filter's best mode is the probability that it is right."""
    columns: Columns = {
        "stated": lambda row: percent(row["stated"].value),
        "right": lambda row: percent_cell(row["right"]),
        "images": lambda row: str(row["images"]),
    }
    table = table_of(None, "weight of the best mode", columns, {f"{low} and more": row for low, row in ranges.items()})
    table.caption = "all images of all runs; right: within 0.3 m and 20°"
    return table


def _position_table(total: Aggregate) -> Table:
    """As others report: positions alone, storeys where there are several, and short sequences from a flat prior."""
    lengths = total.get("sequences", {})
    columns: Columns = {
        f"within\n{_position(limit)}": _of_part("position_recall", _value_at(limit)) for limit in POSITION_M
    }
    if "storey_accuracy" in total["methods"][OURS]:
        columns["right\nstorey"] = lambda method: percent_cell(method["storey_accuracy"])
    rows = _by_label(list(METHODS), total["methods"])
    for length, part in lengths.items():
        for limit in SUCCESS_M:
            columns[f"{length} images\n{_position(limit)}"] = _of_part(length, _value_at(limit))
        for name, success in part["success"].items():
            rows[label(name)] = rows[label(name)] | {length: success}
    table = table_of(None, "method", columns, rows)
    if lengths:
        parts_of_walks = " and ".join(f"{part['sequences']} of {length} images" for length, part in lengths.items())
        table.caption = f"sequences, each from a flat prior: {parts_of_walks}; right at all of the last {LAST} images"
    return table


_RECOVERY: Columns = {
    "right before": lambda kidnap: str(kidnap["right_before"]),
    f"right within {WITHIN_IMAGES} images": lambda kidnap: cell(kidnap["recovered_in_time"]),
    "ever": lambda kidnap: str(kidnap["recovered"]),
    "median images": lambda kidnap: text(kidnap["median_images"].value),
}


def _storey_table(total: Aggregate) -> Table:
    """Where storeys look alike: over the images once the storey is right to the end, and over all, right but for it."""
    of_belief = _consistency()
    del of_belief["wrong"]
    columns: Columns = {
        "once on its\nstorey: images": lambda row: str(row["settled_images"]),
        "right": lambda row: percent_cell(row["settled_right"], 1),
        **{heading: _of_part("on_storey", of) for heading, of in of_belief.items()},
        "right but\nfor storey": lambda row: percent_cell(row["but_for_it"], 1),
    }
    rows = _by_label(list(METHODS), total["methods"], "storey")
    for name, belief in total["belief"].items():
        rows[label(name)] = rows[label(name)] | {"on_storey": belief["on_storey"]}
    return table_of(None, "method", columns, rows)


def _comparison_table(title: str | None, what: str, like: str, totals: Mapping[str, Aggregate]) -> Table:
    """The filter over the images that it calls converged, a row for each ablation or kind of run."""
    consistency = _consistency("in\n{}")
    consistency["NEES"] = consistency.pop("median\nNEES (5.3)")
    columns: Columns = {
        **_OWN[like],
        "median\nerror": lambda row: cell(row["median_translation_m"], ".1f", " cm", 100),
        "right,\nconv.": lambda row: percent_cell(row["rightly_converged"]),
        **{heading: _of_part("converged_images", of) for heading, of in consistency.items()},
    }
    rows = {
        name: {"runs": total["runs"], **total["methods"][OURS], **total["belief"][OURS]}
        for name, total in totals.items()
    }
    table = table_of(title, what, columns, rows)
    table.padding = (0, 0)
    table.caption = "wrong, in regions and NEES: of the converged images; below figures: 95 % intervals over walks"
    return table


def _of_runs(figure: Figure, row: Aggregate) -> str:
    return cell(figure, unit=f"/{row['runs']}")


_OWN: Mapping[str, Columns] = {
    "cue": {
        "success": lambda row: _of_runs(row["successes"], row),
        "conv.\nat": lambda row: text(row["converged_at_s"].value, ".1f", " s"),
    },
    "no-cue": {
        "wrong\nruns": lambda row: _of_runs(row["runs_wrongly_converged"], row),
        "longest\nwrong": lambda row: f"{row['longest_wrong_s']:.1f} s",
    },
    "kidnap": {
        f"within\n{WITHIN_IMAGES}": lambda row: _of_runs(row["kidnap"]["recovered_in_time"], row),
        "median\nimages": lambda row: text(row["kidnap"]["median_images"].value),
    },
}
"""The two figures that a kind of run is about."""
