"""`vapor-track run`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from filtering.errors import VaporTrackError, counted, require_within, shortened
from sequences.options import SequenceOptions
from vapor.commands.console import (
    OutputPath,
    Overwrite,
    command_line,
    count_images,
    parse,
    show,
    show_files,
    show_notices,
    show_skipped,
    usage_error,
)
from vapor.commands.model_name import ModelName
from vapor.commands.progress import progress
from vapor.commands.terminal import results_are_complete
from vapor.pipeline.batch import PAGE, SUMMARY, find_sequences, is_batch, run_batch
from vapor.pipeline.config import RunConfig
from vapor.pipeline.results import RunResult
from vapor.pipeline.run import run
from vapor.reporting.calibration import format_calibration
from vapor.reporting.outcome import Outcome, format_batch, said_of_training, total
from vapor.reporting.report import format_table
from vapor.training_data.entries import as_entry


@dataclass(frozen=True)
class Options:
    """Localize the camera of recorded sequences; write trajectories, report and recordings of each."""

    sequences: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SEQUENCE ...")]
    """MCAP files, rosbag2 folders or ROS 1 bags with images and odometry; or images alone: video files, folders of
    images, or data set folders, whose true poses are compared with; of these, PATH@100:200 takes only images 100 to
    199. Any other folder stands for the recordings, videos and data sets in it."""
    model: ModelName
    """Name of a model that ships with the package, or model file."""
    output: OutputPath
    """Directory for the results, new or with earlier ones; of several sequences it gets a folder each, and
    summary.html and summary.json on all of them. Results of one sequence and of several share no directory."""
    overwrite: Overwrite = False
    workers: int = 1
    """Sequences at a time, each in a process of its own."""
    dask: str | None = None
    """Localize several sequences on the workers of a Dask scheduler instead: its address, such as tcp://host:8786, or
    its --scheduler-file. Each worker has one thread, and sees the files by the same paths."""
    resume: bool = False
    """Of several sequences, keep complete results of the same recording, model and settings."""
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(default_factory=SequenceOptions)
    config: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)

    def __post_init__(self) -> None:
        require_within(self, workers=(1, 10**6))
        elsewhere = "--dask" if self.dask is not None else "--workers" if self.workers > 1 else ""
        if self.config.view and elsewhere:
            raise VaporTrackError(f"--view beside {elsewhere}, expected one sequence at a time to look at")
        if self.dask is not None and self.workers > 1:
            raise VaporTrackError("--workers beside --dask, expected one of them: a scheduler has workers of its own")


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options, command = parse("run", Options, arguments), command_line("run", arguments)
    if is_batch(options.sequences):
        _run_batch(options, command)
    elif options.dask is not None or options.resume:
        given = "--dask" if options.dask is not None else "--resume"
        usage_error("run", f"{given} with one sequence, expected several, or a folder of them")
    else:
        _run_one(options, command)


def _run_one(options: Options, command: str) -> None:
    (sequence,) = map(as_entry, options.sequences)
    with progress("localizing") as advance:
        result = run(
            sequence,
            options.model,
            options.output,
            options.config,
            reading=options.reading,
            overwrite=options.overwrite,
            progress=advance,
            command=command,
        )
    show_run(result, options.output, title=sequence.name, recording=options.config.recording)


def show_run(result: RunResult, output: Path, *, title: str, recording: bool, large_errors: bool = False) -> None:
    """Print figures, status, counts of images, and the paths of the results of a run; few images come last."""
    results_are_complete()
    report = result.report
    if report["frames_with_true_pose"]:
        show(format_table(report, title=title, large_errors=large_errors))
        if (calibration := format_calibration(report)) is not None:
            show(calibration)
    status = ", ".join(f"{100 * fraction:.0f} % {name}" for name, fraction in report["status"].items())
    show(f"{counted(report['frames'], 'image')}: {status}")
    for name, each in report.get("cameras", {}).items():
        left_out = f", {each['left_out']} left out" if each["left_out"] else ""
        show(f"camera     {name}: {counted(each['images'], 'image')}{left_out}")
    if "verified" in report:
        show(f"landmarks  verify a place in {100 * report['verified']:.0f} % of the images")
    show(f"images     {count_images(report['images'])}")
    show_skipped(report["skipped"])
    if result.motion:
        show(f"odometry   {result.motion}")
    show_notices(result.notices)
    if result.engine:
        show(f"engine     {result.engine}")
    show_files(output, recording=recording)
    if result.few_images is not None:
        show(result.few_images)


def _run_batch(options: Options, command: str) -> None:
    sequences = find_sequences(options.sequences, options.output)
    is_here = options.workers == 1 and options.dask is None
    numbers = {name: f"{name}, {number} of {len(sequences)}" for number, name in enumerate(sequences, start=1)}
    outcomes: list[Outcome] = []
    try:
        with progress("localizing", "images" if is_here else "sequences") as shown:
            for outcome in run_batch(
                sequences,
                options.model,
                options.output,
                options.config,
                reading=options.reading,
                overwrite=options.overwrite,
                progress=lambda name, done, count: shown.at(numbers[name], done, max(done, count)),
                workers=options.workers,
                scheduler=options.dask,
                resume=options.resume,
                command=command,
            ):
                outcomes.append(outcome)
                if not is_here:
                    shown(len(outcomes), len(sequences))
    finally:  # after Ctrl-C too: results of finished sequences are complete
        if outcomes:
            order = [*sequences]
            show_outcomes(sorted(outcomes, key=lambda outcome: order.index(outcome.name)), options.output)
    failed = [outcome.name for outcome in outcomes if outcome.error is not None]
    if failed:
        raise VaporTrackError(f"{len(failed)} of {len(outcomes)} sequences failed: {', '.join(failed)}")


def show_outcomes(outcomes: Sequence[Outcome], output: Path) -> None:
    """Print the table of a batch, and errors and skipped images of each sequence."""
    show(format_batch(outcomes))
    for outcome in outcomes:
        few = [] if outcome.few_images is None else [outcome.few_images]
        if outcome.error is not None or outcome.skipped or outcome.notices or few:
            show(f"{outcome.name}{f': failed: {shortened(outcome.error)}' if outcome.error is not None else ''}")
            show_skipped(outcome.skipped)
            show_notices([*outcome.notices, *few])
    summed = total(outcomes)
    converged = "" if summed["converged"] is None else f", {100 * summed['converged']:.0f} % converged"
    success = f"; success in {summed['successes']} of {summed['judged']}" if summed["judged"] else ""
    show(f"{len(outcomes)} sequence{'s' * (len(outcomes) != 1)}, {summed['images']} images{converged}{success}")
    show(f"summary    {output / PAGE}, {SUMMARY}")
    if (of_training := said_of_training(outcomes)) is not None:
        show(of_training)
    few = [outcome.name for outcome in outcomes if outcome.few_images is not None]
    if few:
        show(f"Fewer than half of the images were used in {len(few)} of {len(outcomes)} sequences: {', '.join(few)}.")
