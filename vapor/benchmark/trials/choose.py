"""Kinds of trials, and the choice of trials by where the camera has a landmark in view, before anything is rendered."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Bool, Int64

from filtering.errors import VaporTrackError
from sequences.paths import IMAGE_RATE_HZ, Cues
from vapor.benchmark.recordings.storage import CameraPath


@dataclass(frozen=True)
class TrialKind:
    """Properties of the trials of a kind.

    Attributes:
        meaning: What happens, in words.
        cues: Unique things along the walks that they are cut from.
        cut: How: "window", a segment with a landmark in view in its first half; "kidnap", two segments; "whole", a
            whole walk; "stand", a walk that ends where the camera stops and stands for minutes.
        like: The kind whose figures describe them: whether the filter finds itself ("cue"), whether it is confident of
            a wrong place ("no-cue"), or whether it recovers ("kidnap").
        recorded_hz: Images a second of the recordings.
        stride: Only every so many of these images are seen.
        in_sequences: Whether they are also cut into short sequences, in each of which methods start without a prior.
    """

    meaning: str
    cues: Cues
    cut: Literal["window", "kidnap", "whole", "stand"]
    like: Literal["cue", "no-cue", "kidnap"]
    recorded_hz: float = IMAGE_RATE_HZ
    stride: int = 1
    in_sequences: bool = False


# To add a kind: a name, and what happens.
KINDS: Mapping[str, TrialKind] = MappingProxyType(
    {
        "cue": TrialKind("something unique in the first half", "early", "window", "cue"),
        "no-cue": TrialKind("nothing unique", "none", "whole", "no-cue"),
        "kidnap": TrialKind("carried off", "early", "kidnap", "kidnap"),
        "walk": TrialKind("whole walks, something unique early", "early", "whole", "cue", in_sequences=True),
        "rate-3": TrialKind("3 images a second", "early", "whole", "cue", 30.0, 10),
        "rate-10": TrialKind("10 images a second", "early", "whole", "cue", 30.0, 3),
        "rate-30": TrialKind("30 images a second", "early", "whole", "cue", 30.0),
        "standing": TrialKind("standing where nothing is unique", "none", "stand", "no-cue"),
        "standing-cue": TrialKind("standing before something unique", "early", "stand", "no-cue"),
        "standing-30": TrialKind(
            "standing where nothing is unique, 30 images a second", "none", "stand", "no-cue", 30.0
        ),
    }
)
"""Kinds by name. Those at several rates are the same walks."""

if TYPE_CHECKING:
    Kind = str
else:
    Kind = Literal[tuple(KINDS)]
    """A name in `KINDS`."""

STAND_AFTER, STAND_S = 50, 300.0
"""The image at which the camera stops at the earliest, at ten a second, and for how many seconds it stands."""


def walk_frames(kind: Kind, frames: int) -> int:
    """Images, at ten a second, of the walks that trials of so many images are cut from."""
    of = KINDS[kind]
    if of.cut == "stand" and of.cues == "none":
        return STAND_AFTER + 1
    return frames if of.cut == "whole" else 2 * frames


def recorded_images(kind: Kind, images: int) -> int:
    """Number of images of the recordings in the time of so many images at ten a second."""
    return round(images * KINDS[kind].recorded_hz / IMAGE_RATE_HZ)


@dataclass(frozen=True)
class Excerpt:
    """A segment of a recording.

    Attributes:
        seed: Of the recording.
        stop: The image of the recording at which its camera stops to stand for `STAND_S`; None if it keeps walking.
    """

    seed: int
    start: int
    length: int
    stop: int | None = None


@dataclass(frozen=True)
class Trial:
    """One run of a benchmark.

    Attributes:
        segments: One after the other: two if it is carried off, else one.
        stride: Only every so many of the images are seen; odometry between them adds up.
    """

    scene: str
    kind: Kind
    segments: tuple[Excerpt, ...]
    stride: int = 1

    @property
    def name(self) -> str:
        """Scene, kind, and seed and first image of every segment."""
        return "-".join([self.scene, self.kind, *(f"{segment.seed}-{segment.start}" for segment in self.segments)])

    @property
    def kidnap_index(self) -> int | None:
        """The first image after the camera was carried off; None if it was not."""
        return self.segments[0].length if len(self.segments) > 1 else None


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

    Windows begin at a random image and show something unique in at least five images of their first half. A kidnap is
    two thirds of a window, which shows something unique in five images of its own first half, then a segment of the
    next seed's walk: more than 2 m away, with something unique in five of its first images, a tenth of the trial's. A
    camera that stands before something unique stops in the first half second of it from five seconds after the start
    on.

    Args:
        frames: Images of a trial, at ten a second; those during a stand are added.
        path: The camera's walk by seed, at ten images a second and `walk_frames` long.

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
    last_fertile = first_seed
    for seed in count(first_seed):
        found = cut(kind, seed, frames, path)
        if found:
            last_fertile = seed
            yield [Trial(scene, kind, segments, KINDS[kind].stride) for segments in found]
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


def _windows(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Excerpt, ...]]:
    starts = cue_starts(path(seed).sees_cue, length=frames, within=frames // 2)
    return [(Excerpt(seed, start, frames),) for start in spread_starts(starts, rng=np.random.default_rng([seed, 0]))]


def _whole(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Excerpt, ...]]:
    return [(Excerpt(seed, 0, recorded_images(kind, frames)),)]


def _stands(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Excerpt, ...]]:
    if KINDS[kind].cues == "none":
        stops = np.array([STAND_AFTER])
    else:
        last_of_row = np.arange(STAND_AFTER, walk_frames(kind, frames))
        rows = last_of_row[:, None] - np.arange(_SIGHTED)
        stops = last_of_row[path(seed).sees_cue[rows].all(axis=1)]
    if not len(stops):
        return []
    stop = recorded_images(kind, int(stops[0]))
    return [(Excerpt(seed, 0, stop + recorded_images(kind, round(IMAGE_RATE_HZ * STAND_S)), stop),)]


def _kidnaps(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Excerpt, ...]]:
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
            segments.append((Excerpt(seed, start, before), Excerpt(seed + 1, landing, after)))
    return segments
