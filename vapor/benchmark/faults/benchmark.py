"""Many walks without a fault and with every one, in parallel, each run once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from filtering.errors import VaporTrackError, require_within
from sequences.options import SequenceOptions
from vapor.benchmark.faults import table
from vapor.benchmark.faults.metrics import evaluate_fault
from vapor.benchmark.faults.table import FAULTS, NONE, Film, find_moment, impossible, shown
from vapor.benchmark.faults.walks import RECORDED, FaultWalk, RecordedWalk, SyntheticWalk
from vapor.benchmark.recordings.storage import FileSettings, RecordingSettings, load_recording, not_recorded
from vapor.benchmark.trials.choose import trials_by_seed
from vapor.benchmark.trials.replay import Replay
from vapor.benchmark.trials.setup import Setup, TrialsConfig, camera_paths, make_recordings, make_setups
from vapor.cache import cached, code_digest
from vapor.parallel.jobs import Workers, in_parallel
from vapor.tracking.loop import Belief


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


def run_fault(run: FaultRun, directory: Path) -> dict[str, Any]:
    """Run a walk with a fault unless its result is cached in `directory / "faults"`.

    Returns:
        JSON: `name`, `scene`, `fault`, `begin`, and `methods`: see `evaluate_fault`.

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """
    walk, begin, fault, film = run.walk, run.begin, run.fault, run.film

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
    settings = walk.settings() | {"fault": fault, "faults_code": code_digest("vapor.benchmark.faults"), **more}
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
        posterior_poses, ood_score = recording.posterior_poses, recording.ood_score
        return Replay(recording.times_ns, odometry, truth, posterior_poses, ood_score, replay.cue_images)
    numbers = np.arange(len(replay.times_ns)) % count
    return shown(replay, during, lambda image: recording.posterior_poses(image % count), recording.ood_score[numbers])


_BARREN = 20  # walks in a row without a moment for a fault, after which there is no hope of another


@dataclass(frozen=True)
class FaultsConfig(TrialsConfig):
    """Settings of a benchmark of faults."""

    walks: int = 10
    """Walks of each scene, each without a fault and with every one."""
    faults: tuple[str, ...] = tuple(FAULTS)
    """What breaks, for five seconds unless stated otherwise."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, walks=(1, 10**6))
        least = round(10 * (table.CONVERGED_S + table.FAULT_S + table.REMAINING_S))
        if self.frames < least:
            raise VaporTrackError(
                f"frames is {self.frames}, expected at least {least}: {table.CONVERGED_S:g} s before a fault,"
                f" {table.FAULT_S:g} s with it, and {table.REMAINING_S:g} s after it"
            )
        for fault in self.faults:
            if fault not in FAULTS:
                raise VaporTrackError(f"unknown fault {fault!r}, expected one of {', '.join(FAULTS)}")
        if not self.faults or len(set(self.faults)) < len(self.faults):
            raise VaporTrackError(f"faults are {', '.join(self.faults) or 'none'}, expected each at most once, and one")


class FaultBenchmark:
    """The walks of a benchmark of faults, and where their results lie.

    Args:
        scenes: Names of scenes, each with the model to localize by: a file, or the name of one that ships.
        directory: For recordings and results; an interrupted benchmark continues where it was.
        recordings: MCAP files and rosbag2 folders with odometry and true poses, each a walk, by name.
        model: The model to localize in them by.

    Raises:
        VaporTrackError: a model that cannot be used.
    """

    def __init__(
        self,
        scenes: Mapping[str, str],
        directory: Path,
        config: FaultsConfig,
        *,
        recordings: Mapping[str, Path] = MappingProxyType({}),
        model: str | None = None,
        reading: SequenceOptions | None = None,
        workers: Workers | None = None,
    ) -> None:
        self.directory = directory
        self.config = config
        self._workers = workers or Workers(config.workers)
        self._setups = make_setups(scenes, config)
        self._recorded: list[RecordedWalk] = []
        if model is not None:
            setup, options = make_setups({RECORDED: model}, config)[RECORDED], reading or SequenceOptions()
            self._recorded = [
                RecordedWalk(name, file, setup, options, config.first_seed) for name, file in recordings.items()
            ]

    def choose(self, progress: Callable[[int, int], None]) -> tuple[list[Chosen], list[str]]:
        """The recordings in which a fault may begin, and of each scene the first such walks, no two of one seed.

        Returns:
            The walks; and the names of those in which none may begin, scene and seed of synthetic ones, none of whose
            "cue" trials allows it.

        Raises:
            VaporTrackError: seed after seed has no such walk, or none of the recordings has; one cannot be read.
        """
        total = self.config.walks * len(self._setups) + len(self._recorded)
        chosen, unused = self._choose_recorded(lambda n: progress(n, total))
        for scene, setup in self._setups.items():
            before = len(chosen)
            found, refused = self._choose_synthetic(scene, setup, lambda n, before=before: progress(before + n, total))
            chosen += found
            unused += [f"{scene} {seed}" for seed in refused]
        return chosen, unused

    def _choose_recorded(self, progress: Callable[[int], None]) -> tuple[list[Chosen], list[str]]:
        for done, _ in self._record({walk.own: walk for walk in self._recorded}):
            progress(done)
        jobs = [((walk,), self.directory) for walk in self._recorded]
        chosen = [each for each in in_parallel(find_walk, jobs, self._workers) if each is not None]
        chosen.sort(key=lambda each: each.walk.name)
        unused = sorted({walk.name for walk in self._recorded} - {each.walk.name for each in chosen})
        if self._recorded and not chosen:
            times_ns = [walk.replay(self.directory / "recordings").times_ns for walk in self._recorded]
            longest_s = max(float(each[-1] - each[0]) / 1e9 for each in times_ns)
            raise VaporTrackError(
                f"none of {len(unused)} recordings, the longest of {longest_s:.1f} s, is converged for"
                f" {table.CONVERGED_S:g} s with {table.FAULT_S + table.REMAINING_S:g} s to go, expected one at least"
            )
        return chosen, unused

    def left_out(self) -> Iterator[tuple[str, int, int]]:
        """Recordings of which not all images could be used: name, number of images used, and of all."""
        for walk in self._recorded:
            used, count = len(walk.replay(self.directory / "recordings").times_ns), walk.count()
            if used != count:
                yield walk.name, used, count

    def _choose_synthetic(
        self, scene: str, setup: Setup, progress: Callable[[int], None]
    ) -> tuple[list[Chosen], list[int]]:
        c = self.config
        path = camera_paths(setup, scene, "cue", self.directory / "recordings")
        seeds = trials_by_seed(scene, "cue", first_seed=c.first_seed, frames=c.frames, path=path)
        found: list[Chosen] = []
        refused: list[int] = []
        while len(found) < c.walks:
            batch = {
                trials[0].segments[0].seed: [SyntheticWalk(trial, setup, c.first_seed) for trial in trials]
                for trials in islice(seeds, c.walks - len(found))
            }
            wanted = {setup.recording(scene, "cue", walks[0].trial.segments[0]): setup for walks in batch.values()}
            for _ in make_recordings(wanted, self.directory / "recordings", self._workers):
                pass
            jobs = [(walks, self.directory) for walks in batch.values()]
            usable = {
                each.walk.seed: each
                for each in in_parallel(find_walk, jobs, self._workers)
                if each is not None and isinstance(each.walk, SyntheticWalk)
            }
            found += [usable[seed] for seed in sorted(usable)]
            refused += sorted(batch.keys() - usable.keys())
            progress(len(found))
            if not batch or len(refused) > _BARREN + len(found):
                raise VaporTrackError(
                    f"{scene}: {len(found)} of {len(found) + len(refused)} walks from seed {c.first_seed} on are"
                    f" converged for {table.CONVERGED_S:g} s with {table.FAULT_S + table.REMAINING_S:g} s to go,"
                    f" expected {c.walks}"
                )
        return found, refused

    def record(self, chosen: Sequence[Chosen]) -> Iterator[tuple[int, int]]:
        """Show the networks the images of the faults; yields the number done and the number of all after each."""
        yield from self._record({run.film: run.walk for run in self.runs(chosen) if run.film is not None})

    def _record(self, wanted: Mapping[RecordingSettings | FileSettings, FaultWalk]) -> Iterator[tuple[int, int]]:
        directory = self.directory / "recordings"
        missing = [(wanted[film], film, directory) for film in not_recorded(wanted, directory)]
        for done, _ in enumerate(in_parallel(_record, missing, self._workers), len(wanted) - len(missing) + 1):
            yield done, len(wanted)

    def localize(self, chosen: Sequence[Chosen]) -> Iterator[dict[str, Any]]:
        """The result of every walk with every fault, in no order; cached ones are not computed again."""
        jobs = [(run, self.directory) for run in self.runs(chosen)]
        yield from in_parallel(run_fault, jobs, self._workers)

    def runs(self, chosen: Sequence[Chosen]) -> list[FaultRun]:
        """Every walk with every fault that it can have: there are no images between those of a recording."""
        runs = []
        for each in chosen:
            films = each.walk.films()
            for fault in self.config.faults:
                cause = FAULTS[fault].cause
                if fault not in each.without["impossible"] and (callable(cause) or cause in films):
                    film = None if callable(cause) else films[cause]
                    runs.append(FaultRun(each.walk, each.begin, fault, film))
        return runs


def _record(walk: FaultWalk, film: RecordingSettings | FileSettings, directory: Path) -> None:
    walk.record(film, directory)
