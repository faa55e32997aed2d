"""How often images of a place are flagged as other, and other images are not: counts over sequences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from filtering.errors import VaporTrackError
from sequences.frame import Camera, Frame
from vapor.observation import VaporObservationModel
from vapor.training_data.entries import open_sequences

Image = UInt8[np.ndarray, "h w 3"]
Change = Callable[[np.ndarray, np.random.Generator], np.ndarray]
_Sight = Callable[[Frame, np.random.Generator], tuple[Image, Camera | None]]

IN_A_ROW = 10
"""Number of images whose median score decides, where a single image does not."""


def _gains(red: float, green: float, blue: float) -> Change:
    gains = np.array([red, green, blue])
    return lambda image, rng: np.clip(image * gains, 0.0, 255.0).astype(np.uint8)


def _grey(image: Image) -> Image:
    return np.repeat(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2)


OUT_OF_DISTRIBUTION: Mapping[str, Change] = {
    "upside down": lambda image, rng: image[::-1, ::-1],
    "mirrored": lambda image, rng: image[:, ::-1],
    "red and blue swapped": lambda image, rng: image[..., ::-1],
    "grey": lambda image, rng: _grey(image),
    "uniform noise": lambda image, rng: rng.integers(0, 256, image.shape, dtype=np.uint8),
    "Gaussian noise": lambda image, rng: np.clip(rng.normal(127.0, 50.0, image.shape), 0, 255).astype(np.uint8),
    "black": lambda image, rng: np.zeros_like(image),
    "white": lambda image, rng: np.full_like(image, 255),
    "blurred by 1/30 of the width": lambda image, rng: cv2.GaussianBlur(image, (0, 0), image.shape[1] / 30),
}
"""Changes that turn a known image into a other one."""

CHANGED: Mapping[str, Change] = {
    "30 % darker": _gains(0.7, 0.7, 0.7),
    "30 % brighter": _gains(1.3, 1.3, 1.3),
    "red 5 % up, blue 5 % down": _gains(1.05, 1.0, 0.95),
    "noise of 10 of 255": lambda image, rng: np.clip(image + rng.normal(0.0, 10.0, image.shape), 0, 255).astype(
        np.uint8
    ),
}
"""Changes that leave the place recognisable."""

NARROWER: Mapping[str, float] = {"64 % of the view": 0.8, "36 % of the view": 0.6}
"""What a narrower lens shows, as a fraction of the image's edges."""


@dataclass(frozen=True)
class Flagged:
    """How often images of a kind were flagged as other.

    Attributes:
        kind: Name of the data, or of the change of the known images.
        median: Median score.
        fraction: Fraction of the images with a score above 1.
        fraction_in_a_row: Of the images with nine before them, the fraction where the median of the ten is above 1; NaN
            if there are none.
    """

    kind: str
    images: int
    median: float
    fraction: float
    fraction_in_a_row: float


def evaluate_flags(
    model: VaporObservationModel,
    known: Sequence[Path | str],
    other: Sequence[Path | str],
    *,
    every: int = 1,
    seed: int = 0,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> list[Flagged]:
    """Score known data, the same data made other or changed, and each of the other data, through narrower lenses too.

    Args:
        model: One with an OOD model; how many samples it draws makes no difference.
        known: Files and folders with images of its place that it was not trained on, or `PATH@START:STOP`.
        other: Likewise, of other places.
        every: Take only every so many images of each.
        advance: Called with the number of files and folders evaluated and that of all.

    Raises:
        VaporTrackError: the model has no OOD model, or data cannot be read.
    """
    if model.description.ood_model is None:
        raise VaporTrackError("the model file has no OOD model, expected one with it (`vapor-track calibrate` adds it)")
    views = {"": 1.0, **{f", {name}": edge for name, edge in NARROWER.items()}}
    changed = {kind: _as_changed(change) for kind, change in {**OUT_OF_DISTRIBUTION, **CHANGED}.items()}
    seen = {f"known{name}": _cut(edge) for name, edge in views.items()} | changed
    scores: dict[str, list[Float64[np.ndarray, " n"]]] = {kind: [] for kind in seen}
    total = len(known) + len(other)
    for done, frames in enumerate(_frames(known, every), 1):
        found = _scores(model, frames, seen, seed)
        for number, kind in enumerate(seen):
            scores[kind].append(found[:, number])
        advance(done, total)
    rows = [_count(kind, of_kind) for kind, of_kind in scores.items()]
    for done, (entry, frames) in enumerate(zip(other, _frames(other, every), strict=True), len(known) + 1):
        found = _scores(model, frames, {name: _cut(edge) for name, edge in views.items()}, seed)
        rows += [_count(f"{Path(str(entry)).name}{name}", [found[:, number]]) for number, name in enumerate(views)]
        advance(done, total)
    return rows


def _frames(data: Sequence[Path | str], every: int) -> Iterator[Iterable[Frame]]:
    for frames in open_sequences(data).values():
        yield (frame for number, frame in enumerate(frames) if number % every == 0)


def _as_changed(change: Change) -> _Sight:
    return lambda frame, rng: (change(frame.image, rng), frame.camera)


def _cut(edge: float) -> _Sight:
    """The middle of an image, by a fraction of its edges, as a narrower lens shows it."""

    def seen(frame: Frame, rng: np.random.Generator) -> tuple[Image, Camera | None]:
        height, width = frame.image.shape[:2]
        size = round(edge * width), round(edge * height)
        left, top = (width - size[0]) // 2, (height - size[1]) // 2
        camera = None if frame.camera is None else frame.camera.cropped(left, top, *size)
        return frame.image[top : top + size[1], left : left + size[0]], camera

    return seen


def _scores(
    model: VaporObservationModel, frames: Iterable[Frame], seen: Mapping[str, _Sight], seed: int
) -> Float64[np.ndarray, "n k"]:
    """Score of each image as it is seen in each way, each with random numbers of its own."""
    streams = [np.random.default_rng([seed, number]) for number in range(len(seen))]
    of_camera = lru_cache(model.seen_by)

    def score(frame: Frame, sight: _Sight, rng: np.random.Generator) -> float:
        image, camera = sight(frame, rng)
        return of_camera(camera).observe(np.ascontiguousarray(image), rng=rng).ood_score

    scores = [[score(frame, sight, rng) for sight, rng in zip(seen.values(), streams, strict=True)] for frame in frames]
    return np.array(scores, np.float64).reshape(-1, len(seen))


def _count(kind: str, sequences: Sequence[Float64[np.ndarray, " n"]]) -> Flagged:
    scores = np.concatenate(sequences)
    if not len(scores):
        raise VaporTrackError(f"{kind}: no images with true poses, expected at least one")
    rows = [np.lib.stride_tricks.sliding_window_view(s, IN_A_ROW) for s in sequences if len(s) >= IN_A_ROW]
    medians = np.concatenate([np.median(row, axis=1) for row in rows]) if rows else np.array([])
    in_a_row = float((medians > 1.0).mean()) if len(medians) else float("nan")
    return Flagged(kind, len(scores), float(np.median(scores)), float((scores > 1.0).mean()), in_a_row)
