"""`vapor-benchmark faults`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from filtering.errors import VaporTrackError
from sequences.datasets import listing
from sequences.options import SequenceOptions
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.cells import Aggregate, fraction, new_table, percent
from vapor.benchmark.commands.options import (
    SCENE_NAMES,
    SceneOptions,
    claim_shared,
    described,
    publish_results,
    with_help,
    write_summary,
)
from vapor.benchmark.evaluation import OURS, ours_first, short_label
from vapor.benchmark.faults.benchmark import FaultBenchmark, FaultsConfig
from vapor.benchmark.faults.metrics import summarise_faults
from vapor.benchmark.faults.table import FAULT_S, FAULTS, LONG_S, NONE, NOTICED_S, SETTLED_S
from vapor.checkpoints.file_format import find_model
from vapor.commands.console import InputPath, parse, show
from vapor.commands.progress import progress
from vapor.commands.workers import workers_for
from vapor.parallel.jobs import Workers
from vapor.pipeline.batch import unique_names
from vapor.storage import fetched, url_of


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
            f"In % of the images from the fault's beginning on; it lasts {FAULT_S:g} s unless stated otherwise."
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


_CONFIG = with_help(
    FaultsConfig,
    faults="What breaks, for five seconds unless stated otherwise."
    f" {described({name: fault.meaning for name, fault in FAULTS.items()})}.",
)


@dataclass(frozen=True, kw_only=True)
class Options(SceneOptions):
    """Localize walks in which the camera or the odometry fails: synthetic sequences, or recordings."""

    scenes: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar=f"{{{','.join(SCENE_NAMES)}}} ..."),
    ] = ()
    """The scene; the number N of a building is the seed that it is drawn from. None beside
    recordings."""
    recordings: tuple[InputPath, ...] = ()
    """MCAP files or rosbag2 folders, or their URLs, with odometry and true poses, each a walk, instead of scenes; the
    one model of --models is used for all."""
    config: Annotated[FaultsConfig, tyro.conf.arg(name="", constructor=_CONFIG)] = field(default_factory=_CONFIG)
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(default_factory=SequenceOptions)

    def __post_init__(self) -> None:
        if not self.recordings:
            super().__post_init__()
            if self.reading != SequenceOptions():
                raise VaporTrackError("options of what to read without --recordings, expected both or none")
            return
        if self.scenes or len(self.models) != 1:
            raise VaporTrackError(
                f"--recordings beside {len(self.scenes)} scenes and {len(self.models)} --models, expected no scene and"
                " one model"
            )
        ordinary = FaultsConfig()
        for name in ("walks", "frames", "odometry_scale"):
            if getattr(self.config, name) != getattr(ordinary, name):
                option = name.replace("_", "-")
                raise VaporTrackError(f"--{option} beside --recordings, expected it with scenes only")
        if self.config.faults == ("three-times",):
            raise VaporTrackError("no fault but three-times, expected others: recordings have no images between theirs")

    @property
    def model_of(self) -> dict[str, str]:
        """The model by scene."""
        return {} if self.recordings else super().model_of

    @property
    def files_read(self) -> list[Path]:
        """The model files, and the data of recordings."""
        if not self.recordings:
            return super().files_read
        read = [file for recording in self.recordings for file in listing.files_read(recording)]
        return [find_model(self.models[0]), *read, *self.reading.files_read]

    @property
    def named(self) -> dict[str, Path]:
        """The recordings, by names that distinguish them; copies of what has a URL are made."""
        return dict(zip(unique_names(self.recordings), map(fetched, self.recordings), strict=True))


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("faults", Options, arguments, program=PROGRAM)
    with workers_for("faults", o.config.workers, o.scheduler, PROGRAM) as workers:
        _measure(o, workers)


def _measure(o: Options, workers: Workers) -> None:
    model = o.models[0] if o.recordings else None
    benchmark = FaultBenchmark(
        o.model_of,
        o.output,
        o.config,
        recordings=o.named,
        model=model,
        reading=o.reading,
        workers=workers,
    )
    claim_shared(o.output, "faults", workers, reads=o.files_read, overwrite=o.overwrite)
    with progress("choosing", "walks") as advance:
        chosen, unused = benchmark.choose(advance)
    with progress("rendering", "walks") as advance:
        for done, total in benchmark.record(chosen):
            advance(done, total)
    results, runs = [each.without for each in chosen], benchmark.runs(chosen)
    with progress("localizing", "runs") as advance:
        for result in benchmark.localize(chosen):
            results.append(result)
            advance(len(results) - len(chosen), len(runs))
    results.sort(key=lambda result: (result["fault"], result["name"]))
    summary = summarise_faults(results)
    left_out = [fault for fault in o.config.faults if fault not in {run.fault for run in runs}]
    partial = {name: {"used": used, "images": count} for name, used, count in benchmark.left_out()}
    recordings = {name: url_of(path) or str(path) for name, path in o.named.items()}
    read = {"recordings": recordings, "reading": o.reading.stated, "partial": partial} if recordings else {}
    write_summary(o, asdict(o.config), summary, results, unused=unused, left_out=left_out, **read)
    publish_results(o.output)
    for table in fault_tables(summary):
        show(table)
    for line in fault_failures(summary):
        show(line)
    if unused:
        show(f"not used, as the filter was not converged in time for a fault: {', '.join(unused)}")
    for name, part in partial.items():
        show(f"{name}: {part['used']} of {part['images']} images have a true pose and odometry, and were used")
    if left_out:
        show(f"left out, as recordings with this rate cannot have them: {', '.join(left_out)}")
