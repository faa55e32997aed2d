"""Many recorded sequences, one run each with one model."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from filtering.errors import VaporTrackError
from sequences.atomic import atomic_output
from sequences.datasets.layout_helpers.packed import VIDEO_SUFFIXES
from sequences.options import SequenceOptions
from sequences.outputs import folder_to_write, refuse_other, require_replaceable
from sequences.recordings.recording_file import SUFFIXES
from vapor.parallel import in_parallel
from vapor.pipeline.config import RunConfig
from vapor.pipeline.model import LoadedModel, load_model
from vapor.pipeline.results import RESULTS, RunResult
from vapor.pipeline.run import files_read, run
from vapor.reporting.report import is_report

if TYPE_CHECKING:
    from rich.table import Table

_FILES = (*SUFFIXES, *VIDEO_SUFFIXES)
SUMMARY = "summary.json"
"""Name of the file on the results of many sequences, beside these."""


def is_batch(paths: Sequence[Path]) -> bool:
    """Whether there are several paths, or one folder to search."""
    return len(paths) > 1 or (len(paths) == 1 and _found_in(paths[0]) not in ([], list(paths)))


def find_sequences(paths: Sequence[Path], output: Path) -> dict[str, Path]:
    """Sequences by the names of their results, in order.

    A file or a rosbag2 folder is a sequence. Any other folder stands for all recordings and videos below it but for
    results of earlier runs; where there are none, for itself: its images, or an error when it is opened. A sequence
    found twice is listed once. A name is that of the file or folder, preceded by folders above it where others have it
    too.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        for sequence in _found_in(path, leave_out=output.absolute()) or [path]:
            found.setdefault(sequence.resolve(), sequence)
    return dict(zip(unique_names(list(found)), found.values(), strict=True))


def _found_in(path: Path, leave_out: Path | None = None) -> list[Path]:
    if not path.is_dir() or (path / "metadata.yaml").is_file():
        return [path]
    sequences: list[Path] = []
    for entry in sorted(path.iterdir()):
        if entry.name.startswith(".") or entry.absolute() == leave_out:
            continue
        if entry.is_dir() and (
            not entry.is_symlink() or (entry / "metadata.yaml").is_file()
        ):  # links may run in circles
            sequences += _found_in(entry, leave_out)
        elif entry.suffix.lower() in _FILES and entry.is_file():
            is_result = entry.name == "estimate.mcap" and entry.with_name("report.json").is_file()
            sequences += [] if is_result else [entry]
    return sequences


def unique_names(sequences: Sequence[Path]) -> list[str]:
    """The shortest distinct names of sequences; numbered where whole paths are alike, as with `a.mcap` and `a/`."""
    parts = [(*path.parent.parts[1:], path.stem if path.suffix.lower() in _FILES else path.name) for path in sequences]
    lengths = [1] * len(parts)
    while True:
        names = ["-".join(part[-length:]) for part, length in zip(parts, lengths, strict=True)]
        counts = Counter(name.casefold() for name in [*names, SUMMARY])
        longer = [
            min(length + (counts[name.casefold()] > 1), len(part))
            for name, length, part in zip(names, lengths, parts, strict=True)
        ]
        if longer == lengths:
            break
        lengths = longer
    taken: Counter[str] = Counter()
    for i, name in enumerate(names):
        taken[name.casefold()] += 1
        if counts[name.casefold()] > 1:
            names[i] = f"{name}-{taken[name.casefold()]}"
    return names


@dataclass(frozen=True)
class Outcome:
    """The result of one sequence, by the name of its folder: figures, or an error.

    Without true poses the median errors of the filter, and `success` (whether it found the place, and kept it), are
    None. `status` has fractions of the images; `few_images` is a sentence where fewer than half of the images were
    used.
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


def run_batch(
    sequences: Mapping[str, Path],
    model: str,
    output: Path,
    config: RunConfig | None = None,
    *,
    reading: SequenceOptions | None = None,
    overwrite: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
    workers: int = 1,
    command: str = "",
) -> Iterator[Outcome]:
    """Localize many sequences, by the names of their results; each has the results that it would have alone.

    The output gets a folder for each sequence, and `summary.json` on those done so far. Each process loads the model
    once. Progress has the name of a sequence, the images done and an upper bound of all; sequences that other processes
    localize have none. One worker localizes them one after the other here. Other arguments are as of `run`.

    Yields:
        The result of each when it is done, in order without other processes. A sequence that cannot be used does not
        stop the others.

    Raises:
        VaporTrackError: unusable model or output; with the first sequence.
    """
    config = config or RunConfig()
    folder_to_write(output)
    loaded = load_model(model, config)
    reads = list({path: None for sequence in sequences.values() for path in files_read(sequence, loaded, reading)})
    for name in sequences:
        require_replaceable(output / name, RESULTS, reads, overwrite=overwrite)
    is_summary = partial(is_report, keys=("sequences_in_all",))
    refuse_other(output / SUMMARY, "summary of a batch", is_summary, reads=reads, overwrite=overwrite)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise VaporTrackError(f"{output}: cannot write: {error.strerror or error}") from error
    localized = partial(_localized, config=config, reading=reading, overwrite=overwrite, command=command)
    here = partial(localized, model=loaded, progress=progress)
    stated = {"file": loaded.file, "model": loaded.name, "sha256": loaded.sha256, "config": config}
    there = partial(_localized_elsewhere, localized, stated)
    jobs = [(name, sequence, output / name) for name, sequence in sequences.items()]
    done: dict[str, Outcome] = {}
    for _, outcome in in_parallel(here if workers == 1 else there, jobs, workers):
        done[outcome.name] = outcome
        in_order = [done[name] for name in sequences if name in done]
        _write_summary(output / SUMMARY, loaded.name, in_order, of=len(sequences))
        yield outcome


def _localized(
    name: str,
    sequence: Path,
    output: Path,
    *,
    config: RunConfig,
    reading: SequenceOptions | None,
    overwrite: bool,
    model: LoadedModel,
    command: str,
    progress: Callable[[str, int, int], None] | None = None,
) -> Outcome:
    advance = None if progress is None else partial(progress, name)
    options = {"reading": reading, "overwrite": overwrite, "progress": advance, "command": command}
    try:
        return _outcome(name, sequence, run(sequence, model, output, config, **options))
    except (VaporTrackError, OSError) as error:
        return Outcome(name, str(sequence), error=" ".join(str(error).splitlines()))


def _localized_elsewhere(
    localized: Callable[..., Outcome], stated: dict[str, Any], name: str, sequence: Path, output: Path
) -> Outcome:
    """As `_localized` in another process, which loads the model."""
    return localized(name, sequence, output, model=_loaded_once(**stated))


@lru_cache(maxsize=1)
def _loaded_once(file: Path, model: str, sha256: str, config: RunConfig) -> LoadedModel:
    loaded = load_model(str(file), config)
    if loaded.sha256 != sha256:
        raise VaporTrackError(f"{file}: is another model than where the run was started, expected the same")
    return replace(loaded, name=model)


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
    """Sums over sequences: fractions are of all images, the median is that of the sequences' medians."""
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


def format_batch(outcomes: Sequence[Outcome]) -> Table:
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
