"""One walk without a fault or with one: when a fault may begin, and how well every method does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from vapor.benchmark.faults.effects import shown
from vapor.benchmark.faults.metrics import evaluate_fault
from vapor.benchmark.faults.table import FAULTS, NONE, Film, impossible
from vapor.benchmark.faults.timing import find_moment
from vapor.benchmark.faults.walks import FaultWalk
from vapor.benchmark.recordings.settings import FileSettings, RecordingSettings
from vapor.benchmark.recordings.storage import load_recording
from vapor.benchmark.trials.replay import Replay
from vapor.cache import cached, code_digest
from vapor.tracking.loop import Belief


@dataclass(frozen=True)
class Chosen:
    """A walk, and when faults begin.

    Attributes:
        walk: Which.
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
        walk: Which.
        begin: Image at which the fault begins.
        fault: Its name.
        film: The recording of what the camera shows during the fault; None if that is nothing or the walk itself.
    """

    walk: FaultWalk
    begin: int
    fault: str
    film: RecordingSettings | FileSettings | None


def find_walk(walks: Sequence[FaultWalk], directory: Path) -> Chosen | None:
    """The first of the walks in which a fault may begin, see `find_moment`; None if there is none."""
    for walk in walks:
        without = run_without(walk, directory)
        if without["begin"] is not None:
            return Chosen(walk, without["begin"], without)
    return None


def run_without(walk: FaultWalk, directory: Path) -> dict[str, Any]:
    """Run a walk without a fault.

    Returns:
        As `run_fault`, with `begin` and `methods` None if no fault may begin, and `impossible`, the faults that would
        change nothing at its rate.
    """

    def compute() -> dict[str, Any]:
        replay = walk.replay(directory / "recordings")
        beliefs = walk.beliefs(replay)
        begin = find_moment(beliefs["filter"].status, replay.times_ns)
        whole = range(len(replay.times_ns))
        methods = None if begin is None else _evaluate_all(beliefs, replay, begin, whole)
        return _result(walk, NONE, begin, methods) | {"impossible": impossible(replay.times_ns)}

    return _cached(walk, NONE, directory, compute)


def run_fault(
    walk: FaultWalk, begin: int, fault: str, film: RecordingSettings | FileSettings | None, directory: Path
) -> dict[str, Any]:
    """Run a walk with a fault, or take the cached result of a run with the same settings and the same code.

    Args:
        walk: Which.
        begin: Image at which the fault begins.
        fault: Its name.
        film: The recording of what the camera shows during the fault; None if that is nothing or the walk itself.
        directory: With `recordings`; results are cached in `faults`.

    Returns:
        JSON: `name`, `scene`, `fault`, `begin`, and `methods`: see `evaluate_fault`.

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """

    def compute() -> dict[str, Any]:
        replay = walk.replay(directory / "recordings")
        cause, during = FAULTS[fault].cause, FAULTS[fault].during(begin, replay.times_ns)
        faulty = cause(replay, during) if callable(cause) else _filmed(replay, during, cause, film, directory)
        # The faulty replay may have more images; the fault begins at the same time.
        first = int(np.searchsorted(faulty.times_ns, replay.times_ns[begin]))
        during = FAULTS[fault].during(first, faulty.times_ns)
        return _result(walk, fault, begin, _evaluate_all(walk.beliefs(faulty), faulty, first, during))

    more = {"begin": begin, "film": None if film is None else film.name}
    return _cached(walk, fault, directory, compute, more)


def _evaluate_all(beliefs: Mapping[str, Belief], replay: Replay, begin: int, during: range) -> dict[str, Any]:
    return {
        name: evaluate_fault(belief, replay.times_ns, replay.truth, begin, during) for name, belief in beliefs.items()
    }


def _result(walk: FaultWalk, fault: str, begin: int | None, methods: Mapping[str, Any] | None) -> dict[str, Any]:
    return {"name": walk.name, "scene": walk.group, "fault": fault, "begin": begin, "methods": methods}


def _cached(
    walk: FaultWalk,
    fault: str,
    directory: Path,
    compute: Callable[[], dict[str, Any]],
    more: Mapping[str, Any] = MappingProxyType({}),
) -> dict[str, Any]:
    settings = walk.settings() | {"fault": fault, "faults_code": _code(), **more}
    return cached(directory / "faults" / f"{walk.name}-{fault}", settings, compute)


def _filmed(
    replay: Replay, during: range, cause: Film, film: RecordingSettings | FileSettings | None, directory: Path
) -> Replay:
    """The replay with a film shown; a short one repeats, and one of the walk itself replaces it."""
    assert film is not None
    recording = load_recording(film, directory / "recordings")
    count = len(recording.times_ns)
    if cause == "three-times":
        odometry, truth = tuple(map(recording.motion, range(count))), recording.path.world_from_camera
        posterior_poses, unfamiliarity = recording.posterior_poses, recording.unfamiliarity
        return Replay(recording.times_ns, odometry, truth, posterior_poses, unfamiliarity, replay.cue_images)
    numbers = np.arange(len(replay.times_ns)) % count
    return shown(
        replay, during, lambda image: recording.posterior_poses(image % count), recording.unfamiliarity[numbers]
    )


def _code() -> str:
    """Digest of the code of faults: those that were changed are run again."""
    return code_digest("vapor.benchmark.faults")
