"""The recordings that trials are cut from: made in parallel, each once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path

from vapor.benchmark.recordings.record import camera_path, make_recording
from vapor.benchmark.recordings.settings import RecordingSettings
from vapor.benchmark.recordings.storage import CameraPath, not_recorded
from vapor.benchmark.trials.kinds import Kind
from vapor.benchmark.trials.setup import Setup
from vapor.parallel.jobs import Workers, in_parallel


def make_recordings(
    wanted: Mapping[RecordingSettings, Setup], directory: Path, workers: Workers
) -> Iterator[tuple[int, int]]:
    """Make the recordings that are missing; yields the number done and the number of all after each."""
    jobs = [(settings, wanted[settings], directory) for settings in not_recorded(wanted, directory)]
    for done, _ in enumerate(in_parallel(_make, jobs, workers), len(wanted) - len(jobs) + 1):
        yield done, len(wanted)


def camera_paths(setup: Setup, scene: str, kind: Kind, directory: Path) -> Callable[[int], CameraPath]:
    """The walks that trials of a kind are cut from, by seed; each is computed once."""
    return cache(lambda seed: camera_path(setup.walk(scene, kind, seed), directory))


def _make(settings: RecordingSettings, setup: Setup, directory: Path) -> None:
    make_recording(settings, setup.checkpoint(), directory, setup.network.engine)
