"""One run of `vapor-track fuse`: a filter over pose estimates of others, without images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.estimates.options import EstimateOptions
from sequences.estimates.sequence import EstimateSequence
from sequences.outputs import results_folder
from vapor.pipeline.config import FilteringConfig
from vapor.pipeline.estimate_model import EstimateConfig, EstimateModel, errors_of
from vapor.pipeline.localize import localize
from vapor.pipeline.results import RESULTS, RunResult, write_results
from vapor.reporting.rerun_place import Place


def fuse(
    estimates: Sequence[Path | str],
    output: Path | str,
    config: FilteringConfig | None = None,
    *,
    odometry: Path | str | None = None,
    simulate_odometry: Path | str | None = None,
    ground_truth: Path | str | None = None,
    trust: EstimateConfig | None = None,
    reading: EstimateOptions | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
    command: str = "",
) -> RunResult:
    """Localize frames of which others gave pose estimates, and write everything about it into a directory.

    Args:
        estimates: Files of poses, one for each method; one pose a frame, or several with weights.
        output: Directory for the results, see `vapor.pipeline.run.run`.
        config: Settings of the run.
        odometry: Recorded odometry.
        simulate_odometry: True poses to simulate odometry from, where there is none.
        ground_truth: True poses; None for those that the odometry is simulated from.
        trust: How far to trust the estimates.
        reading: How to read the files.
        overwrite: See `vapor.pipeline.run.run`.
        progress: Called after every frame with the number done and an upper bound of all.
        command: See `vapor.pipeline.run.run`.

    Raises:
        VaporTrackError: unusable files or output, or fewer than one in ten of the estimated frames left to localize.
    """
    config, trust, reading = config or FilteringConfig(), trust or EstimateConfig(), reading or EstimateOptions()
    files = [Path(path) for path in estimates]
    beside = [None if path is None else Path(path) for path in (odometry, simulate_odometry, ground_truth)]
    reads = [path for path in (*files, *beside) if path is not None]
    with results_folder(Path(output), "fuse", writes=RESULTS, reads=reads, overwrite=overwrite) as directory:
        sequence = EstimateSequence(
            files,
            odometry=beside[0],
            simulate_odometry_from=beside[1],
            ground_truth=beside[2],
            options=reading,
            seed=config.seed,
        )
        stated = [file.path.name for file in sequence.files if file.weights is None]
        if trust.outlier_weight > 0.0 and stated:
            raise VaporTrackError(
                f"{stated[0]}: no weights, expected a column of them (--columns) beside an outlier_weight of"
                f" {trust.outlier_weight:g}"
            )
        errors = errors_of(sequence, trust)
        model = EstimateModel(len(sequence.files), trust, errors)
        config = replace(config, localizer=over_sequences(config.localizer))
        record = localize(
            sequence,
            model,
            directory,
            config,
            errors,
            observed=lambda frame: frame.estimates,
            place=Place(Poses.concatenate([file.poses for file in sequence.files]), "given estimates"),
            allow_few_images=reading.allow_few_images,
            progress=progress,
        )
        settings = {
            "estimates": [
                {"name": file.path.name, "frames": len(set(file.frames)), "hypotheses": len(file.frames)}
                for file in sequence.files
            ],
            "odometry": sequence.odometry_description,
            "run": asdict(config),
            "trust": asdict(trust),
            "reading": asdict(reading),
            "errors": asdict(errors),
        }
        title = ", ".join(file.path.stem for file in sequence.files)
        return write_results(record, directory, settings, title=title, notices=sequence.notices, command=command)


def over_sequences(config: LocalizerConfig) -> LocalizerConfig:
    """Settings under which the frames of another sequence are another recording, not a gap in the odometry."""
    return replace(config, gap=replace(config.gap, action="forget"))
