"""Many recorded sequences, one run each with one model."""

from __future__ import annotations

import json
import os
import socket
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import lru_cache, partial
from pathlib import Path
from time import perf_counter
from typing import Any

from filtering.errors import VaporTrackError
from sequences.atomic import atomic_output, workspace
from sequences.datasets.layout_helpers.packed import VIDEO_SUFFIXES
from sequences.datasets.listing import find_layouts, found_images
from sequences.errors import SequenceError
from sequences.files import read_json
from sequences.image_sequence import is_image_sequence
from sequences.options import SequenceOptions
from sequences.outputs import (
    Resolved,
    folder_to_write,
    own_manifest,
    refuse_other,
    refuse_results,
    require_replaceable,
    verify,
)
from sequences.recordings.recording_file import SUFFIXES
from vapor.parallel import in_parallel
from vapor.pipeline.config import RunConfig
from vapor.pipeline.model import LoadedModel, load_model
from vapor.pipeline.results import RESULTS
from vapor.pipeline.run import files_read, request_of, run
from vapor.reporting.html.page import is_page, write_page
from vapor.reporting.html.summary_page import Site, summary_page
from vapor.reporting.outcome import Outcome, total
from vapor.reporting.report import is_report
from vapor.reporting.stored_run import StoredRun, read_run
from vapor.training_data.entries import as_entry

_FILES = (*SUFFIXES, *VIDEO_SUFFIXES)
SUMMARY, PAGE = "summary.json", "summary.html"
"""Names of the files on the results of many sequences, beside these."""
_MOST_POSITIONS = 20_000  # in a summary
_PAUSE = 10  # times as long as it took to write the summary


def is_batch(paths: Sequence[Path]) -> bool:
    """Whether there are several paths, or one folder to search."""
    return len(paths) > 1 or (len(paths) == 1 and _found_in(paths[0]) not in ([], list(paths)))


def find_sequences(paths: Sequence[Path], output: Path) -> dict[str, Path]:
    """Sequences by the names of their results, in order.

    A file, a rosbag2 folder or the folder of a data set is a sequence. Any other folder, as of a data set of several
    sequences or of a damaged one, stands for all recordings, videos and data sets below it but for results of earlier
    runs; where there are none, for itself: its images, or an error when it is opened. A sequence found twice is listed
    once. A name is that of the file or folder, preceded by folders above it where others have it too.
    """
    found: dict[Path, Path] = {}
    for path in map(as_entry, paths):
        for sequence in _found_in(path, leave_out=output.absolute()) or [path]:
            found.setdefault(sequence.resolve(), sequence)
    return dict(zip(unique_names(list(found)), found.values(), strict=True))


def _found_in(path: Path, leave_out: Path | None = None) -> list[Path]:
    if not path.is_dir() or (path / "metadata.yaml").is_file():
        return [path]
    damaged: list[Path] = []
    try:
        if _is_data_set(path):
            return [path]
    except SequenceError:  # as its reader says; or a stray file beside recordings looks like one of a data set
        damaged = [path]
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
            is_part = bool(damaged) and entry.name in {layout.video for layout in find_layouts()}
            sequences += [] if is_result or is_part else [entry]
    return sequences or damaged


def _is_data_set(folder: Path) -> bool:
    """Whether a folder is one sequence of a data set. Raises SequenceError where a file of it is missing or damaged."""
    posed = found_images(folder) if is_image_sequence(folder) else None
    return posed is not None and not posed.has_several


def unique_names(sequences: Sequence[Path]) -> list[str]:
    """The shortest distinct names of sequences; numbered where whole paths are alike, as with `a.mcap` and `a/`."""
    parts = [(*path.parent.parts[1:], path.stem if path.suffix.lower() in _FILES else path.name) for path in sequences]
    lengths = [1] * len(parts)
    while True:
        names = ["-".join(part[-length:]) for part, length in zip(parts, lengths, strict=True)]
        counts = Counter(name.casefold() for name in [*names, SUMMARY, PAGE])
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
    scheduler: str | None = None,
    resume: bool = False,
    command: str = "",
) -> Iterator[Outcome]:
    """Localize many sequences, by the names of their results; each has the results that it would have alone.

    The output gets a folder for each sequence, `summary.json` on those done so far (written in at most a tenth of the
    time), and at the end its page, `summary.html`, also where sequences failed or it was interrupted. Each process
    loads the model once. Progress has the name of a sequence, the images done and an upper bound of all; sequences that
    other processes localize have none. One worker localizes them one after the other here. Other arguments are as of
    `run`.

    Args:
        scheduler: Of Dask: its workers localize the sequences, see `in_parallel`. They see all files by the same paths.
        resume: Keep complete results of the same requests, see `request_of`.

    Yields:
        The result of each when it is done, in order without other processes. A sequence that cannot be used does not
        stop the others.

    Raises:
        VaporTrackError: unusable model, output, scheduler or workers; with the first sequence.
    """
    config = config or RunConfig()
    refuse_results(folder_to_write(output), "earlier results of several sequences", overwrite=overwrite)
    loaded = load_model(model, config)
    reads = Resolved.of({path for sequence in sequences.values() for path in files_read(sequence, loaded, reading)})
    for name in sequences:
        require_replaceable(output / name, RESULTS, reads, overwrite=overwrite)
    is_summary = partial(is_report, keys=("sequences_in_all",))
    refuse_other(output / SUMMARY, "summary of a batch", is_summary, reads=reads, overwrite=overwrite)
    refuse_other(output / PAGE, "page of a batch", is_page, reads=reads, overwrite=overwrite)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise VaporTrackError(f"{output}: cannot write: {error.strerror or error}") from error
    gone: frozenset[str] = frozenset()
    beside: list[Path] = []  # what workers of a scheduler read beside the sequences
    if scheduler is not None:
        gone = frozenset(name for name, sequence in sequences.items() if not sequence.exists())
        if reading is not None and reading.poses is not None:
            reading = replace(reading, poses=reading.poses.absolute())
        files = [loaded.file.absolute(), *(() if reading is None else reading.files_read)]
        beside = [path for path in files if path.exists()]
    options = {"config": config, "reading": reading, "overwrite": overwrite, "resume": resume, "command": command}
    localized = partial(_localized, **options, most_positions=_MOST_POSITIONS // max(1, len(sequences)))
    here = partial(localized, model=loaded, progress=progress)
    done: dict[str, Outcome] = {}

    def write() -> list[Outcome]:
        in_order = [done[name] for name in sequences if name in done]
        _write_summary(output / SUMMARY, loaded.name, in_order, of=len(sequences))
        return in_order

    due_s = 0.0
    try:
        with _shared(output, beside) as needed:
            stated = {"file": loaded.file.absolute(), "model": loaded.name, "sha256": loaded.sha256, "config": config}
            there = partial(_localized_elsewhere, localized, stated, needed, gone)
            jobs = [(name, sequence.absolute(), output.absolute() / name) for name, sequence in sequences.items()]
            in_this_process = workers == 1 and scheduler is None
            function = here if in_this_process else there
            for _, outcome in in_parallel(function, jobs, workers, scheduler=scheduler, given_up=_died):
                outcome = replace(outcome, sequence=str(sequences[outcome.name]))
                done[outcome.name] = outcome
                if (now_s := perf_counter()) >= due_s:
                    write()
                    due_s = now_s + _PAUSE * (perf_counter() - now_s)
                yield outcome
    finally:
        if done:
            in_order = write()
            site = Site.of_model(loaded.observation.description, loaded.observation.storeys)
            page = summary_page(in_order, site, loaded.name, of=len(sequences), command=command)
            write_page(output / PAGE, page)


@contextmanager
def _shared(output: Path, files: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Paths that must exist where a scheduler's workers are: these files, and a new folder in the output; else none."""
    if not files:
        yield ()
        return
    with workspace(output.absolute(), "shared") as folder:
        yield *files, folder


def _require_shared(needed: Sequence[Path]) -> None:
    for path in needed:
        if not path.exists():
            raise VaporTrackError(
                f"{path}: is not there on {socket.gethostname()}, where a worker runs, expected a file system that all"
                " machines share, with the same paths"
            )
    if not os.access(needed[-1], os.W_OK | os.X_OK):
        raise VaporTrackError(
            f"{needed[-1].parent}: cannot write on {socket.gethostname()}, where a worker runs, expected it as here"
        )


def _localized(
    name: str,
    sequence: Path,
    output: Path,
    *,
    config: RunConfig,
    reading: SequenceOptions | None,
    overwrite: bool,
    resume: bool,
    model: LoadedModel,
    command: str,
    most_positions: int,
    progress: Callable[[str, int, int], None] | None = None,
) -> Outcome:
    advance = None if progress is None else partial(progress, name)
    options = {"reading": reading, "overwrite": overwrite, "progress": advance, "command": command}
    try:
        stored = _stored(output, request_of(sequence, model, config, reading)) if resume else None
        if stored is None:
            run(sequence, model, output, config, **options)
            stored = read_run(output)
        return Outcome.of_run(name, str(sequence), stored, most_positions)
    except (VaporTrackError, OSError) as error:
        return Outcome(name, str(sequence), error=" ".join(str(error).splitlines()))


def _stored(output: Path, request: str) -> StoredRun | None:
    """Complete results of a request in a folder, as its manifest lists them; None where there are none."""
    try:
        if own_manifest(output) is not None and read_json(output / "config.json")["request"] == request:
            verify(output, RESULTS)
            return read_run(output)
    except (SequenceError, KeyError, TypeError):
        pass
    return None


def _localized_elsewhere(
    localized: Callable[..., Outcome],
    stated: dict[str, Any],
    needed: Sequence[Path],
    gone: Collection[str],
    name: str,
    sequence: Path,
    output: Path,
) -> Outcome:
    """As `_localized` in another process, which loads the model; sequences that were `gone` before are not needed."""
    if needed:
        _require_shared(needed if name in gone else [sequence, *needed])
    return localized(name, sequence, output, model=_loaded_once(**stated))


def _died(name: str, sequence: Path, output: Path) -> Outcome:
    return Outcome(name, str(sequence), error="its workers died each time, perhaps for lack of memory")


@lru_cache(maxsize=1)
def _loaded_once(file: Path, model: str, sha256: str, config: RunConfig) -> LoadedModel:
    loaded = load_model(str(file), config)
    if loaded.sha256 != sha256:
        raise VaporTrackError(f"{file}: is another model than where the run was started, expected the same")
    return replace(loaded, name=model)


def _write_summary(file: Path, model: str, outcomes: Sequence[Outcome], *, of: int) -> None:
    summary = {
        "model": model,
        "sequences_done": len(outcomes),
        "sequences_in_all": of,
        "total": total(outcomes),
        "sequences": [],
    }
    head = json.dumps(summary, indent=2, allow_nan=False).removesuffix("[]\n}")
    rows = ",\n".join(f"    {json.dumps(asdict(outcome), allow_nan=False)}" for outcome in outcomes)  # a line each
    with atomic_output(file) as partial:
        partial.write_text(f"{head}[\n{rows}\n  ]\n}}\n", encoding="utf-8")
