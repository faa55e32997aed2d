"""`vapor-track benchmark`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, make_dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import numpy as np
import tyro
from rich.table import Table

from filtering.error_model import ErrorModel
from filtering.errors import VaporTrackError, require_within
from sequences import datasets
from sequences.options import SequenceOptions
from sequences.place import is_place
from sequences.results import claim_folder
from vapor.benchmark import real as real_benchmark
from vapor.benchmark.fault_runs import FaultBenchmark, FaultsConfig
from vapor.benchmark.faults import summarise_faults
from vapor.benchmark.foreign_images import IN_A_ROW, judge
from vapor.benchmark.localization import Benchmark, BenchmarkConfig
from vapor.benchmark.real import RealConfig
from vapor.benchmark.real_rows import Place
from vapor.benchmark.summary import summarise
from vapor.benchmark.timing import time_step, untrained
from vapor.checkpoints.shipped_models import find_model
from vapor.commands import real_tables
from vapor.commands.benchmark_tables import failures, fault_failures, fault_tables, tables
from vapor.commands.console import OutputPath, Overwrite, bar, parse, progress_of, show, usage_error
from vapor.observation import Device, VaporObservationModel
from vapor.pipeline.fleet import unique_names
from vapor.reporting.report import write_report
from vapor.threads import limited_threads
from vapor.training.presets import PRESETS

_MAX_SEED = 2**63


@dataclass(frozen=True)
class StepOptions:
    """Time the parts of a step: decoding, network, filter."""

    model: str = "staircase"
    """Model file, or name of a model that ships with the package."""
    preset: Annotated[str | None, tyro.conf.arg(metavar=f"{{{','.join(PRESETS)}}}")] = None
    """Time the network of this preset of `train` instead, with random weights; the filter is left out."""
    num_samples: int = 1000
    """Posterior samples per image."""
    hypotheses: tuple[int, ...] = (100,)
    """Sizes of the filter: hypotheses at most."""
    threads: int = 1
    """Processor threads of the network."""
    repetitions: int = 50
    """Of every part."""
    seed: int = 0
    """Of all random draws."""

    def __post_init__(self) -> None:
        require_within(
            self, **dict.fromkeys(("num_samples", "threads", "repetitions"), (1, 10**6)), seed=(0, _MAX_SEED)
        )
        if self.preset is not None and self.preset not in PRESETS:
            raise VaporTrackError(f"unknown preset {self.preset!r}, expected one of {', '.join(PRESETS)}")
        if not self.hypotheses or min(self.hypotheses) < 1:
            raise VaporTrackError(f"hypotheses are {self.hypotheses}, expected numbers of at least 1")


_Override = make_dataclass(
    "ErrorsOverride",
    [
        (name, Annotated[kind | None, tyro.conf.arg(help="As the model says where not given.")], None)
        for name, kind in get_type_hints(ErrorModel).items()
    ],
    frozen=True,
)
"""An error model of which anything may be left to the model file."""


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """What the benchmarks that replay walks are told."""

    scenes: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="{staircase,ceiling,corridor,building-N} ..."),
    ]
    """What the camera moves through; of buildings, N is the number that draws one."""
    output: OutputPath
    """Directory for recordings, results and summary.json; an interrupted benchmark of the same output goes on."""
    overwrite: Overwrite = False
    models: tuple[str, ...] = ()
    """Model file, or name of a model that ships, for each scene. Default: the scenes' names; none of the corridor
    or of a building ships."""
    errors: Annotated[Any, tyro.conf.arg(constructor=_Override)] = field(default_factory=_Override)
    """What replaces numbers of the models' own error models."""

    def __post_init__(self) -> None:
        if not self.scenes or len(set(self.scenes)) < len(self.scenes):
            raise VaporTrackError(f"scenes are {', '.join(self.scenes) or 'none'}, expected each at most once, and one")
        for scene in self.scenes:
            if not is_place(scene) or scene.endswith("-table"):
                raise VaporTrackError(
                    f"unknown scene {scene!r}, expected one of staircase, ceiling, corridor, building-N"
                )
        if len(self.models) not in (0, len(self.scenes)):
            raise VaporTrackError(f"{len(self.models)} models for {len(self.scenes)} scenes, expected one for each")

    @property
    def model_of(self) -> dict[str, str]:
        """The model by scene."""
        return dict(zip(self.scenes, self.models or self.scenes, strict=True))

    @property
    def files_read(self) -> list[Path]:
        """Files of the models."""
        return [find_model(model) for model in self.model_of.values()]

    @property
    def replaced(self) -> dict[str, Any]:
        """Numbers of the error model that are given, by name."""
        return {name: value for name, value in asdict(self.errors).items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class LocalizationOptions(SceneOptions):
    """Localize many synthetic sequences, and count successes."""

    config: Annotated[BenchmarkConfig, tyro.conf.arg(name="")] = field(default_factory=BenchmarkConfig)


@dataclass(frozen=True, kw_only=True)
class FaultsOptions(SceneOptions):
    """Localize walks in which the camera or the odometry fails: synthetic sequences, or recordings."""

    scenes: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="{staircase,ceiling,corridor,building-N} ..."),
    ] = ()
    """What the camera moves through; of buildings, N is the number that draws one. None where recordings are given."""
    recordings: tuple[Path, ...] = ()
    """MCAP files or rosbag2 folders with odometry and true poses, each a walk, in place of scenes; all by the one model
    of --models."""
    config: Annotated[FaultsConfig, tyro.conf.arg(name="")] = field(default_factory=FaultsConfig)
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
        """Files of the models, and what is read of recordings."""
        if not self.recordings:
            return super().files_read
        read = [file for recording in self.recordings for file in datasets.files_read(recording)]
        return [find_model(self.models[0]), *read, *self.reading.files_read]

    @property
    def named(self) -> dict[str, Path]:
        """The recordings by names that tell them apart."""
        return dict(zip(unique_names(self.recordings), self.recordings, strict=True))


@dataclass(frozen=True)
class FamiliarityOptions:
    """Count images of a place that are called foreign, and foreign ones that are not."""

    model: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="MODEL")]
    """Model file, or name of a model that ships."""
    familiar: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DATA ...")]
    """MCAP files or data set folders of its place that it was not trained on; PATH@START:STOP takes a part of it."""
    foreign: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DATA ...")] = ()
    """The same of other places."""
    every: int = 1
    """Take every so many images."""
    seed: int = 0
    """Of noise."""
    device: Device = "auto"
    """Where the network runs."""

    def __post_init__(self) -> None:
        require_within(self, every=(1, 10**6), seed=(0, _MAX_SEED))
        if not self.familiar:
            raise VaporTrackError("no familiar data, expected at least one file or folder")


@dataclass(frozen=True)
class RealOptions:
    """Localize recordings made by others: images, stored posteriors, and published estimates; some trained on first."""

    data: Path
    """Folder with the recordings; what is missing there is left out."""
    output: OutputPath
    """Directory for models, sequences, recordings, results and summary.json; an interrupted benchmark goes on, and what
    was made with the same settings and code is not made again."""
    overwrite: Overwrite = False
    only: tuple[str, ...] = ()
    """Rows or groups of rows, such as tum_fr1 or stairs; all by default."""
    config: Annotated[RealConfig, tyro.conf.arg(name="")] = field(default_factory=RealConfig)


_OPTIONS = {
    "step": StepOptions,
    "localization": LocalizationOptions,
    "faults": FaultsOptions,
    "familiarity": FamiliarityOptions,
    "real": RealOptions,
}


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    kinds = {
        "step": _step,
        "localization": _localization,
        "faults": _faults,
        "familiarity": _familiarity,
        "real": _real,
    }
    if arguments[:1] in (["-h"], ["--help"]):
        show(f"usage: vapor-track benchmark {'|'.join(kinds)} ...\n\nMeasure; each has its own --help.\n")
        show("\n".join(f"  {kind:<13} {options.__doc__}" for kind, options in _OPTIONS.items()))
        return
    if not arguments or arguments[0] not in kinds:
        usage_error("benchmark", f"expected one of {', '.join(kinds)} first")
    kinds[arguments[0]](arguments[1:])


def _step(arguments: Sequence[str]) -> None:
    o = parse("benchmark step", StepOptions, arguments)
    network = o.model if o.preset is None else untrained(PRESETS[o.preset].network)
    model = VaporObservationModel.from_checkpoint(network, num_samples=o.num_samples)
    hypotheses = o.hypotheses if o.preset is None else ()
    table = Table("part of a step", "median ms", "95 % ms")
    with limited_threads(o.threads):
        timings = time_step(model, repetitions=o.repetitions, hypotheses=hypotheses, seed=o.seed)
    for timing in timings:
        table.add_row(timing.part, f"{timing.median_ms:.2f}", f"{timing.p95_ms:.2f}")
    show(table)


def _familiarity(arguments: Sequence[str]) -> None:
    o = parse("benchmark familiarity", FamiliarityOptions, arguments)
    model = VaporObservationModel.from_checkpoint(o.model, num_samples=1, device=o.device)
    table = Table("images", "how many", "median score", "flagged", f"flagged, median of {IN_A_ROW}")
    with bar("judging") as advance:
        rows = judge(model, o.familiar, o.foreign, every=o.every, seed=o.seed, advance=advance)
    for row in rows:
        in_a_row = "" if np.isnan(row.share_in_a_row) else f"{100 * row.share_in_a_row:.1f} %"
        table.add_row(row.kind, str(row.images), f"{row.median:.2f}", f"{100 * row.share:.1f} %", in_a_row)
    show(table)


def _real(arguments: Sequence[str]) -> None:
    o = parse("benchmark real", RealOptions, arguments)
    rows, missing = real_benchmark.choose(o.data, o.only)
    claim_folder(o.output, "benchmark real", reads=[o.data], overwrite=o.overwrite)
    for name, needs in missing.items():
        show(f"left out: {name}, for want of {', '.join(needs)}")
    results = []
    for row in rows:
        with progress_of(row.name) as advance:
            place = Place(o.data, o.output, o.config.num_samples, advance)
            for judged in real_benchmark.measure([row], place, o.config):
                results += judged
    summary = real_benchmark.summarise(results)
    settings = asdict(o.config) | {"data": o.data.name, "left_out": missing}
    write_report(o.output / "summary.json", {"settings": settings, "summary": summary, "draws": results})
    for table in real_tables.tables(summary):
        show("")
        show(table)


def _localization(arguments: Sequence[str]) -> None:
    o = parse("benchmark localization", LocalizationOptions, arguments)
    benchmark = Benchmark(o.model_of, o.output, o.config, o.replaced)
    claim_folder(o.output, "benchmark localization", reads=o.files_read, overwrite=o.overwrite)
    with bar("choosing runs") as advance:
        trials = benchmark.choose(advance)
    with bar("recording") as advance:
        for done, total in benchmark.record(trials):
            advance(done, total)
    results = []
    with bar("localizing") as advance:
        for result in benchmark.localize(trials):
            results.append(result)
            advance(len(results), len(trials) * len(o.config.variants))
    results.sort(key=lambda result: (result["variant"], result["name"]))
    summary = summarise(results)
    _write(o, summary, results)
    for table in tables(summary):
        show(table)
    for line in failures(summary):
        show(line)


def _faults(arguments: Sequence[str]) -> None:
    o = parse("benchmark faults", FaultsOptions, arguments)
    model = o.models[0] if o.recordings else None
    benchmark = FaultBenchmark(
        o.model_of, o.output, o.config, o.replaced, recordings=o.named, model=model, reading=o.reading
    )
    claim_folder(o.output, "benchmark faults", reads=o.files_read, overwrite=o.overwrite)
    with bar("choosing walks") as advance:
        chosen, unused = benchmark.choose(advance)
    with bar("recording") as advance:
        for done, total in benchmark.record(chosen):
            advance(done, total)
    results, runs = [each.without for each in chosen], benchmark.runs(chosen)
    with bar("localizing") as advance:
        for result in benchmark.localize(chosen):
            results.append(result)
            advance(len(results) - len(chosen), len(runs))
    results.sort(key=lambda result: (result["fault"], result["name"]))
    summary = summarise_faults(results)
    left_out = [fault for fault in o.config.faults if fault not in {run.fault for run in runs}]
    partial = {name: {"used": used, "images": count} for name, used, count in benchmark.left_out()}
    recordings = {name: str(path) for name, path in o.named.items()}
    read = {"recordings": recordings, "reading": o.reading.told, "partial": partial} if recordings else {}
    _write(o, summary, results, unused=unused, left_out=left_out, **read)
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


def _write(
    o: LocalizationOptions | FaultsOptions, summary: Mapping[str, Any], results: Sequence[Any], **more: Any
) -> None:
    settings = asdict(o.config) | {"models": o.model_of or o.models, "errors": o.replaced}
    write_report(o.output / "summary.json", {"settings": settings, "summary": summary, "runs": results, **more})
