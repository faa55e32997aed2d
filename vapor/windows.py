"""Which trials a benchmark consists of, decided by what the camera comes by and before anything is rendered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Literal

import numpy as np
from jaxtyping import Bool, Int64

from filtering.errors import VaporTrackError
from sequences.route import Cues
from vapor.recordings import CameraPath

Kind = Literal["cue", "no-cue", "kidnap", "standing", "rate-3", "rate-10", "rate-30"]
"""A run that passes something unique in its first half, one that never does, one whose camera is carried off to where
it soon sees something unique, one whose camera stops and stands for minutes, and the same walks as of "cue" at three
rates, each a selection of the images of the fastest."""

CUES: dict[Kind, Cues] = {
    "cue": "early",
    "no-cue": "none",
    "kidnap": "early",
    "standing": "none",
    "rate-3": "early",
    "rate-10": "early",
    "rate-30": "early",
}
"""The paths that the trials of a kind are cut from."""

FASTEST_HZ = 30.0
"""Images a second of the recordings that runs of several rates are cut from."""

STRIDES: dict[Kind, int] = {"rate-3": 10, "rate-10": 3, "rate-30": 1}
"""Every so many of their images are seen."""

STAND_AFTER, STAND_S = 50, 300.0
"""The image at which the camera stops, and for how many seconds it stands."""

_LEAST_CUE_IMAGES = 5  # half a second
_PER_RECORDING = 4  # windows at most
_APART = 60  # images between the starts of two windows of a recording, at least
_CARRIED_M = 2.0  # at least, by a kidnap
_BARREN = 50  # seeds in a row without a window, after which there is none to be hoped for


@dataclass(frozen=True)
class Piece:
    """A stretch of a recording: its seed, the first image and the number of images."""

    seed: int
    start: int
    length: int


@dataclass(frozen=True)
class Trial:
    """One run of a benchmark.

    Attributes:
        scene: Name of the scene.
        kind: What happens.
        pieces: What the camera sees, one after the other: two where it is carried off, else one.
        stride: Every so many of the images are seen; odometry between them adds up.
    """

    scene: str
    kind: Kind
    pieces: tuple[Piece, ...]
    stride: int = 1

    @property
    def name(self) -> str:
        """Scene, kind, and seed and first image of every piece."""
        return "-".join([self.scene, self.kind, *(f"{piece.seed}-{piece.start}" for piece in self.pieces)])

    @property
    def seam(self) -> int | None:
        """The first image after the camera was carried off; None where it was not."""
        return self.pieces[0].length if len(self.pieces) > 1 else None


def recording_frames(kind: Kind, frames: int) -> int:
    """Images of a recording from which trials of so many images are cut."""
    if kind == "standing":
        return STAND_AFTER + 1
    if kind in STRIDES:
        return round(frames * FASTEST_HZ / 10.0)
    return frames if kind == "no-cue" else 2 * frames


def choose_trials(
    scene: str, kind: Kind, *, runs: int, first_seed: int, frames: int, path: Callable[[int], CameraPath]
) -> list[Trial]:
    """The first so many trials of a kind that seeds from `first_seed` on have; the same for the same arguments.

    Args:
        scene: Name of the scene.
        kind: "cue" windows begin at a random image and see something unique in at least five images of their first
            half. "no-cue", "standing" and the rates take whole recordings. "kidnap" is two thirds of a window that sees
            something unique in at least five images of its own first half, then a stretch of the next seed's
            recording: more than 2 m away, and with something unique in at least five of its first tenth of the whole's
            images.
        runs: Number of trials.
        first_seed: Where seeds count up from.
        frames: Images of a trial.
        path: The camera's path by seed, as `CUES` says and `recording_frames` long. Not asked for by "no-cue".

    Raises:
        VaporTrackError: seed after seed has no window.
    """
    if kind in ("no-cue", "standing") or kind in STRIDES:
        length = STAND_AFTER + round(10.0 * STAND_S) if kind == "standing" else recording_frames(kind, frames)
        seeds = range(first_seed, first_seed + runs)
        return [Trial(scene, kind, (Piece(seed, 0, length),), STRIDES.get(kind, 1)) for seed in seeds]
    trials: list[Trial] = []
    last_fertile = first_seed
    seed = first_seed
    for seed in count(first_seed):
        found = _cue_trials(scene, seed, frames, path) if kind == "cue" else _kidnap_trials(scene, seed, frames, path)
        trials += found
        if len(trials) >= runs:
            return trials[:runs]
        if found:
            last_fertile = seed
        elif seed - last_fertile >= _BARREN:
            break
    raise VaporTrackError(
        f"{scene}: {len(trials)} {kind} trials of {frames} images in seeds {first_seed} to {seed}, expected {runs};"
        " more frames find more"
    )


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


def _cue_trials(scene: str, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[Trial]:
    starts = cue_starts(path(seed).sees_cue, length=frames, within=frames // 2)
    chosen = spread_starts(starts, rng=np.random.default_rng([seed, 0]))
    return [Trial(scene, "cue", (Piece(seed, start, frames),)) for start in chosen]


def _kidnap_trials(scene: str, seed: int, frames: int, path: Callable[[int], CameraPath]) -> list[Trial]:
    before = 2 * frames // 3
    after = frames - before
    rng = np.random.default_rng([seed, 1])
    here, there = path(seed), path(seed + 1)
    # One image more: the odometry at the seam is what the first recording goes on with.
    starts = cue_starts(here.sees_cue, length=before + 1, within=before // 2)
    landings = cue_starts(there.sees_cue, length=after, within=frames // 10)
    trials = []
    for start in spread_starts(starts, rng=rng):
        left = here.world_from_camera[start + before - 1].translation
        far = np.linalg.norm(there.world_from_camera.translation[landings] - left, axis=1) > _CARRIED_M
        if far.any():
            landing = int(rng.choice(landings[far]))
            trials.append(Trial(scene, "kidnap", (Piece(seed, start, before), Piece(seed + 1, landing, after))))
    return trials
