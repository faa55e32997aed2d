"""Walks without a fault and with every one, each run once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from filtering.errors import VaporTrackError
from vapor.benchmark.faults import table
from vapor.benchmark.faults.metrics import evaluate_fault
from vapor.benchmark.faults.table import FAULTS, NONE, find_moment, shown
from vapor.benchmark.faults.walks import FaultWalk, RecordedWalk, SyntheticWalk
from vapor.benchmark.jobs import completed
from vapor.benchmark.recordings.storage import FileSettings, RecordingSettings, load_recording
from vapor.benchmark.trials.choose import trials_by_seed
from vapor.benchmark.trials.replay import Replay
from vapor.benchmark.trials.setup import Setup
from vapor.cache import cached, code_digest

_BARREN = 20  # walks in a row without a moment for a fault, after which there is no hope of another


@dataclass(frozen=True)
class Chosen:
    """A walk, and when faults begin.

    Attributes:
        begin: The image at which faults begin.
        without: The result of the run without any, see `run_fault`.
    """

    walk: FaultWalk
    begin: int
    without: Mapping[str, Any]


@dataclass(frozen=True)
class FaultRun:
    """A walk with a fault.

    Attributes:
        begin: Image at which the fault begins.
        film: The recording of what the camera shows during the fault; None if that is nothing or the walk itself.
    """

    walk: FaultWalk
    begin: int
    fault: str
    film: RecordingSettings | FileSettings | None


def choose_recorded(walks: Sequence[RecordedWalk], directory: Path, workers: int) -> tuple[list[Chosen], list[str]]:
    """The recordings in which a fault may begin, and the names of the others.

    Raises:
        VaporTrackError: there is none, or one cannot be read.
    """
    completed("recording", "walks", record, [(walk, walk.own, directory) for walk in walks], workers)
    found = completed("choosing", "walks", find_walk, [((walk,), directory) for walk in walks], workers)
    chosen = sorted((each for each in found if each is not None), key=lambda each: each.walk.name)
    if not chosen:
        raise _nothing_to_do("recordings", 0, len(walks), 1)
    return chosen, sorted({walk.name for walk in walks} - {each.walk.name for each in chosen})


def choose_synthetic(
    scene: str, setup: Setup, number: int, first_seed: int, directory: Path, workers: int
) -> tuple[list[Chosen], list[str]]:
    """The first walks of a scene in which a fault may begin, no two of one seed, and the seeds without any.

    Raises:
        VaporTrackError: seed after seed has no such walk.
    """
    path = setup.camera_paths(scene, "cue")
    seeds = trials_by_seed(scene, "cue", first_seed=first_seed, frames=setup.config.frames, path=path)
    chosen: list[Chosen] = []
    refused: list[int] = []
    while len(chosen) < number:
        batch = [
            [SyntheticWalk(trial, setup, first_seed) for trial in trials]
            for trials in islice(seeds, number - len(chosen))
        ]
        wanted = [(walks[0], walks[0].own, directory) for walks in batch]
        completed(f"{scene}: rendering", "walks", record, wanted, workers)
        jobs = [(walks, directory) for walks in batch]
        found = completed(f"{scene}: choosing", "walks", find_walk, jobs, workers)
        chosen += [each for each in found if each is not None]
        refused += [walks[0].seed for walks, each in zip(batch, found, strict=True) if each is None]
        if not batch or len(refused) > _BARREN + len(chosen):
            where = f"{scene}, seeds {first_seed} on"
            raise _nothing_to_do(where, len(chosen), len(chosen) + len(refused), number)
    return chosen, [f"{scene} {seed}" for seed in refused]


def _nothing_to_do(where: str, found: int, tried: int, expected: int) -> VaporTrackError:
    return VaporTrackError(
        f"{where}: {found} of {tried} walks are converged for {table.CONVERGED_S:g} s with"
        f" {table.FAULT_S + table.REMAINING_S:g} s to go, expected {expected}"
    )


def find_walk(walks: Sequence[FaultWalk], directory: Path) -> Chosen | None:
    """The first of the walks in which a fault may begin, see `find_moment`; None if there is none."""
    for walk in walks:
        without = run_without(walk, directory)
        if without["begin"] is not None:
            return Chosen(walk, without["begin"], without)
    return None


def runs_of(chosen: Sequence[Chosen], faults: Sequence[str]) -> list[FaultRun]:
    """Every walk with every fault that it can have: there are no images between those of a recording."""
    runs = []
    for each in chosen:
        films = each.walk.films()
        for fault in faults:
            cause = FAULTS[fault].cause
            if callable(cause):
                runs.append(FaultRun(each.walk, each.begin, fault, None))
            elif cause in films:
                runs.append(FaultRun(each.walk, each.begin, fault, films[cause]))
    return runs


def record(walk: FaultWalk, film: RecordingSettings | FileSettings, directory: Path) -> None:
    """Show the network the images of a walk, or those of a fault, unless that is done."""
    walk.record(film, directory / "recordings")


def run_without(walk: FaultWalk, directory: Path) -> dict[str, Any]:
    """Run a walk without a fault; as `run_fault`, with `begin` and `methods` None if no fault may begin."""

    def compute() -> dict[str, Any]:
        replay = walk.replay(directory / "recordings")
        beliefs = walk.beliefs(replay)
        begin = find_moment(beliefs["filter"].status, replay.times_ns)
        if begin is None:
            return {"begin": None, "methods": None}
        during = range(len(replay.times_ns))
        return {
            "begin": begin,
            "methods": {
                name: evaluate_fault(belief, replay.times_ns, replay.truth, begin, during)
                for name, belief in beliefs.items()
            },
        }

    return _cached(walk, NONE, {}, directory, compute)


def run_fault(run: FaultRun, directory: Path) -> dict[str, Any]:
    """Run a walk with a fault unless its result is cached in `directory / "faults"`.

    Returns:
        JSON: `name`, `scene`, `fault`, `begin`, and `methods`: see `evaluate_fault`.

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """
    walk, begin, fault = run.walk, run.begin, FAULTS[run.fault]

    def compute() -> dict[str, Any]:
        replay = walk.replay(directory / "recordings")
        faulty = _with_fault(run, replay, directory / "recordings")
        # The faulty replay may have more images; the fault begins at the same time.
        first = int(np.searchsorted(faulty.times_ns, replay.times_ns[begin]))
        during = fault.during(first, faulty.times_ns)
        return {
            "begin": begin,
            "methods": {
                name: evaluate_fault(belief, faulty.times_ns, faulty.truth, first, during)
                for name, belief in walk.beliefs(faulty).items()
            },
        }

    more = {"begin": begin, "film": None if run.film is None else run.film.name}
    return _cached(walk, run.fault, more, directory, compute)


def _with_fault(run: FaultRun, replay: Replay, directory: Path) -> Replay:
    """The replay with the fault; a short film repeats, and one of the walk itself replaces it."""
    fault = FAULTS[run.fault]
    during = fault.during(run.begin, replay.times_ns)
    if callable(fault.cause):
        return fault.cause(replay, during)
    assert run.film is not None
    recording = load_recording(run.film, directory)
    if fault.cause == "three-times":
        return Replay.of(recording)
    return shown(replay, during, lambda image: recording.observed(image % len(recording.times_ns)))


def _cached(
    walk: FaultWalk, fault: str, more: Mapping[str, Any], directory: Path, compute: Callable[[], dict[str, Any]]
) -> dict[str, Any]:
    settings = walk.settings() | {"fault": fault, "faults_code": code_digest("vapor.benchmark.faults"), **more}
    result = cached(directory / "faults" / f"{walk.name}-{fault}", settings, compute)
    return {"name": walk.name, "scene": walk.group, "fault": fault, **result}
