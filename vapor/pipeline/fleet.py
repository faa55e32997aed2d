"""Many recorded sequences, one run each with one model, and what came of each."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from platform import node
from typing import TYPE_CHECKING, Any

import numpy as np

from filtering.errors import VaporTrackError
from sequences.atomic import atomic_output
from sequences.options import SequenceOptions
from sequences.outputs import folder_to_write, refuse_other, require_replaceable
from vapor.parallel.jobs import Workers, in_parallel
from vapor.pipeline.config import RunConfig
from vapor.pipeline.find_sequences import SUMMARY
from vapor.pipeline.model import LoadedModel, load_model
from vapor.pipeline.results import RESULTS, RunResult
from vapor.pipeline.run import files_read, run
from vapor.reporting.report import is_report
from vapor.storage import fetched, url_of

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True)
class Outcome:
    """What came of one sequence: figures, or the error that kept it from being localized.

    Attributes:
        name: Name of its folder among the results.
        sequence: Path of the sequence.
        error: Why there are no figures; None where there are.
        images: Images localized.
        duration_s: From the first to the last of them.
        status: Fraction of the images by status.
        final_status: Status of the last image.
        images_with_true_pose: How many have one.
        median_translation_m: Median error of the filter; None without true poses, like the next two.
        median_rotation_deg: Median error of the filter.
        success: Whether the filter found the place, and kept it.
        skipped: Images and messages left out, by reason.
        few_images: A sentence where fewer than half of the images were used.
        notices: What a person should know of the sequence.
    """

    name: str
    sequence: str
    error: str | None = None
    images: int = 0
    duration_s: float = 0.0
    status: dict[str, float] = field(default_factory=dict)
    final_status: str | None = None
    images_with_true_pose: int = 0
    median_translation_m: float | None = None
    median_rotation_deg: float | None = None
    success: bool | None = None
    skipped: dict[str, int] = field(default_factory=dict)
    few_images: str | None = None
    notices: tuple[str, ...] = ()


def run_fleet(
    sequences: Mapping[str, Path],
    model: str,
    output: Path,
    config: RunConfig | None = None,
    *,
    reading: SequenceOptions | None = None,
    overwrite: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
    workers: Workers | None = None,
    command: str = "",
) -> Iterator[Outcome]:
    """Localize many sequences; each has the results that it would have alone.

    Args:
        sequences: Paths of the sequences, by the names of their results.
        model: Model file, or name of a model that ships with the package; each process loads it once.
        output: Directory for the results: a folder for each sequence, and `summary.json` on those done so far.
        config: Settings of every run.
        reading: What to read of every sequence.
        overwrite: See `run`; it applies to the folder of each sequence, and to `summary.json`.
        progress: Called after every image with the name of the sequence, the number done and an upper bound of all; not
            of those that other processes localize.
        workers: Where they are localized; None for one after the other here.
        command: See `run`.

    Yields:
        What came of each, when it is done: in the order of the sequences where it is one after the other. A sequence
        that cannot be used does not keep the others from being localized.

    Raises:
        VaporTrackError: unusable model or output, or one that workers do not see; with the first sequence.
    """
    config, workers = config or RunConfig(), workers or Workers()
    folder_to_write(output)
    loaded = load_model(model, config)
    reads = list({path: None for sequence in sequences.values() for path in files_read(sequence, loaded, reading)})
    for name in sequences:
        require_replaceable(output / name, RESULTS, reads, overwrite=overwrite)
    refuse_other(output / SUMMARY, "summary of a fleet", _is_summary, reads=reads, overwrite=overwrite)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise VaporTrackError(f"{output}: cannot write: {error.strerror or error}") from error
    workers.require_to_see(output)
    here = partial(_localized, model=loaded, progress=progress, command=command)
    there = partial(
        _localized_elsewhere,
        file=loaded.file,
        model=loaded.name,
        sha256=loaded.sha256,
        told=workers.cluster is not None,
        command=command,
    )
    jobs = [(name, sequence, output / name, config, reading, overwrite) for name, sequence in sequences.items()]
    done: dict[str, Outcome] = {}
    for outcome in in_parallel(here if workers.are_this_process else there, jobs, workers):
        sequence = sequences[outcome.name]
        done[outcome.name] = replace(outcome, sequence=url_of(sequence) or str(sequence))
        in_order = [done[name] for name in sequences if name in done]
        _write_summary(output / SUMMARY, loaded.name, in_order, of=len(sequences))
        yield done[outcome.name]


def _localized(
    name: str,
    sequence: Path,
    output: Path,
    config: RunConfig,
    reading: SequenceOptions | None,
    overwrite: bool,
    *,
    model: LoadedModel,
    command: str,
    progress: Callable[[str, int, int], None] | None = None,
) -> Outcome:
    advance = None if progress is None else partial(progress, name)
    options = {"reading": reading, "overwrite": overwrite, "progress": advance, "command": command}
    try:
        result = run(fetched(sequence), model, output, config, **options)
        return _outcome(name, sequence, result)
    except (VaporTrackError, OSError) as error:
        return Outcome(name, str(sequence), error=" ".join(str(error).splitlines()))


def _localized_elsewhere(
    name: str,
    sequence: Path,
    output: Path,
    config: RunConfig,
    reading: SequenceOptions | None,
    overwrite: bool,
    *,
    file: Path,
    model: str,
    sha256: str,
    told: bool,
    command: str,
) -> Outcome:
    """As `_localized` in another process; on `told`, an error names the machine."""
    loaded = _loaded_once(file, model, sha256, config)
    outcome = _localized(name, sequence, output, config, reading, overwrite, model=loaded, command=command)
    return replace(outcome, error=f"{outcome.error} (on {node()})") if told and outcome.error else outcome


@lru_cache(maxsize=1)
def _loaded_once(file: Path, name: str, sha256: str, config: RunConfig) -> LoadedModel:
    """The model under the name that it was asked for by, the same in every process."""
    loaded = load_model(str(fetched(file)), config)
    if loaded.sha256 != sha256:
        raise VaporTrackError(f"{file}: is another model than where the run was started, expected the same")
    return replace(loaded, name=name)


def _outcome(name: str, sequence: Path, result: RunResult) -> Outcome:
    report = result.report
    errors = report.get("filter", {})
    return Outcome(
        name,
        str(sequence),
        images=report["frames"],
        duration_s=report["duration_s"],
        status=report["status"],
        final_status=result.record.status[-1],
        images_with_true_pose=report["frames_with_true_pose"],
        median_translation_m=errors.get("median_translation_m"),
        median_rotation_deg=errors.get("median_rotation_deg"),
        success=errors.get("success"),
        skipped=report["skipped"],
        few_images=result.few_images,
        notices=result.notices,
    )


def total(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """What sequences add up to: fractions are of all images, the median is that of the sequences' medians."""
    images = sum(outcome.images for outcome in outcomes)
    converged = sum(outcome.images * outcome.status.get("converged", 0.0) for outcome in outcomes)
    medians = [outcome.median_translation_m for outcome in outcomes if outcome.median_translation_m is not None]
    successes = [outcome.success for outcome in outcomes if outcome.success is not None]
    return {
        "failed": sum(outcome.error is not None for outcome in outcomes),
        "images": images,
        "duration_s": round(sum(outcome.duration_s for outcome in outcomes), 6),
        "converged": round(converged / images, 6) if images else None,
        "median_translation_m": round(float(np.median(medians)), 6) if medians else None,
        "judged": len(successes),
        "successes": sum(successes),
    }


def _is_summary(path: Path) -> bool:
    return is_report(path, "sequences_in_all")


def _write_summary(file: Path, model: str, outcomes: Sequence[Outcome], *, of: int) -> None:
    summary = {
        "model": model,
        "sequences_done": len(outcomes),
        "sequences_in_all": of,
        "total": total(outcomes),
        "sequences": [asdict(outcome) for outcome in outcomes],
    }
    with atomic_output(file) as partial:
        partial.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def format_fleet(outcomes: Sequence[Outcome]) -> Table:
    """A row a sequence; those of error and success only where there are true poses."""
    from rich.table import Table

    has_truth = any(outcome.median_translation_m is not None for outcome in outcomes)
    table = Table()
    table.add_column("sequence", overflow="fold")
    for name in ("images", "duration", "converged", "at the end"):
        table.add_column(name, justify="right")
    for name in ("median error", "success") if has_truth else ():
        table.add_column(name, justify="right")
    for o in outcomes:
        if o.error is not None:
            table.add_row(o.name, "", "", "", "failed", style="red")
            continue
        error = (
            "" if o.median_translation_m is None else f"{o.median_translation_m:.2f} m  {o.median_rotation_deg:5.1f}°"
        )
        success = "" if o.success is None else "yes" if o.success else "no"
        table.add_row(
            o.name,
            str(o.images),
            f"{o.duration_s:.1f} s",
            f"{100 * o.status['converged']:.0f} %",
            o.final_status,
            *((error, success) if has_truth else ()),
        )
    return table
