"""Which trials a benchmark consists of, decided by what the camera comes by and before anything is rendered."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Bool, Int64

from filtering.errors import VaporTrackError
from sequences.paths.choose import Cues
from sequences.synthesize import IMAGE_RATE_HZ
from vapor.benchmark.recordings import CameraPath

Kind = Literal[
    "cue",
    "no-cue",
    "kidnap",
    "walk",
    "rate-3",
    "rate-10",
    "rate-30",
    "scale-0.1",
    "scale-30",
    "standing",
    "standing-cue",
    "standing-30",
    "standing-cue-30",
]
"""Names of `KINDS`."""


@dataclass(frozen=True)
class RunsOfAKind:
    """What the runs of a kind have in common.

    Attributes:
        meaning: What happens, in words.
        cues: What is unique on the walks that they are cut from.
        cut: How: "window", a stretch that sees something unique in its first half; "kidnap", two stretches; "whole",
            all of a walk; "stand", a walk that ends where the camera stops and stands for minutes.
        like: The kind whose figures tell of them: whether the filter finds itself ("cue"), whether it is sure of a
            wrong place ("no-cue"), or whether it recovers ("kidnap").
        recorded_hz: Images a second of the recordings.
        stride: Every so many of these images are seen.
        scale: By what all lengths are multiplied: of samples, truth and odometry, and of how they err.
    """

    meaning: str
    cues: Cues
    cut: Literal["window", "kidnap", "whole", "stand"]
    like: Literal["cue", "no-cue", "kidnap"]
    recorded_hz: float = IMAGE_RATE_HZ
    stride: int = 1
    scale: float = 1.0


# To add one: a name, here and in `Kind`, and what happens.
KINDS: Mapping[str, RunsOfAKind] = MappingProxyType(
    {
        "cue": RunsOfAKind("something unique in the first half", "early", "window", "cue"),
        "no-cue": RunsOfAKind("nothing unique", "none", "whole", "no-cue"),
        "kidnap": RunsOfAKind("carried off", "early", "kidnap", "kidnap"),
        "walk": RunsOfAKind("whole walks, something unique early", "early", "whole", "cue"),
        "rate-3": RunsOfAKind("3 images a second", "early", "whole", "cue", 30.0, 10),
        "rate-10": RunsOfAKind("10 images a second", "early", "whole", "cue", 30.0, 3),
        "rate-30": RunsOfAKind("30 images a second", "early", "whole", "cue", 30.0),
        "scale-0.1": RunsOfAKind("as cue, lengths times 0.1", "early", "window", "cue", scale=0.1),
        "scale-30": RunsOfAKind("as cue, lengths times 30", "early", "window", "cue", scale=30.0),
        "standing": RunsOfAKind("standing where nothing is unique", "none", "stand", "no-cue"),
        "standing-cue": RunsOfAKind("standing before something unique", "early", "stand", "no-cue"),
        "standing-30": RunsOfAKind(
            "standing where nothing is unique, 30 images a second", "none", "stand", "no-cue", 30.0
        ),
        "standing-cue-30": RunsOfAKind(
            "standing before something unique, 30 images a second", "early", "stand", "no-cue", 30.0
        ),
    }
)
"""Kinds of runs by name. Those at several rates are the same walks, and so are those of a stand at 10 and 30 Hz."""

STAND_AFTER, STAND_S = 50, 300.0
"""The image at which the camera stops at the earliest, ten a second, and for how many seconds it stands."""

_LEAST_CUE_IMAGES = 5  # half a second
_SIGHTED = 5  # images in a row: a camera that stops at the last of them comes to rest where the middle one is taken
_PER_RECORDING = 4  # windows at most
_APART = 60  # images between the starts of two windows of a recording, at least
_CARRIED_M = 2.0  # at least, by a kidnap
_BARREN = 50  # seeds in a row without a window, after which there is none to be hoped for


@dataclass(frozen=True)
class Piece:
    """A stretch of a recording.

    Attributes:
        seed: Of the recording.
        start: The first image.
        length: The number of images.
        stop: The image of the recording at which its camera stops to stand for `STAND_S`; None where it walks on.
    """

    seed: int
    start: int
    length: int
    stop: int | None = None


@dataclass(frozen=True)
class Trial:
    """One run of a benchmark.

    Attributes:
        scene: Name of the scene.
        kind: What happens.
        pieces: What the camera sees, one after the other: two where it is carried off, else one.
        stride: Every so many of the images are seen; odometry between them adds up.
        scale: By what all lengths are multiplied.
    """

    scene: str
    kind: Kind
    pieces: tuple[Piece, ...]
    stride: int = 1
    scale: float = 1.0

    @property
    def name(self) -> str:
        """Scene, kind, and seed and first image of every piece."""
        return "-".join([self.scene, self.kind, *(f"{piece.seed}-{piece.start}" for piece in self.pieces)])

    @property
    def seam(self) -> int | None:
        """The first image after the camera was carried off; None where it was not."""
        return self.pieces[0].length if len(self.pieces) > 1 else None


def walk_frames(kind: Kind, frames: int) -> int:
    """Images, ten a second, of the walks from which trials of so many images are cut."""
    of = KINDS[kind]
    if of.cut == "stand" and of.cues == "none":
        return STAND_AFTER + 1
    return frames if of.cut == "whole" else 2 * frames


def recorded_images(kind: Kind, images: int) -> int:
    """How many images of the recordings pass while so many would, ten a second."""
    return round(images * KINDS[kind].recorded_hz / IMAGE_RATE_HZ)


def choose_trials(
    scene: str, kind: Kind, *, runs: int, first_seed: int, frames: int, path: Callable[[int], CameraPath]
) -> list[Trial]:
    """The first so many trials of a kind that seeds from `first_seed` on have; the same for the same arguments.

    Args:
        scene: Name of the scene.
        kind: Windows begin at a random image and see something unique in at least five images of their first half. A
            kidnap is two thirds of a window that sees something unique in at least five images of its own first half,
            then a stretch of the next seed's walk: more than 2 m away, and with something unique in at least five of
            its first tenth of the whole's images. Where the camera is to stand before something unique, it stops in the
            first half second of it that is five seconds after the start or later.
        runs: Number of trials.
        first_seed: Where seeds count up from.
        frames: Images of a trial, ten a second; those of a stand are added.
        path: The camera's walk by seed, ten images a second and `walk_frames` long. Not asked for where it is taken
            whole, or left where nothing is unique.

    Raises:
        VaporTrackError: seed after seed has no such trial.
    """
    trials: list[Trial] = []
    last_fertile = first_seed
    for found in trials_by_seed(scene, kind, first_seed=first_seed, frames=frames, path=path):
        trials += found
        last_fertile = found[0].pieces[0].seed
        if len(trials) >= runs:
            return trials[:runs]
    raise VaporTrackError(
        f"{scene}: {len(trials)} {kind} trials of {frames} images in seeds {first_seed} to {last_fertile + _BARREN},"
        f" expected {runs}; more frames find more"
    )


def trials_by_seed(
    scene: str, kind: Kind, *, first_seed: int, frames: int, path: Callable[[int], CameraPath]
) -> Iterator[list[Trial]]:
    """The trials of every seed from `first_seed` on that has any, see `choose_trials`; ends where many have none."""
    cut = {"window": _windows, "kidnap": _kidnaps, "whole": _whole, "stand": _stands}[KINDS[kind].cut]
    stride, scale = KINDS[kind].stride, KINDS[kind].scale
    last_fertile = first_seed
    for seed in count(first_seed):
        found = cut(kind, seed, frames, path)
        if found:
            last_fertile = seed
            yield [Trial(scene, kind, pieces, stride, scale) for pieces in found]
        elif seed - last_fertile >= _BARREN:
            return


def cue_starts(seen: Bool[np.ndarray, " n"], *, length: int, within: int) -> Int64[np.ndarray, " k"]:
    """First images of the stretches of `length` images that show something unique in five of the first `within`."""
    seen_before = np.concatenate([[0], np.cumsum(seen)])
    starts = np.arange(max(0, len(seen) - length + 1))
    return starts[seen_before[starts + within] - seen_before[starts] >= _LEAST_CUE_IMAGES]


def spread_starts(starts: Int64[np.ndarray, " k"], *, rng: np.random.Generator) -> list[int]:
    """At most four of the starts, by chance, 60 images or more apart; in order."""
    chosen: list[int] = []
    for start in rng.permutation(starts):
        if len(chosen) < _PER_RECORDING and all(abs(int(start) - other) >= _APART for other in chosen):
            chosen.append(int(start))
    return sorted(chosen)


def _windows(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Piece, ...]]:
    starts = cue_starts(path(seed).sees_cue, length=frames, within=frames // 2)
    return [(Piece(seed, start, frames),) for start in spread_starts(starts, rng=np.random.default_rng([seed, 0]))]


def _whole(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Piece, ...]]:
    return [(Piece(seed, 0, recorded_images(kind, frames)),)]


def _stands(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Piece, ...]]:
    if KINDS[kind].cues == "none":
        stops = np.array([STAND_AFTER])
    else:
        last_of_row = np.arange(STAND_AFTER, walk_frames(kind, frames))
        rows = last_of_row[:, None] - np.arange(_SIGHTED)
        stops = last_of_row[path(seed).sees_cue[rows].all(axis=1)]
    if not len(stops):
        return []
    stop = recorded_images(kind, int(stops[0]))
    return [(Piece(seed, 0, stop + recorded_images(kind, round(IMAGE_RATE_HZ * STAND_S)), stop),)]


def _kidnaps(kind: Kind, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[tuple[Piece, ...]]:
    before = 2 * frames // 3
    after = frames - before
    rng = np.random.default_rng([seed, 1])
    here, there = path(seed), path(seed + 1)
    # One image more: the odometry at the seam is what the first recording goes on with.
    starts = cue_starts(here.sees_cue, length=before + 1, within=before // 2)
    landings = cue_starts(there.sees_cue, length=after, within=frames // 10)
    pieces = []
    for start in spread_starts(starts, rng=rng):
        left = here.world_from_camera[start + before - 1].translation
        far = np.linalg.norm(there.world_from_camera.translation[landings] - left, axis=1) > _CARRIED_M
        if far.any():
            landing = int(rng.choice(landings[far]))
            pieces.append((Piece(seed, start, before), Piece(seed + 1, landing, after)))
    return pieces
