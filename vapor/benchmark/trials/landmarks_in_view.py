"""Which trials there are: decided by where the camera has a landmark in view, before anything is rendered."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count

import numpy as np
from jaxtyping import Bool, Int64

from filtering.errors import VaporTrackError
from sequences.paths import IMAGE_RATE_HZ
from vapor.benchmark.recordings.storage import CameraPath
from vapor.benchmark.trials import kinds
from vapor.benchmark.trials.kinds import KINDS, Kind, recorded_images, walk_frames
from vapor.benchmark.trials.trial import Segment, Trial

_LEAST_CUE_IMAGES = 5  # half a second
_SIGHTED = 5  # images in a row: a camera that stops at the last of them comes to rest where the middle one is taken
_PER_RECORDING = 4  # windows at most
_APART = 60  # images between the starts of two windows of a recording, at least
_CARRIED_M = 2.0  # at least, by a kidnap
_BARREN = 50  # seeds in a row without a trial, after which there is no hope of another


def choose_trials(
    scene: str, kind: Kind, *, runs: int, first_seed: int, frames: int, path: Callable[[int], CameraPath]
) -> list[Trial]:
    """The first trials of a kind that the seeds from `first_seed` on have; the same for the same arguments.

    Args:
        scene: Name of the scene.
        kind: Windows begin at a random image and have something unique in view in at least five images of their first
            half. A kidnap is two thirds of a window with something unique in view in at least five images of its own
            first half, then a segment of the next seed's walk: more than 2 m away, and with something unique in view in
            at least five of its first images, a tenth of the trial's. A camera that is to stand before something unique
            stops in the first half second of it that is five seconds after the start or later.
        runs: Number of trials.
        first_seed: Where seeds count up from.
        frames: Images of a trial, at ten a second; those during a stand are added.
        path: The camera's walk by seed, at ten images a second and `walk_frames` long. Not asked for if the walk is
            taken whole, or ends where nothing is unique.

    Raises:
        VaporTrackError: seed after seed has no such trial.
    """
    trials: list[Trial] = []
    last_fertile = first_seed
    for found in trials_by_seed(scene, kind, first_seed=first_seed, frames=frames, path=path):
        trials += found
        last_fertile = found[0].segments[0].seed
        if len(trials) >= runs:
            return trials[:runs]
    raise VaporTrackError(
        f"{scene}: {len(trials)} {kind} trials of {frames} images in seeds {first_seed} to {last_fertile + _BARREN},"
        f" expected {runs}; more frames find more"
    )


def trials_by_seed(
    scene: str, kind: Kind, *, first_seed: int, frames: int, path: Callable[[int], CameraPath]
) -> Iterator[list[Trial]]:
    """The trials of every seed from `first_seed` on that has any, see `choose_trials`; ends after many without."""
    cut = {"window": _windows, "kidnap": _kidnaps, "whole": _whole, "stand": _stands}[KINDS[kind].cut]
    stride, scale = KINDS[kind].stride, KINDS[kind].scale
    last_fertile = first_seed
    for seed in count(first_seed):
        found = cut(kind, seed, frames, path)
        if found:
            last_fertile = seed
            yield [Trial(scene, kind, segments, stride, scale) for segments in found]
        elif seed - last_fertile >= _BARREN:
            return


def cue_starts(seen: Bool[np.ndarray, " n"], *, length: int, within: int) -> Int64[np.ndarray, " k"]:
    """First images of the segments of `length` images with something unique in view in five of the first `within`."""
    seen_before = np.concatenate([[0], np.cumsum(seen)])
    starts = np.arange(max(0, len(seen) - length + 1))
    return starts[seen_before[starts + within] - seen_before[starts] >= _LEAST_CUE_IMAGES]


def spread_starts(starts: Int64[np.ndarray, " k"], *, rng: np.random.Generator) -> list[int]:
    """At most four random ones of the starts, 60 images or more apart, in order."""
    chosen: list[int] = []
    for start in rng.permutation(starts):
        if len(chosen) < _PER_RECORDING and all(abs(int(start) - other) >= _APART for other in chosen):
            chosen.append(int(start))
    return sorted(chosen)


def _windows(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Segment, ...]]:
    starts = cue_starts(path(seed).sees_cue, length=frames, within=frames // 2)
    return [(Segment(seed, start, frames),) for start in spread_starts(starts, rng=np.random.default_rng([seed, 0]))]


def _whole(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Segment, ...]]:
    return [(Segment(seed, 0, recorded_images(kind, frames)),)]


def _stands(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Segment, ...]]:
    if KINDS[kind].cues == "none":
        stops = np.array([kinds.STAND_AFTER])
    else:
        last_of_row = np.arange(kinds.STAND_AFTER, walk_frames(kind, frames))
        rows = last_of_row[:, None] - np.arange(_SIGHTED)
        stops = last_of_row[path(seed).sees_cue[rows].all(axis=1)]
    if not len(stops):
        return []
    stop = recorded_images(kind, int(stops[0]))
    return [(Segment(seed, 0, stop + recorded_images(kind, round(IMAGE_RATE_HZ * kinds.STAND_S)), stop),)]


def _kidnaps(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Segment, ...]]:
    before = 2 * frames // 3
    after = frames - before
    rng = np.random.default_rng([seed, 1])
    here, there = path(seed), path(seed + 1)
    # One image more: at the kidnap, the odometry is that with which the first recording continues.
    starts = cue_starts(here.sees_cue, length=before + 1, within=before // 2)
    landings = cue_starts(there.sees_cue, length=after, within=frames // 10)
    segments = []
    for start in spread_starts(starts, rng=rng):
        left = here.world_from_camera[start + before - 1].translation
        far = np.linalg.norm(there.world_from_camera.translation[landings] - left, axis=1) > _CARRIED_M
        if far.any():
            landing = int(rng.choice(landings[far]))
            segments.append((Segment(seed, start, before), Segment(seed + 1, landing, after)))
    return segments
