"""`vapor-benchmark faults`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table

from filtering.errors import VaporTrackError, require_within
from sequences.datasets import listing
from sequences.options import SequenceOptions
from sequences.outputs import claim_folder
from sequences.reader import SequenceReader
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import SceneOptions, Scenes, described, require_each_once, write_summary
from vapor.benchmark.evaluation import OURS, short_label
from vapor.benchmark.faults import table
from vapor.benchmark.faults.metrics import summarise_faults
from vapor.benchmark.faults.runs import Chosen, choose_recorded, choose_synthetic, record, run_fault, runs_of
from vapor.benchmark.faults.table import FAULT_S, FAULTS, LONG_S, NONE, NOTICED_S, SETTLED_S
from vapor.benchmark.faults.walks import RECORDED, RecordedWalk
from vapor.benchmark.figures import Aggregate, percent, table_of
from vapor.benchmark.jobs import completed
from vapor.benchmark.recordings.storage import load_recording
from vapor.benchmark.trials.setup import Setup, TrialsConfig
from vapor.commands.console import parse, show
from vapor.pipeline.batch import unique_names
from vapor.tracking.methods import BASELINES

_FAULTS = (
    "What breaks, for five seconds unless stated otherwise."
    f" {described({name: fault.meaning for name, fault in FAULTS.items()})}."
)


@dataclass(frozen=True)
class FaultsConfig(TrialsConfig):
    """Settings of a benchmark of faults."""

    walks: int = 10
    """Walks of each scene, each without a fault and with every one."""
    faults: Annotated[tuple[str, ...], tyro.conf.arg(help=_FAULTS)] = tuple(FAULTS)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, walks=(1, 10**6))
        least = round(10 * (table.CONVERGED_S + table.FAULT_S + table.REMAINING_S))
        if self.replay.frames < least:
            raise VaporTrackError(
                f"frames is {self.replay.frames}, expected at least {least}: {table.CONVERGED_S:g} s before a fault,"
                f" {table.FAULT_S:g} s with it, and {table.REMAINING_S:g} s after it"
            )
        require_each_once("faults", self.faults, FAULTS)


@dataclass(frozen=True, kw_only=True)
class Options(SceneOptions):
    """Localize walks in which the camera or the odometry fails: synthetic sequences, or recordings."""

    scenes: Scenes = ()
    recordings: tuple[Path, ...] = ()
    """MCAP files or rosbag2 folders with odometry and true poses, each a walk, instead of scenes; the one model of
    --models is used for all."""
    config: Annotated[FaultsConfig, tyro.conf.arg(name="")] = field(default_factory=FaultsConfig)
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(default_factory=SequenceOptions)

    def __post_init__(self) -> None:
        if not self.recordings:
            super().__post_init__()
            if self.reading != SequenceOptions():
                raise VaporTrackError("options of what to read without --recordings, expected both or none")
        elif self.scenes or len(self.models) != 1:
            raise VaporTrackError(
                f"--recordings beside {len(self.scenes)} scenes and {len(self.models)} --models, expected no scene and"
                " one model"
            )
        else:
            ordinary, c = FaultsConfig(), self.config
            if (c.walks, c.replay.frames, c.replay.odometry_scale) != (
                ordinary.walks,
                ordinary.replay.frames,
                ordinary.replay.odometry_scale,
            ):
                raise VaporTrackError("--walks, --frames or --odometry-scale beside --recordings, expected scenes")
            if c.faults == ("three-times",):
                raise VaporTrackError("no fault but three-times: recordings have no images between theirs")

    @property
    def model_of(self) -> dict[str, str]:
        """The model by scene."""
        return {RECORDED: self.models[0]} if self.recordings else super().model_of

    @property
    def files_read(self) -> list[Path]:
        """The model files, and the data of recordings."""
        data = [file for recording in self.recordings for file in listing.files_read(recording)]
        return [*super().files_read, *data, *self.reading.files_read]


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("faults", Options, arguments, program=PROGRAM)
    c = o.config
    setups = {scene: Setup.of(model, c.replay) for scene, model in o.model_of.items()}
    claim_folder(o.output, f"{PROGRAM} faults", reads=o.files_read, overwrite=o.overwrite)
    chosen: list[Chosen] = []
    unused: list[str] = []
    more: dict[str, Any] = {}
    if o.recordings:
        named = dict(zip(unique_names(o.recordings), o.recordings, strict=True))
        walks = [RecordedWalk(name, file, setups[RECORDED], o.reading, c.first_seed) for name, file in named.items()]
        chosen, unused = choose_recorded(walks, o.output, c.workers)
        paths = {name: str(path) for name, path in named.items()}
        more = {"recordings": paths, "reading": o.reading.stated, "partial": _partial(walks, o.output)}
    else:
        for scene, setup in setups.items():
            found, refused = choose_synthetic(scene, setup, c.walks, c.first_seed, o.output, c.workers)
            chosen, unused = chosen + found, unused + refused
    runs = runs_of(chosen, c.faults)
    films = {run.film: (run.walk, run.film, o.output) for run in runs if run.film is not None}
    completed("rendering", "walks", record, list(films.values()), c.workers)
    results = [each.without for each in chosen]
    results += completed("localizing", "runs", run_fault, [(run, o.output) for run in runs], c.workers)
    results.sort(key=lambda result: (result["fault"], result["name"]))
    summary = summarise_faults(results)
    left_out = [fault for fault in c.faults if fault not in {run.fault for run in runs}]
    write_summary(o, asdict(c), summary, runs=results, unused=unused, left_out=left_out, **more)
    for shown in [*fault_tables(summary), *fault_failures(summary)]:
        show(shown)
    if unused:
        show(f"not used, as the filter was not converged in time for a fault: {', '.join(unused)}")
    for name, part in more.get("partial", {}).items():
        show(f"{name}: {part['used']} of {part['images']} images have a true pose and odometry, and were used")
    if left_out:
        show(f"left out, as recordings have no images between theirs: {', '.join(left_out)}")


def _partial(walks: Sequence[RecordedWalk], directory: Path) -> dict[str, dict[str, int]]:
    """Recordings of which not all images could be used: numbers of images used, and of all."""
    used = {walk.name: len(load_recording(walk.own, directory / "recordings").times_ns) for walk in walks}
    stated = {walk.name: SequenceReader(walk.file, walk.reading).num_images for walk in walks}
    return {name: {"used": used[name], "images": stated[name]} for name in used if used[name] != stated[name]}


def fault_tables(summary: Mapping[str, Mapping[str, Aggregate]]) -> Iterator[Table]:
    """Per scene: how well the methods do without a fault, and with each."""
    others = [*BASELINES]
    labels = [short_label(method) for method in others]

    def share(key: str, digits: int = 0) -> Callable[[Aggregate], str]:
        return lambda methods: percent(methods[OURS][key], digits, "")

    def other(method: str) -> Callable[[Aggregate], str]:
        return lambda methods: f"{methods[method]['successes']} {percent(methods[method]['right'], unit=''):>3}"

    columns: dict[str, Callable[[Aggregate], str]] = {
        "suc-\ncess": lambda methods: str(methods[OURS]["successes"]),
        "\nright": share("right"),
        f"{SETTLED_S:g} s\nafter": share("right_after"),
        "\nconv.": share("converged"),
        "\nlost": share("lost"),
        f"from\n{NOTICED_S:g} s": share("noticed"),
        "sure,\nwrong": share("sure_and_wrong", 1),
        "at\nmost": lambda methods: f"{methods[OURS]['longest_s']:.1f} s",
        **{f"\n{name}": other(method) for name, method in zip(labels, others, strict=True)},
    }
    for scene, faults in summary.items():
        title = f"{scene}: {faults[NONE]['walks']} walks without a fault, and with each"
        rows = {
            "no fault" if name == NONE else FAULTS[name].meaning: total["methods"] for name, total in faults.items()
        }
        shown = table_of(title, "filter", columns, rows)
        shown.columns[0].no_wrap = True
        shown.caption = (
            f"In % of the images from the fault's beginning on; it lasts {FAULT_S:g} s unless stated otherwise."
            f" {SETTLED_S:g} s after: right from {SETTLED_S:g} s after its end on. From {NOTICED_S:g} s: lost from"
            f" {NOTICED_S:g} s after its beginning to its end. At most: the longest that any walk was sure and wrong."
            f" {' and '.join(labels)}: success and right. Without a fault"
            f" {percent(faults[NONE]['methods'][OURS]['lost_ever'], 1)} of all images of the walks are called lost."
        )
        yield shown


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
